"""The screen's line to an engine: one connection that asks, and one that only ever says stop.

The stop has a socket of its own, open from the start, so that it is one `sendall` away whatever
else is under way. The trap: an answer may come late, and must not be taken for the next one's: it
is waited for, and dropped, before anything else is asked.
"""

from __future__ import annotations

import socket
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import msgspec

from hilcell.errors import HilcellError
from hilcell.journal.engine_file import ENGINE, EngineFile
from hilcell.run.control import in_time

ANSWER_S = 2.0
LONGEST = 1 << 16
_STOP = msgspec.json.encode({"command": "stop"}) + b"\n"


class Link:
    """A screen's attachment to a live engine. Safe to use from several threads."""

    def __init__(self, path: str, patience_s: float | None = None) -> None:
        self._lock = threading.Lock()
        self._patience_s = ANSWER_S if patience_s is None else patience_s
        self._asking = _connect(path)
        self._asking.settimeout(self._patience_s)
        try:
            self._stopping = _connect(path)
            self._stopping.setblocking(False)  # a stop waits for nothing
        except OSError:
            self._asking.close()
            raise
        self._read = b""
        self._owed = 0  # answers that are still to come

    @classmethod
    def to(cls, folder: Path, patience_s: float | None = None) -> Self | None:
        """Return the link to the engine of a run, or None where none lives.

        ``patience_s`` is for what takes longer than an answer usually may. Raises
        `LinkSilentError` where an engine lives that takes nobody any more.
        """
        try:
            engine = msgspec.json.decode((folder / ENGINE).read_bytes(), type=EngineFile)
            return cls(engine.socket, patience_s)
        except (BlockingIOError, TimeoutError) as error:
            raise LinkSilentError(f"engine: connect: no answer: {error}") from error
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

    def leave(self) -> None:
        """Say that the next client to hang up is not lost.

        What is owed is waited for: an engine that answers into a closed line reads no further.
        """
        with suppress(HilcellError):  # an engine that is gone has nothing to be told
            self.ask("leave")

    def _forget_answers(self) -> None:
        """Make room: an engine whose answers nobody takes would stand still over the next one."""
        with suppress(BlockingIOError):
            while self._stopping.recv(LONGEST):
                pass

    def ask(self, command: str, **facts: str) -> dict[str, Any]:
        """Send a command and return the answer.

        Raises `HilcellError` with the refusal, `LinkSilentError` where none comes in time,
        `LinkLostError` where none can come any more.
        """
        with self._lock:
            try:
                while self._owed:
                    self._line()
                words = {"command": command} | in_time(command, self._patience_s) | facts
                self._asking.sendall(msgspec.json.encode(words) + b"\n")
                self._owed += 1
                answer: dict[str, Any] = msgspec.json.decode(self._line(), type=dict[str, Any])
            except TimeoutError as error:
                raise LinkSilentError(f"{command}: the engine does not answer") from error
            except (OSError, msgspec.DecodeError) as error:
                self.close()
                raise LinkLostError(f"engine: {command}: no answer: {error}") from error
        if not answer.get("ok"):
            raise HilcellError(str(answer.get("error", "the engine refused without a reason")))
        return answer

    def _line(self) -> bytes:
        """Return the next answer that is owed."""
        while b"\n" not in self._read:
            came = self._asking.recv(LONGEST)
            if not came or len(self._read) > LONGEST:
                raise ConnectionError("it has hung up" if not came else "it never ends a line")
            self._read += came
        line, _, self._read = self._read.partition(b"\n")
        self._owed -= 1
        return line

    def close(self) -> None:
        """Close both connections; who waits for an answer on one is told that none comes."""
        for each in (self._asking, self._stopping):
            with suppress(OSError):  # it has ended by itself
                each.shutdown(socket.SHUT_RDWR)
            each.close()


def stop_engine(folder: Path) -> bool:
    """Ask the engine of a run for a stop by a line of its own; return whether it was there."""
    try:
        link = Link.to(folder)
    except LinkSilentError:
        return False
    if link is None:
        return False
    sent = link.stop()
    link.close()
    return sent


class LinkSilentError(HilcellError):
    """The engine's process lives, and has not answered in time."""

    code = "HC-J08"


class LinkLostError(HilcellError):
    """The engine has hung up, or answers nonsense; the link is closed."""

    code = "HC-J08"


def _connect(path: str) -> socket.socket:
    link = socket.socket(socket.AF_UNIX)
    link.settimeout(ANSWER_S)
    try:
        link.connect(path)
    except OSError:
        link.close()
        raise
    return link
