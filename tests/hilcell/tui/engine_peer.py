"""An engine's control socket as the protocol defines it, and with faults."""

from __future__ import annotations

import os
import shutil
import socket
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

import msgspec

from hilcell.journal.runs import EngineFile

STATUS: dict[str, Any] = {
    "ok": True, "run": "r", "state": "running", "calibration": "grid", "points": 3,
    "unattended": False, "screens": 1, "pausing": False,
    "devices": {"rail": {"state": "fresh", "age_s": 0.1, "text": "1100.20 mm", "reason": ""}},
    "interlocks": [{"name": "rail move", "blocked": ""}], "prompt": None, "retakes": [],
}  # fmt: skip
SILENCE = b""  # no answer at all
Answer = Callable[[dict[str, Any]], bytes | None]  # None: the connection is closed


def says(body: dict[str, Any]) -> bytes:
    """Return an answer as one line."""
    return msgspec.json.encode(body) + b"\n"


def usual(command: dict[str, Any]) -> bytes:
    """Answer as an engine does."""
    return says(STATUS)


class Peer:
    """Serves one run's folder; what came is in ``heard``, by connection."""

    def __init__(self, folder: Path, answer: Answer = usual) -> None:
        self.answer = answer
        self.heard: list[tuple[int, str]] = []
        self.open = 0  # connections that have not ended
        self._changed = threading.Condition()
        self._private = Path(tempfile.mkdtemp(prefix="hilcell-peer-"))
        self._server = socket.socket(socket.AF_UNIX)
        self._server.bind(str(self._private / "control"))
        self._server.listen()
        self._connections: list[socket.socket] = []
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()
        where = EngineFile(os.getpid(), str(self._private / "control"))
        folder.mkdir(parents=True, exist_ok=True)
        self._file = folder / "engine.json"
        self._file.write_bytes(msgspec.json.encode(where))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._file.unlink(missing_ok=True)
        self.hang_up()
        self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        for thread in self._threads:
            thread.join()
        shutil.rmtree(self._private)

    def hang_up(self) -> None:
        """End every connection."""
        for connection in self._connections:
            try:
                connection.shutdown(socket.SHUT_RDWR)
            except OSError:
                continue  # ended already

    @property
    def commands(self) -> list[str]:
        """Return what was heard, without the questions for the status."""
        return [command for _, command in self.heard if command != "status"]

    def until(self, true: Callable[[], bool]) -> None:
        """Wait until something is so; it is looked at whenever something is heard."""
        with self._changed:
            self._changed.wait_for(true)

    def until_stops(self, count: int) -> None:
        """Wait until so many stops were heard."""
        self.until(lambda: self.commands.count("stop") == count)

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._server.accept()
            except OSError:
                return
            self._connections.append(connection)
            thread = threading.Thread(target=self._serve, args=(len(self._connections), connection))
            self._threads.append(thread)
            with self._changed:
                self.open += 1
                self._changed.notify_all()
            thread.start()

    def _serve(self, number: int, connection: socket.socket) -> None:
        try:
            with connection, connection.makefile("rb") as lines:
                for line in lines:
                    words = msgspec.json.decode(line, type=dict[str, Any])
                    self._note(number, words["command"])
                    answer = self.answer(words)
                    if answer is None:
                        return
                    connection.sendall(answer)
        except OSError:
            return
        finally:
            with self._changed:
                self.open -= 1
                self._changed.notify_all()

    def _note(self, number: int, command: str) -> None:
        with self._changed:
            self.heard.append((number, command))
            self._changed.notify_all()
