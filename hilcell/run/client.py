"""The client of a live engine: one connection that asks, and one that only ever says stop.

The stop has a socket of its own, open from the start, so that it is one `sendall` away whatever
else is under way. An answer may come late, and must not be taken for the next request's: it is
waited for, and dropped, before anything else is asked.
"""

from __future__ import annotations

import socket
import threading
from contextlib import closing, suppress
from pathlib import Path
from typing import Self, Unpack

import msgspec

from hilcell.errors import HilcellError
from hilcell.journal.engine_file import ENGINE, EngineFile, read_engine_file
from hilcell.journal.journal import is_there
from hilcell.run.protocol import (
    ANSWER_S,
    LONGEST_ANSWER,
    ORDER_S,
    Command,
    Refusal,
    Request,
    Status,
    Subject,
)
from hilcell.typed import Json, decoded, typed


class EngineSilent(HilcellError):
    """The engine's process lives, and has not answered in time."""

    code = "HC-J08"


class EngineLost(HilcellError):
    """The engine has hung up, or answers nonsense; the client is closed."""

    code = "HC-J08"


class OrderRefused(HilcellError):
    """The engine refuses what was asked, with its reason."""


class EngineClient:
    """A client of one live engine. Safe to use from several threads."""

    def __init__(self, engine: EngineFile, patience_s: float | None = None) -> None:
        """Connect; raises `OSError`. ``patience_s``: how long it waits for an answer."""
        self._lock = threading.Lock()
        self._patience_s = ANSWER_S if patience_s is None else patience_s
        self._asking = _connect(engine.socket, self._patience_s)
        try:
            self._stopping = _connect(engine.socket, self._patience_s)
            self._stopping.setblocking(False)  # a stop waits for nothing
        except OSError:
            self._asking.close()
            raise
        self._read = b""
        self._owed = 0  # answers that are still to come

    @classmethod
    def of_run(cls, folder: Path, patience_s: float | None = None) -> Self | None:
        """Return a client of the engine of a run, or None where none lives.

        Raises `EngineSilent` where an engine lives that takes no connection any more.
        """
        engine = read_engine_file(folder)
        try:
            return None if engine is None else cls(engine, patience_s)
        except (BlockingIOError, TimeoutError) as error:
            raise EngineSilent(f"engine: connect: no answer: {error}") from error
        except OSError:
            return None

    def stop(self) -> bool:
        """Ask for a stop now, waiting for nothing; return whether the words went out."""
        try:
            self._forget_answers()
            self._stopping.sendall(_line(Request("stop")))
        except OSError:
            return False
        return True

    def leave(self) -> None:
        """Say that the next client to hang up is not lost.

        What is owed is waited for: an engine that answers into a closed line reads no further.
        """
        with suppress(HilcellError):  # the engine is gone, and misses no screen
            self.ask("leave")

    def ask(self, command: Command, **subject: Unpack[Subject]) -> Status:
        """Send a command and return the answer.

        Raises `OrderRefused`, `EngineSilent` where no answer comes in time, `EngineLost` where
        none can come any more, and `HilcellError` where the answer makes no sense.
        """
        with self._lock:
            try:
                while self._owed:
                    self._answer()
                request = Request.within(self._patience_s, command, **subject)
                self._asking.sendall(_line(request))
                self._owed += 1
                answer = decoded(self._answer(), Json)
            except TimeoutError as error:
                raise EngineSilent(f"{command}: the engine does not answer") from error
            except (OSError, msgspec.DecodeError, UnicodeDecodeError) as error:
                self.close()
                raise EngineLost(f"engine: {command}: no answer: {error}") from error
        try:
            if not answer.get("ok"):
                raise OrderRefused(typed(answer, Refusal).error)
            return typed(answer, Status)
        except msgspec.ValidationError as error:
            raise HilcellError(f"engine: {command}: the answer makes no sense: {error}") from error

    def close(self) -> None:
        """Close both connections; a thread that waits for an answer gets `EngineLost`."""
        for each in (self._asking, self._stopping):
            with suppress(OSError):  # it has ended by itself
                each.shutdown(socket.SHUT_RDWR)
            each.close()

    def _forget_answers(self) -> None:
        """Make room: an engine whose answers nobody takes would stand still over the next one."""
        with suppress(BlockingIOError):
            while self._stopping.recv(LONGEST_ANSWER):
                pass

    def _answer(self) -> bytes:
        """Return the next answer that is owed."""
        while b"\n" not in self._read:
            came = self._asking.recv(LONGEST_ANSWER)
            if not came or len(self._read) > LONGEST_ANSWER:
                raise ConnectionError("it has hung up" if not came else "it never ends a line")
            self._read += came
        line, _, self._read = self._read.partition(b"\n")
        self._owed -= 1
        return line


def order(folder: Path, command: Command, *, key: str = "", until: int = 0) -> Status:
    """Connect to the engine of the run in ``folder``, ask once and close.

    Raises `HilcellError` where no engine lives, or where it refuses or does not answer.
    """
    try:
        client = EngineClient.of_run(folder, ORDER_S)
        if client is None:
            raise HilcellError(f"run {folder.name}: {_missing(folder)}", code="HC-J08")
        with closing(client):
            return client.ask(command, key=key, until=until)
    except EngineSilent as error:
        engine = read_engine_file(folder)
        process = "" if engine is None else f", process {engine.pid},"
        raise HilcellError(
            f"run {folder.name}: {command}: its engine{process} has not answered within "
            f"{ORDER_S:.0f} s ({error.__cause__}): it stands still, or the machine has too much to "
            "do; where anything moves use the E-stop",
            code="HC-J08",
        ) from error
    except EngineLost as error:
        raise HilcellError(
            f"run {folder.name}: the engine has just ended; `hilcell show` tells", code="HC-J08"
        ) from error
    except OrderRefused as error:
        raise HilcellError(f"run {folder.name}: {error}") from error


def stop_engine(folder: Path) -> bool:
    """Ask the engine of a run for a stop by a new connection; return whether it was there."""
    try:
        client = EngineClient.of_run(folder)
    except EngineSilent:
        return False
    if client is None:
        return False
    with closing(client):
        return client.stop()


def _missing(folder: Path) -> str:
    """Return why no engine was found."""
    try:
        is_there(folder / ENGINE)
    except OSError as error:
        return f"its engine may be running: {ENGINE} cannot be read: {error.strerror}"
    return "no engine is running; `hilcell show` tells how it ended"


def _line(request: Request) -> bytes:
    return msgspec.json.encode(request) + b"\n"


def _connect(path: str, patience_s: float) -> socket.socket:
    connection = socket.socket(socket.AF_UNIX)
    connection.settimeout(patience_s)
    try:
        connection.connect(path)
    except OSError:
        connection.close()
        raise
    return connection
