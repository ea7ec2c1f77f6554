"""A robot of Universal Robots on its three ports: RTDE, scripts, dashboard (protocols, robot C).

RTDE's packages are big-endian, ``size u16 | type u8 | payload``: states at a rate, registers in.
States leave as often as the client wants; in stepped time, which passes as fast as it goes, so do
cycles. One client at a time may write a register. Packages leave as `fakes.wires` says, and now and
then two come glued.
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import threading
import time
from enum import IntEnum

import numpy as np

from fakes.site import Site
from fakes.universal_robots.controller import UrController
from fakes.wires import HOST, RECEIVE, Listener, Segments, Server


class Package(IntEnum):
    """Types of packages."""

    VERSION = 86
    CONTROLLER = 118
    OUTPUTS = 79
    INPUTS = 73
    START = 83
    PAUSE = 80
    DATA = 85


TYPES = {  # of the outputs, beside the registers that a client writes
    **dict.fromkeys(("actual_q", "target_q", "actual_qd", "actual_TCP_pose"), "VECTOR6D"),
    **dict.fromkeys(("robot_mode", "safety_status", "safety_mode"), "INT32"),
    **dict.fromkeys((f"output_int_register_{n}" for n in range(24, 28)), "INT32"),
    "runtime_state": "UINT32",
    **dict.fromkeys(("timestamp", "target_speed_fraction", "speed_scaling"), "DOUBLE"),
    **dict.fromkeys((f"output_double_register_{n}" for n in range(24, 30)), "DOUBLE"),
}


class _Session:
    HEAD = struct.Struct("!HB")
    FASTEST_HZ = 500.0

    def __init__(self, client: socket.socket, server: UrServer) -> None:
        self._client, self._server = client, server
        self._segments = Segments(client.sendall)
        self._pending, self._glued, self._sent = b"", b"", 0
        self._outputs: list[str] = []
        self._layout = struct.Struct("!B")  # of a state
        self._inputs: dict[int, list[tuple[str, str]]] = {}  # by the number of their recipe
        self._rate_hz, self._started, self._due_s, self._silent = self.FASTEST_HZ, False, 0.0, False

    def turn(self) -> bool:
        """Answer what has come, or send a state when it is due; return whether to go on."""
        wait_s = max(0.0, self._due_s - time.monotonic()) if self._started else None
        ready, _, _ = select.select([self._client], [], [], wait_s)
        if ready:
            data = self._client.recv(RECEIVE)
            return bool(data) and self._take(data)
        self._due_s = time.monotonic() + self._server.period_s(self._rate_hz)
        self._send_state()
        return True

    def _take(self, data: bytes) -> bool:
        self._pending += data
        while len(self._pending) >= self.HEAD.size:
            size, kind = self.HEAD.unpack_from(self._pending)
            if size < self.HEAD.size:
                return False
            if len(self._pending) < size:
                break
            payload, self._pending = self._pending[self.HEAD.size : size], self._pending[size:]
            if not self._answer(kind, payload):
                return False
        return True

    def _answer(self, kind: int, payload: bytes) -> bool:
        if kind == Package.DATA:
            return self._write(payload)
        software = (5, 12, 0, 1101319)
        if kind == Package.VERSION:
            answer = b"\x01" if payload in (b"\x00\x01", b"\x00\x02") else b"\x00"
        elif kind == Package.CONTROLLER:
            answer = struct.pack("!4I", *software)
        elif kind == Package.OUTPUTS:
            (self._rate_hz,) = struct.unpack_from("!d", payload)
            self._outputs = _names(payload[8:])
            layouts = {"VECTOR6D": "6d", "DOUBLE": "d", "INT32": "i", "UINT32": "I"}
            known = TYPES | {name: self._register(name) for name in self._server.controller.inputs}
            types = [known.get(name, "NOT_FOUND") for name in self._outputs]
            self._layout = struct.Struct("!B" + "".join(layouts.get(each, "") for each in types))
            answer = b"\x01" + ",".join(types).encode()
        elif kind == Package.INPUTS:
            number, types = self._claimed(_names(payload))
            answer = bytes([number]) + ",".join(types).encode()
        elif kind in (Package.START, Package.PAUSE):
            self._started, answer = kind == Package.START, b"\x01"
        else:
            return True
        self._client.sendall(self.HEAD.pack(self.HEAD.size + len(answer), kind) + answer)
        return True

    def _claimed(self, names: list[str]) -> tuple[int, list[str]]:
        """Return the number of a new recipe, 0 where there is none, and its types."""
        free, known = self._server.claim(self), self._server.controller.inputs
        types = [
            "NOT_FOUND" if name not in known else self._register(name) if free else "IN_USE"
            for name in names
        ]
        if not set(types) <= {"INT32", "DOUBLE"}:
            return 0, types
        number = len(self._inputs) + 1
        self._inputs[number] = list(zip(names, types, strict=True))
        return number, types

    def _write(self, payload: bytes) -> bool:
        take = self._server.faults.take
        if take("robot.idle_close") is not None:
            return False
        if take("robot.half_open") is not None or take("robot.no_reply") is not None:
            self._silent = True
        recipe = self._inputs.get(payload[0], []) if payload else []
        layout = "!B" + "".join("i" if kind == "INT32" else "d" for _, kind in recipe)
        if len(payload) == struct.calcsize(layout) > 1:
            values = struct.unpack(layout, payload)[1:]
            names = (name for name, _ in recipe)
            self._server.write(dict(zip(names, values, strict=True)))
        return True

    def _send_state(self) -> None:
        values = self._server.controller.state()
        if self._silent:
            return
        faults = self._server.faults
        late_s = faults.number("robot.late_reply")
        if late_s is not None:
            time.sleep(late_s)
        number = 2 if faults.take("robot.tag_mismatch") is not None else 1
        numbers: list[float] = []
        for name in self._outputs:
            value = values[name]
            numbers += value.tolist() if isinstance(value, np.ndarray) else [value]
        payload = self._layout.pack(number, *numbers)
        package = (
            self._glued + self.HEAD.pack(self.HEAD.size + len(payload), Package.DATA) + payload
        )
        self._sent += 1
        glued_every, glued, self._glued = 29, self._glued, b""
        if faults.take("robot.split_reply") is not None:
            self._segments.send_in_two(package, len(package) // 2)
        elif self._sent % glued_every == 0 and not glued:
            self._glued = package
        else:
            self._segments.send(package)

    @staticmethod
    def _register(name: str) -> str:
        return "INT32" if "_int_" in name else "DOUBLE"


def _names(payload: bytes) -> list[str]:
    """Return the names of a request; some clients end the list with a comma."""
    return payload.decode("ascii", "replace").removesuffix(",").split(",")


class UrServer(Server):
    """Serves one controller; only the port of RTDE can be chosen."""

    STATE = bytes([0, 0, 0, 5, 16])  # an empty message of robot states

    def __init__(self, controller: UrController, site: Site, port: int) -> None:
        self.controller, self.faults, self._time = controller, site.faults, site.time
        self._lock = threading.Lock()
        self._writer: _Session | None = None
        self._dashboard = Listener("dashboard", self._serve_dashboard)
        listeners = {
            "rtde_port": Listener("rtde", self._serve_states, port=port),
            "script_port": Listener("scripts", self._serve_scripts),
            "dashboard_port": self._dashboard,
        }
        ports = {name: each.port for name, each in listeners.items()}
        address = {"host": HOST, **ports}
        super().__init__(address, *listeners.values(), restore=controller.restore)

    def write(self, values: dict[str, float]) -> None:
        """Take registers, and let others do work that became due."""
        self.controller.write(values)
        self._time.catch_up()

    def claim(self, session: _Session) -> bool:
        """Return whether this client may write: no other one does."""
        with self._lock:
            self._writer = self._writer or session
            return self._writer is session

    def release(self, session: _Session) -> None:
        """A client has gone."""
        with self._lock:
            if self._writer is session:
                self._writer = None

    def period_s(self, rate_hz: float) -> float:
        """Return the real time between two states."""
        stepped_s = 0.002  # between two states, in stepped time
        return stepped_s if self._time.stepped else 1.0 / min(rate_hz, _Session.FASTEST_HZ)

    def _serve_states(self, client: socket.socket) -> None:
        session = _Session(client, self)
        try:
            while session.turn():
                pass
        finally:
            self.release(session)

    def _serve_scripts(self, client: socket.socket) -> None:
        """Play what a client sends, when its ``def`` has reached its ``end``."""
        text = ""
        state_s = 0.1  # the script port sends a state so often, read or not
        longest = 200_000
        while True:
            ready, _, _ = select.select([client], [], [], state_s)
            if not ready:
                with contextlib.suppress(BlockingIOError):
                    client.send(self.STATE, socket.MSG_DONTWAIT)
                continue
            data = client.recv(RECEIVE)
            text += data.decode("ascii", "replace")
            if not data or len(text) > longest:
                return
            if text.endswith("\nend\n"):
                self.controller.play(text)
                text = ""

    def _serve_dashboard(self, client: socket.socket) -> None:
        greeting = b"Connected: Universal Robots Dashboard Server\n"
        client.sendall(greeting)
        with client.makefile("rb") as lines:
            while line := lines.readline(RECEIVE):
                command = line.decode("ascii", "replace").strip()
                if command == "quit":
                    client.sendall(b"Disconnected\n")
                    return
                client.sendall(self.controller.ask(command).encode() + b"\n")


def serve(site: Site, port: int) -> UrServer:
    controller = UrController(site.cell, site.plant, site.faults, site.time)
    return UrServer(controller, site, port)
