"""A total station for tests, on a socket or a pseudo terminal: answers from a table, and lies."""

from __future__ import annotations

import os
import pty
import select
import socket
import threading
import tty
from collections.abc import Callable
from contextlib import suppress

from tests.drivers.peers import Server

Answer = Callable[[str], str | None]
SETTINGS = {107: 108, 2006: 2007, 2016: 2014, 2020: 2021, 2024: 2023, 2028: 2029, 18005: 18006}


class GeocomPeer:
    """Measures the place to which it was turned; ``answers[rpc]`` overrides "code,values".

    None in place of an answer is silence. ``reply`` makes the line of a number and an answer.
    """

    def __init__(self, *, serial: bool = False) -> None:
        self.distance_m = 5.0
        self.requests: list[str] = []
        self.aborted = threading.Event()
        self.settings = {
            108: "4", 2007: "0", 2014: "1,1,0,1", 2021: "3", 2023: "0.0344",
            2029: "0.000000658,1013.25,12.0,12.0", 18006: "0",
        }  # fmt: skip
        self.answers: dict[int, Answer] = {
            2108: lambda _: f"0,{self.pointing},{self.distance_m:.15f}",
            5003: lambda _: "0,884321",
            5004: lambda _: '0,"TS60, R1000"',
            5034: lambda _: "0,8,50,0",
            9027: self._turn,
        }
        self.reply = lambda number, answer: f"%R1P,0,{number}:{answer}\r\n".encode()
        self.pointing = ""
        self._end = self._far = -1
        self._closing = threading.Event()
        if serial:
            self._end, self._far = pty.openpty()
            tty.setraw(self._far)
            self.channel = os.ttyname(self._far)
            self._thread = threading.Thread(target=self._serve_line, daemon=True)
            self._thread.start()
        else:
            self._server = Server(self._serve)
            self.channel = f"socket://127.0.0.1:{self._server.port}"

    def __enter__(self) -> GeocomPeer:
        return self

    def __exit__(self, *_: object) -> None:
        if self._end < 0:
            self._server.close()
            return
        self._closing.set()
        self._thread.join()
        self.pull_out()

    def pull_out(self) -> None:
        """Pull the serial line out."""
        for end in (self._end, self._far):
            with suppress(OSError):
                os.close(end)

    def _turn(self, parameters: str) -> str:
        self.pointing = ",".join(f"{float(each):.15f}" for each in parameters.split(",")[:2])
        return "0"

    def _serve(self, connection: socket.socket) -> None:
        pending = b""
        while data := connection.recv(4096):
            pending = self._hear(pending + data, connection.sendall)

    def _serve_line(self) -> None:
        pending = b""
        with suppress(OSError, ValueError):
            while not self._closing.is_set():
                if select.select([self._end], [], [], 0.01)[0]:
                    data = os.read(self._end, 4096)
                    pending = self._hear(pending + data, lambda data: os.write(self._end, data))

    def _hear(self, data: bytes, send: Callable[[bytes], object]) -> bytes:
        *lines, rest = data.split(b"\r\n")
        for line in filter(None, lines):
            if line == b"c":
                self.aborted.set()
                send(b"?\r\n")
            else:
                self.requests.append(line.decode())
                head, _, parameters = line.decode().partition(":")
                _, rpc, number = head.split(",")
                answer = self.answers.get(int(rpc), lambda text, rpc=int(rpc): self._set(rpc, text))
                said = answer(parameters)
                if said is not None:
                    send(self.reply(int(number), said))
        return rest

    def _set(self, rpc: int, parameters: str) -> str:
        if rpc in SETTINGS:
            self.settings[SETTINGS[rpc]] = parameters
        return f"0,{self.settings[rpc]}" if rpc in self.settings else "0"

    def asked(self, rpc: int) -> list[str]:
        """Return the parameters of the requests of one procedure."""
        heads = (line.partition(":") for line in self.requests)
        return [parameters for head, _, parameters in heads if head.split(",")[1] == str(rpc)]
