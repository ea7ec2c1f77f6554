"""A whole simulated cell in one process: physics, simulated devices, control channel.

``python -m fakes.host`` serves one: the first line on stdin is the order (JSON), the first line on
stdout gives all addresses. It ends with stdin, so it never outlives its parent. On the control
channel an order ``{"do": NAME, ...}`` is answered by ``{"ok": true, ...}`` or ``{"ok": false,
"error": ...}``; NAME is addresses, now, wait, fault, clear, truth, travel, seat, carry or quit. The
engine uses it only for time; faults, truth and travel (of slide and axes since it was last asked)
are for tests; ``seat`` and ``carry`` place the only reflector, which an operator would carry, by a
place's name or near a position in the tracker's frame. No device's wire shows any of
this.
"""

from __future__ import annotations

import contextlib
import math
import os
import socket
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta, Struct

from fakes.faults import load_faults
from fakes.site import SimulatedDevice, Site, device_servers
from fakes.time import CellTime
from fakes.traps import rail_device
from fakes.truth.cell_truth import FLANGE, CellTruth, ReplayTruth
from fakes.truth.motion_record import Travel
from fakes.truth.rail_truth import RailTruth
from fakes.truth.transforms import Array
from fakes.wires import HOST, Listener
from hilcell.cell.file import Cell
from hilcell.cell.settings import convert
from hilcell.decoding import decoded
from hilcell.errors import HilcellError, with_location

STDIN = 0
Values = dict[str, Any]


def truth_answer(truth: CellTruth, order: Values) -> Values:
    """Return the truth in {W}: reflectors, frames; and e (N, 3) in {B} at ``joints_deg`` (N, 6)."""
    answer: Values = {
        "flange_mm": truth.places_in_world()[FLANGE].tolist(),
        "reflectors_mm": {name: at.tolist() for name, at in truth.reflectors_in_world().items()},
        "slide_mm": truth.rail.slide_mm(),
        "T_W_S": truth.rail.slide_pose().tolist(),
        "T_W_B": truth.base_in_world().tolist(),
        "T_W_L": truth.tracker.pose_in_world.tolist(),
    }
    if "joints_deg" in order:
        joints_rad = np.radians(np.array(order["joints_deg"], dtype=float).reshape(-1, 6))
        nominal_mm = truth.arm.design.pose(joints_rad)[:, :3, 3]
        answer["errors_mm"] = truth.arm.errors_mm(joints_rad, nominal_mm).tolist()
    return answer


def travel_answer(truth: CellTruth | ReplayTruth, now_s: float) -> Values:
    """Return the travel of slide (mm) and axes (deg) since it was last asked, and the time."""
    answer: Values = {"now_s": now_s, "axes": _travel_values(truth.robot.travel(), "deg")}
    if isinstance(truth.rail, RailTruth):
        answer["slide"] = _travel_values(truth.rail.travel(), "mm")
    return answer


def _travel_values(travel: Travel, unit: str) -> Values:
    """Return a travel with its unit in each name: "mm" of one axis, or "deg" of several."""

    def plain(value: Array) -> object:
        return np.degrees(value).tolist() if unit == "deg" else float(value[0])

    names = ("begin", "low", "high")
    strokes = [
        {"began": each.began, f"fastest_{unit}_s": plain(each.fastest)}
        | {f"{name}_{unit}": plain(getattr(each, name)) for name in names}
        for each in travel.strokes
    ]
    distances = {f"{name}_{unit}": plain(getattr(travel, name)) for name in (*names, "excursion")}
    return {"moving_s": travel.moving_s, "strokes": strokes} | distances


class Order(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The ordered simulated cell; ``seed``: the machine's; ``run_seed``: of the run that begins
    it, for its noise; ``speed`` None: stepped time.
    """

    cell: dict[str, Any]
    seed: int = 1
    run_seed: int | None = None
    speed: float | None = None
    faults: str = ""
    truth: bool = False
    # TCP ports to listen on; without one, or with 0, the system chooses
    ports: dict[Annotated[str, Meta(pattern="^(rail|robot|tracker|control)$")], int] = {}


class Host:
    """Runs one simulated cell; raises `HilcellError` where the order is not sound."""

    def __init__(self, order: Order) -> None:
        self._order, ports = order, order.ports
        self._ended = threading.Event()
        cell = convert(order.cell, Cell, "simulated cell")
        self._faults = load_faults(order.faults)
        self._time = CellTime(math.inf if order.speed is None else order.speed)
        data = cell.simulation.data if cell.simulation is not None else ""
        self._cell_truth: CellTruth | ReplayTruth = (
            ReplayTruth(cell, Path(data), self._time, self._faults)
            if data
            else CellTruth(cell, order.seed, self._time, self._faults, order.run_seed)
        )
        site = Site(cell, self._cell_truth, self._faults, self._time, rail_device(cell))
        self._devices: dict[str, SimulatedDevice] = {}
        with ExitStack() as made:  # what was made before one that is broken is closed again
            for table, serve in device_servers(cell).items():
                device = self._served(table, partial(serve, site, ports.get(table, 0)))
                made.callback(device.close)
                self._devices[table] = device
            self._control = Listener(
                "control", self._serve, limit=100, port=ports.get("control", 0)
            )
            made.pop_all()
        self._commands: dict[str, Callable[[Values], Values | None]] = {
            "addresses": lambda order: self.addresses(),
            "now": lambda order: {"now_s": self._time.now_s()},
            "wait": self._wait,
            "fault": lambda order: self._faults.set(**order),
            "clear": self._clear,
            "truth": self._truth,
            "travel": self._travel,
            "seat": lambda order: self._cell_truth.place_reflector(str(order["place"])),
            "carry": lambda order: self._cell_truth.carry_reflector(np.array(order["near_mm"])),
            "quit": lambda order: {"leaving": True},
        }

    def addresses(self) -> Values:
        """Return where everything listens, and how time passes."""
        found = {table: device.address for table, device in self._devices.items()}
        control = f"{HOST}:{self._control.port}"
        return found | {"control": control, "speed": self._order.speed}

    def run(self) -> None:
        """Serve until `end`."""
        with ExitStack() as stack:
            servers: tuple[SimulatedDevice | Listener, ...] = (
                *self._devices.values(),
                self._control,
            )
            for server in servers:
                stack.callback(server.close)
                server.start()
            self._ended.wait()

    def end(self) -> None:
        """End the simulated cell; may come from any thread."""
        self._ended.set()

    def _serve(self, client: socket.socket) -> None:
        longest = 1 << 20
        with client.makefile("rb") as lines:
            while line := lines.readline(longest):
                answer = self._answer(line)
                client.sendall(msgspec.json.encode(answer) + b"\n")
                if answer.get("leaving"):  # only now, for the end closes this connection too
                    self.end()

    def _answer(self, line: bytes) -> Values:
        try:
            order = msgspec.json.decode(line, type=dict[str, Any])
            command = self._commands.get(str(order.pop("do", "")))
            if command is None:
                known = ", ".join(self._commands)
                return {"ok": False, "error": f"do: one of {known}"}
            return {"ok": True} | (command(order) or {})
        except (msgspec.DecodeError, HilcellError, KeyError, TypeError, ValueError) as error:
            return {"ok": False, "error": f"{type(error).__name__}: {error}"}

    def _wait(self, order: Values) -> Values:
        """Let stepped time pass at once; paced time passes by itself, the client sleeps."""
        duration_s = float(order["s"])
        if not (math.isfinite(duration_s) and duration_s >= 0):
            raise ValueError(f"wait {duration_s} s")
        self._time.wait(duration_s)
        self._time.catch_up()
        return {"now_s": self._time.now_s()}

    def _clear(self, order: Values) -> None:
        """Disarm faults; with no name also put their consequences right."""
        name = str(order.get("name", ""))
        self._faults.clear(name)
        if not name:
            for device in self._devices.values():
                device.restore()

    def _truth(self, order: Values) -> Values:
        self._check_truthful()
        if not isinstance(self._cell_truth, CellTruth):
            return {}
        return truth_answer(self._cell_truth, order) | {"cell": self._order.cell}

    def _travel(self, order: Values) -> Values:
        self._check_truthful()
        return travel_answer(self._cell_truth, self._time.now_s())

    def _check_truthful(self) -> None:
        if not self._order.truth:
            raise HilcellError(
                "this simulated cell keeps its truth: start it with `hilcell sim --truth`"
            )

    @staticmethod
    def _served(table: str, serve: Callable[[], SimulatedDevice]) -> SimulatedDevice:
        """Return a simulated device; raises `HilcellError` where a package's one is broken."""
        duties = ("address", "start", "restore", "close")
        try:
            device = serve()
            lacking = [name for name in duties if not hasattr(device, name)]
        except HilcellError:
            raise
        except Exception as error:  # a package may raise anything
            raise HilcellError(f"simulated {table}: {with_location(error)}") from error
        if lacking:
            what = f"{type(device).__name__} has no {', '.join(lacking)}"
            raise HilcellError(f"simulated {table}: {what}; see fakes.site.SimulatedDevice")
        return device


def main() -> int:
    """Serve the ordered cell until stdin ends or the control channel says quit."""
    threading.excepthook = _report
    try:
        host = Host(decoded(_first_line(), Order))
    except (msgspec.DecodeError, HilcellError) as error:
        print(error, file=sys.stderr)
        return 2

    def watch() -> None:
        while os.read(STDIN, 4096):
            pass
        host.end()

    threading.Thread(target=watch, name="stdin", daemon=True).start()
    print(msgspec.json.encode(host.addresses()).decode(), flush=True)
    with contextlib.suppress(KeyboardInterrupt):
        host.run()
    return 0


def _first_line() -> bytes:
    """Read up to the first newline, unbuffered: a buffer's lock would outlive the watcher."""
    line = b""
    while not line.endswith(b"\n") and (data := os.read(STDIN, 65536)):
        line += data
    return line


def _report(failed: threading.ExceptHookArgs) -> None:
    """Say which error ended a thread of a simulated device: its client sees a closed wire."""
    error = failed.exc_value or failed.exc_type()
    name = failed.thread.name if failed.thread else "a thread"
    print(f"simulated cell: {name}: {with_location(error)}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
