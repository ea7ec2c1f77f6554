"""The simulated cell's control channel: JSON lines over TCP on loopback.

``{"do": "addresses" | "now" | "wait" | "fault" | "clear" | "truth" | "seat" | "quit", ...}`` is
answered by ``{"ok": true, ...}`` or ``{"ok": false, "error": ...}``. The engine uses it for time
alone; faults and truth are for tests, and truth is answered only by a cell that was started with
it; ``seat`` is the person who carries the reflector. Nothing of this reaches a device's wire.
"""

from __future__ import annotations

import math
import socket
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

from fakes.faults import Faults
from fakes.time import PlantTime
from fakes.truth.plant import FLANGE, Plant
from fakes.wires.listener import Listener
from hilcell.ports import HilcellError

LONGEST = 1 << 20

Answer = dict[str, Any]


class ControlServer:
    """Answers on a port, 0 for one that the system chooses."""

    def __init__(
        self,
        time: PlantTime,
        faults: Faults,
        *,
        addresses: Callable[[], Answer],
        truth: Callable[[Answer], Answer],
        seat: Callable[[str], None],
        restore: Callable[[], None],
        quit_: Callable[[], None],
        port: int = 0,
    ) -> None:
        self._time, self._faults = time, faults
        self._restore, self._quit = restore, quit_
        self._commands: dict[str, Callable[[Answer], Answer]] = {
            "addresses": lambda order: addresses(),
            "now": lambda order: {"now_s": time.now_s()},
            "wait": self._wait,
            "fault": self._fault,
            "clear": self._clear,
            "truth": truth,
            "seat": lambda order: seat_at(seat, order),
            "quit": self._leave,
        }
        self._listener = Listener("control", self._serve, limit=100, port=port)
        self.address = f"127.0.0.1:{self._listener.port}"

    def start(self) -> None:
        """Begin to answer."""
        self._listener.start()

    def close(self) -> None:
        """Stop answering."""
        self._listener.close()

    def _serve(self, client: socket.socket) -> None:
        with client.makefile("rb") as lines:
            while line := lines.readline(LONGEST):
                answer = self._answer(line)
                client.sendall(msgspec.json.encode(answer) + b"\n")
                if answer.get("leaving"):  # only now, for the end closes this connection too
                    self._quit()

    def _answer(self, line: bytes) -> Answer:
        try:
            order = msgspec.json.decode(line, type=dict[str, Any])
            command = self._commands.get(str(order.get("do")))
            if command is None:
                known = ", ".join(self._commands)
                return {"ok": False, "error": f"do: one of {known}"}
            return {"ok": True} | command(order)
        except (msgspec.DecodeError, HilcellError, KeyError, TypeError, ValueError) as error:
            return {"ok": False, "error": f"{type(error).__name__}: {error}"}

    def _wait(self, order: Answer) -> Answer:
        """Let stepped time pass at once; paced time passes by itself, the client sleeps."""
        duration_s = float(order["s"])
        if not (math.isfinite(duration_s) and duration_s >= 0):
            raise ValueError(f"wait {duration_s} s")
        self._time.advance(duration_s)
        self._time.catch_up()
        return {"now_s": self._time.now_s()}

    def _fault(self, order: Answer) -> Answer:
        self._faults.set(
            str(order["name"]),
            order.get("value", True),
            after=int(order.get("after", 0)),
            count=int(order.get("count", 1)),
            at_rest=bool(order.get("at_rest", False)),
        )
        return {}

    def _clear(self, order: Answer) -> Answer:
        """Disarm faults; with no name also put their consequences right."""
        name = str(order.get("name", ""))
        self._faults.clear(name)
        if not name:
            self._restore()
        return {}

    def _leave(self, order: Answer) -> Answer:
        return {"leaving": True}


def seat_at(seat: Callable[[str], None], order: Answer) -> Answer:
    """Do a person's acts with the reflector of a cell where it is carried by hand."""
    seat(str(order["place"]))
    return {}


def truth_of(plant: Plant, order: Answer) -> Answer:
    """Return the truth in {W}: reflectors, frames; and e (N, 3) in {B} at ``joints_deg`` (N, 6)."""
    reflectors = {name: at.tolist() for name, at in plant.reflectors_in_world().items()}
    answer: Answer = {
        "flange_mm": plant.places_in_world()[FLANGE].tolist(),
        "reflectors_mm": reflectors,
        "slide_mm": plant.rail.slide_mm(),
        "T_W_S": plant.rail.slide_pose().tolist(),
        "T_W_B": plant.base_in_world().tolist(),
        "T_W_L": plant.tracker.pose_in_world.tolist(),
    }
    if "joints_deg" in order:
        joints_rad = np.radians(np.array(order["joints_deg"], dtype=float).reshape(-1, 6))
        nominal_mm = plant.arm.design.pose(joints_rad)[:, :3, 3]
        answer["errors_mm"] = plant.arm.errors_mm(joints_rad, nominal_mm).tolist()
    return answer
