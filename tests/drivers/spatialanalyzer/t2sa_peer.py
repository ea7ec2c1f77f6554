"""SpatialAnalyzer's bridge for tests: answers from a table, and lies."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable

import numpy as np

from hilcell.ports import Array
from tests.drivers.peers import Server

Answer = Callable[[str], str | None]
POINTS = {
    "P1": (4000.0, -3000.0, 0.0),
    "P2": (4000.0, -2950.0, 0.0),
    "P3": (4000.0, -3050.0, 0.0),
    "P4": (1000.0, 2000.0, 500.0),
}


class T2saPeer:
    """Measures ``at_mm`` through every point; ``answers[command]`` overrides the reply's line.

    None in place of a line is silence.
    """

    def __init__(self) -> None:
        self.at_mm: Array = np.array([4010.0, -2990.0, 5.0])
        self.requests: list[str] = []
        self.halted = threading.Event()
        self.laser = "LON"
        self.answers: dict[str, Answer] = {
            "!HALT": self._halt,
            "!LST": self._switch,
            "!MEAS_SINGLE_POINT": self._measure,
            "?LSTA": lambda _: f"ACK-300 {self.laser}",
            "?POINT_POS": self._position,
            "?STAT": lambda _: "ACK-300 Instrument is connected",
        }
        self._measured = 0
        self._server = Server(self._serve)
        self.port = self._server.port
        self.drop = self._server.drop

    def __enter__(self) -> T2saPeer:
        return self

    def __exit__(self, *_: object) -> None:
        self._server.close()

    def asked(self, command: str) -> list[str]:
        """Return the values of the requests of one command."""
        parts = (line.partition(":") for line in self.requests)
        return [values for head, _, values in parts if head == command]

    def _halt(self, _: str) -> str:
        self.halted.set()
        return "ACK-300 READY"

    def _switch(self, value: str) -> str:
        self.laser = {"0": "LOFF", "1": "LON"}[value]
        return "ACK-300 Tracker Interface Started: True"

    def _position(self, path: str) -> str:
        x, y, z = POINTS[path.rpartition(";")[2]]
        return f"ACK-300 Measured single pt {path} result: X:{x:.6f};Y:{y:.6f};Z:{z:.6f};today"

    def _measure(self, path: str) -> str:
        self._measured += 1
        x, y, z = self.at_mm + [1e-6 * self._measured, 0.0, 0.0]  # no result comes twice
        return f"ACK-300 Single Point Measurement {path} result {x:.6f},{y:.6f},{z:.6f} today True"

    def _serve(self, connection: socket.socket) -> None:
        pending = b""
        while data := connection.recv(4096):
            *lines, pending = (pending + data).split(b"\r\n")
            for line in filter(None, lines):
                self.requests.append(line.decode())
                command, _, values = line.decode().partition(":")
                answer = self.answers.get(command, lambda _: "ACK-300 READY")(values)
                if answer is not None:
                    connection.sendall(answer.encode("latin-1") + b"\r\n")
