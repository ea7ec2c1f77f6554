"""A KUKA controller for tests: a table of variables behind the C3 protocol, and a tiny robot."""

from __future__ import annotations

import re
import socket
import struct
import threading
from collections.abc import Callable
from typing import Self

from tests.drivers.peers import Server
from tests.fakes.wires import exactly

VARIABLES = {
    "$TRAFONAME[]": '"#KR210R2700_2 C4 FLR"',
    "$KR_SERIALNO": "472911",
    "$MODE_OP": "#EX",
    "$PERI_RDY": "TRUE",
    "$ALARM_STOP": "TRUE",
    "$USER_SAF": "TRUE",
    "$STOPMESS": "FALSE",
    "$PRO_STATE1": "#P_ACTIVE",
    "$OV_PRO": "100",
    "$ACT_TOOL": "1",
    "$ACT_BASE": "0",
    "$TOOL": "{FRAME: X 98.0, Y 0.0, Z 127.0, A 0.0, B 0.0, C 0.0}",
    "$BASE": "{FRAME: X 0.0, Y 0.0, Z 0.0, A 0.0, B 0.0, C 0.0}",
    "HC_VER": "4",
    "HC_TGT": "{E6AXIS: A1 0.0, A2 0.0, A3 0.0, A4 0.0, A5 0.0, A6 0.0}",
    "HC_VEL": "10",
    "HC_CMD": "0",
    "HC_SEQ": "7",
    "HC_ACK": "7",
    "HC_ERR": "0",
    "HC_STOP": "FALSE",
    "HC_OV_OLD": "0",
    "HC_OV_SET": "0",
    "HC_LIFE": "1500",
    "HC_HELD": "TRUE",
    "HC_PLACE": "0.0",
    "$EX_AX_NUM": "0",
}
Mangle = Callable[[str, bytes], list[bytes]]


class KukaPeer:
    """Moves a third of the way at each look at HC_ACK, then acknowledges."""

    def __init__(self, **changed: str) -> None:
        self.variables = VARIABLES | changed
        self.axes = [0.0, -90.0, 90.0, 0.0, 0.0, 0.0]
        self.slide_mm = 0.0
        self.places = ""  # in place of it
        self.pose = "{E6POS: X 1620.5, Y 0.0, Z 1910.0, A 30.0, B 45.0, C -60.0, S 2, T 2}"
        self.error = "0"
        self.frozen = False
        self.short_deg = 0.0
        self.requests: list[str] = []
        self.connections = 0
        self.stopped = threading.Event()
        self.mangle: Mangle = lambda _name, reply: [reply]
        self.started: Callable[[], object] = lambda: None
        self.moved: Callable[[], None] = lambda: None
        self.on_read: Callable[[str], None] = lambda _name: None  # before the answer
        self.measures, self.slip_deg = False, 0.0  # of the joints against the ordered ones
        self.deaf = 0  # stops that are lost
        self._lock = threading.Lock()
        self._steps = 0
        self.server = Server(self._serve)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.server.close()

    def _serve(self, connection: socket.socket) -> None:
        self.connections += 1
        while True:
            tag, length = struct.unpack(">HH", exactly(connection, 4))
            body = exactly(connection, length)
            kind, size = struct.unpack_from(">BH", body)
            name = body[3 : 3 + size].decode()
            with self._lock:
                self.requests.append(("write " if kind else "read ") + name)
                value = self._write(name, body[5 + size :]) if kind else self._read(name)
            for piece in self.mangle(name, _reply(tag, kind, value)):
                connection.sendall(piece)

    def _read(self, name: str) -> str | None:
        self.on_read(name)
        if name == "HC_ACK":
            self._step()
        if name == "$AXIS_ACT" or (name == "$AXIS_ACT_MEAS" and self.measures):
            off_deg = self.slip_deg * (name == "$AXIS_ACT_MEAS")
            axes = ", ".join(f"A{n} {v + off_deg:.6f}" for n, v in enumerate(self.axes, 1))
            return f"{{E6AXIS: {axes}, E1 {self.slide_mm:.5f}}}"
        if name == "$AXIS_ACT.E1":
            return self.places or f"{self.slide_mm:.5f}"
        return self.pose if name == "$POS_ACT" else self.variables.get(name)

    def _write(self, name: str, value: bytes) -> str:
        text = value.decode()
        if name == "HC_STOP" and text == "TRUE" and self.deaf:
            self.deaf -= 1
            return text
        self.variables[name] = text
        if name == "HC_SEQ":
            self._steps = 3
            self.started()
        if name == "HC_STOP" and text == "TRUE":
            self._steps = 0
            self.variables["HC_ERR"], self.variables["HC_HELD"] = "9", "TRUE"
            self.stopped.set()
        if name == "HC_STOP" and text == "FALSE":
            self.variables["HC_ACK"] = self.variables["HC_SEQ"]
        return text

    def _step(self) -> None:
        if not self._steps or self.frozen:
            return
        target = [float(v) for v in re.findall(r"A\d (-?[\d.]+)", self.variables["HC_TGT"])]
        share = 1.0 / self._steps
        if self.variables["HC_CMD"] == "2":
            place_mm = float(re.findall(r"E1 (-?[\d.]+)", self.variables["HC_TGT"])[0])
            self.slide_mm += (place_mm - self.slide_mm) * share
        self.axes = [a + (t - a) * share for a, t in zip(self.axes, target, strict=True)]
        self._steps -= 1
        self.moved()
        slides = self.variables["HC_CMD"] == "2"
        if not self._steps:
            self.axes[0] += self.short_deg
            held = self.variables["HC_HELD"] == "TRUE"
            self.variables["HC_ERR"] = "4" if held and slides else self.error
            self.variables["HC_ACK"] = self.variables["HC_SEQ"]


def _reply(tag: int, kind: int, value: str | None) -> bytes:
    text = (value or "").encode()
    footer = b"\0\1\1" if value is not None else b"\0\1\0"
    body = struct.pack(">BH", kind, len(text)) + text + footer
    return struct.pack(">HH", tag, len(body)) + body
