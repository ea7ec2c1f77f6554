"""The screen's line to an engine: one connection that asks, and one that only ever says stop.

The stop has a socket of its own, open from the start, so that it is one `sendall` away whatever
else is under way. The trap: an answer may never come; each question has a deadline.
"""

from __future__ import annotations

import socket
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import msgspec

from hilcell.errors import HilcellError
from hilcell.run.control import ENGINE, EngineFile

ANSWER_S = 2.0
LONGEST = 1 << 16
_STOP = msgspec.json.encode({"command": "stop"}) + b"\n"


class Link:
    """A screen's attachment to a live engine. Safe to use from several threads."""

    def __init__(self, path: str, patience_s: float | None = None) -> None:
        self._lock = threading.Lock()
        self._asking = _connect(path)
        if patience_s is not None:
            self._asking.settimeout(patience_s)
        try:
            self._stopping = _connect(path)
            self._stopping.setblocking(False)  # a stop waits for nothing
        except OSError:
            self._asking.close()
            raise
        self._answers = self._asking.makefile("rb")

    @classmethod
    def to(cls, folder: Path, patience_s: float | None = None) -> Self | None:
        """Return the link to the engine of a run, or None where none lives.

        ``patience_s`` is for what takes longer than an answer usually may.
        """
        try:
            engine = msgspec.json.decode((folder / ENGINE).read_bytes(), type=EngineFile)
            return cls(engine.socket, patience_s)
        except (OSError, msgspec.DecodeError):
            return None

    def stop(self) -> bool:
        """Ask for a stop now, waiting for nothing; return whether the words went out."""
        try:
            self._forget_answers()
            self._stopping.sendall(_STOP)
        except OSError:
            return False
        return True

    def _forget_answers(self) -> None:
        """Make room: an engine whose answers nobody takes would stand still over the next one."""
        with suppress(BlockingIOError):
            while self._stopping.recv(LONGEST):
                pass

    def ask(self, command: str, **facts: str) -> dict[str, Any]:
        """Send a command and return the answer; raises `HilcellError` with the refusal."""
        question = msgspec.json.encode({"command": command} | facts) + b"\n"
        with self._lock:
            try:
                self._asking.sendall(question)
                line = self._answers.readline(LONGEST)
                answer: dict[str, Any] = msgspec.json.decode(line, type=dict[str, Any])
            except (OSError, ValueError, msgspec.DecodeError) as error:
                self.close()  # a late answer must never be taken for the next one's
                raise LinkLostError(f"engine: {command}: no answer: {error}") from error
        if not answer.get("ok"):
            raise HilcellError(str(answer.get("error", "the engine refused without a reason")))
        return answer

    def close(self) -> None:
        """Close both connections; who waits for an answer on one is told that none comes."""
        for each in (self._asking, self._stopping):
            with suppress(OSError):  # it has ended by itself
                each.shutdown(socket.SHUT_RDWR)
            each.close()
        self._answers.close()


def stop_engine(folder: Path) -> bool:
    """Ask the engine of a run for a stop by a line of its own; return whether it was there."""
    link = Link.to(folder)
    if link is None:
        return False
    sent = link.stop()
    link.close()
    return sent


class LinkLostError(HilcellError):
    """The engine did not answer in time; the link is closed."""


def _connect(path: str) -> socket.socket:
    link = socket.socket(socket.AF_UNIX)
    link.settimeout(ANSWER_S)
    try:
        link.connect(path)
    except OSError:
        link.close()
        raise
    return link
