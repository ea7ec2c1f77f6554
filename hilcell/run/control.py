"""The engine's control channel: a local socket, mode 0600, JSON lines in, JSON lines out.

The socket lies in a private folder of its own, because a run's folder may be on a disk that knows
no sockets or under a path too long for one; ``engine.json`` beside the journal says where. A
connection lives as long as who opened it: one that attends and ends without a word was lost.

An order may come late, when who gave it has long been told that it failed: the engine's process
stood still, and reads now what was sent then. So an order says until when it holds.
"""

from __future__ import annotations

import math
import os
import shutil
import socket
import socketserver
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Protocol

import msgspec

from hilcell.journal.engine_file import ENGINE, EngineFile, live_engine
from hilcell.journal.journal import StorageError, is_there
from hilcell.ports import HilcellError
from hilcell.writing import NotWritten, write_whole

ANSWER_S = 5.0
LONGEST = 4096
LONGEST_ANSWER = 1 << 16

Words = dict[str, str]


class Engine(Protocol):
    """What the control channel serves; every method may come from any thread."""

    def stop(self) -> None:
        """Stop everything now."""

    def post(self, command: str) -> None:
        """Queue ``pause``, ``proceed``, ``abort`` or ``lost`` (nobody watches any more)."""

    def answer(self) -> str:
        """Say that the prompt is done; return why that is refused."""

    def retake(self, key: str) -> str:
        """Have a point re-measured; return why that is refused."""

    def watched(self, by: int) -> int:
        """Add ``by`` to the screens that attend; return how many do now."""

    def status(self) -> dict[str, object]:
        """Return the run's state."""


class Control:
    """Listens for commands and hands them to the engine.

    Raises `StorageError`, and leaves nothing behind, where its files find no place.
    """

    def __init__(self, folder: Path, engine: Engine) -> None:
        self._file = folder / ENGINE
        with ExitStack() as undo:
            path = self._listen(engine, undo)
            _say_where(self._file, EngineFile(os.getpid(), str(path)))
            undo.pop_all()
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.05,), name="control", daemon=True
        )
        self._thread.start()

    def _listen(self, engine: Engine, undo: ExitStack) -> Path:
        try:
            self._private = Path(tempfile.mkdtemp(prefix="hilcell-"))
            undo.callback(shutil.rmtree, self._private, ignore_errors=True)
            path = self._private / "control"
            self._server = _Server(str(path), engine)
            undo.callback(self._server.server_close)
            path.chmod(0o600)
        except OSError as error:
            where = tempfile.tempdir or "of this machine"
            raise StorageError(
                f"temporary folder {where} cannot be used: {error.strerror or error}; make room "
                "there, or name another by TMPDIR"
            ) from error
        return path

    def close(self) -> None:
        """Stop listening, end every connection and remove the socket; once."""
        if not self._thread.is_alive():
            return
        self._server.shutdown()
        self._server.server_close()
        self._server.end_connections()
        self._thread.join()
        shutil.rmtree(self._private, ignore_errors=True)
        with suppress(OSError):  # a file that nobody listens behind says the same as none
            self._file.unlink()


def _say_where(file: Path, where: EngineFile) -> None:
    """Write the file whole: who reads half of one takes the engine for gone."""
    try:
        write_whole(file, msgspec.json.encode(where))
    except NotWritten as error:
        raise StorageError(
            f"the engine could not say where it listens: {error}; make room or mend the disk, "
            f"then `hilcell resume {file.parent.name}`",
            code="HC-J01",
        ) from error


class _Server(socketserver.ThreadingUnixStreamServer):
    daemon_threads = True
    request_queue_size = 128  # while the process stands still

    def __init__(self, path: str, engine: Engine) -> None:
        self.engine = engine
        self.connections: set[socket.socket] = set()
        super().__init__(path, _Handler)

    def end_connections(self) -> None:
        for connection in tuple(self.connections):
            with suppress(OSError):  # it has ended by itself
                connection.shutdown(socket.SHUT_RDWR)


class _Handler(socketserver.StreamRequestHandler):
    """One connection."""

    server: _Server

    def setup(self) -> None:
        super().setup()
        self.attends = False
        self.server.connections.add(self.connection)

    def handle(self) -> None:
        with suppress(OSError):  # the client has left
            while line := self.rfile.readline(LONGEST):
                self.wfile.write(msgspec.json.encode(self._answer(line)) + b"\n")
                if not line.endswith(b"\n"):
                    return  # what follows is the rest of a line too long

    def finish(self) -> None:
        self.server.connections.discard(self.connection)
        if self.attends and self.server.engine.watched(-1) == 0:
            self.server.engine.post("lost")
        with suppress(OSError):
            super().finish()

    def _answer(self, line: bytes) -> dict[str, object]:
        engine = self.server.engine
        try:
            words = msgspec.json.decode(line, type=Words)
        except msgspec.DecodeError:
            words = {}
        command = words.get("command", "")
        if command == "stop":
            engine.stop()  # before anything else is done, and however late
        elif refused := self._do(command, words):
            return {"ok": False, "error": refused}
        return {"ok": True} | engine.status()

    def _do(self, command: str, words: Words) -> str:
        """Do what is asked; return why that is refused."""
        act = self._acts().get(command)
        if act is None:
            return f"commands: {', '.join(COMMANDS)}"
        return too_late(command, words) or act(words)

    def _acts(self) -> dict[str, Callable[[Words], str]]:
        engine = self.server.engine
        return {
            "status": lambda _: "",
            "pause": lambda _: self._post("pause"),
            "proceed": lambda _: self._post("proceed"),
            "abort": lambda _: self._post("abort"),
            "answer": lambda _: engine.answer(),
            "retake": lambda words: engine.retake(words.get("key", "")),
            "attend": lambda _: self._attend(attends=True),
            "leave": lambda _: self._attend(attends=False),
        }

    def _post(self, command: str) -> str:
        self.server.engine.post(command)
        return ""

    def _attend(self, *, attends: bool) -> str:
        if attends != self.attends:
            self.attends = attends
            self.server.engine.watched(1 if attends else -1)
        return ""


COMMANDS = (
    "status", "pause", "proceed", "stop", "abort", "answer", "retake", "attend", "leave",
)  # fmt: skip
TIMELESS = ("stop", "status", "attend", "leave")  # the others are orders, and grow old


def in_time(command: str, patience_s: float) -> Words:
    """Return the words by which ``command`` holds for ``patience_s`` from now; none if for ever.

    Seconds of CLOCK_MONOTONIC, which is one clock for all processes of a machine. To be called
    just before the command is sent, with the time after which its sender tells that it failed.
    """
    return {} if command in TIMELESS else {"before": str(time.monotonic() + patience_s)}


def too_late(command: str, words: Words) -> str:
    """Return why ``command`` holds no more; an order that names no time holds for ever."""
    if command in TIMELESS or "before" not in words:
        return ""
    try:
        before_s = float(words["before"])
    except ValueError:
        before_s = math.nan
    if not math.isfinite(before_s):
        found = words["before"][:80]
        return f"before: a finite number of seconds is wanted, found {found!r}; nothing was done"
    late_s = time.monotonic() - before_s
    return f"the order came {late_s:.1f} s too late; nothing was done" if late_s > 0 else ""


def order(folder: Path, command: str, **facts: str) -> dict[str, object]:
    """Send ``command`` as `send_command` does; a refusal raises `HilcellError`, too."""
    answer = send_command(folder, command, **facts)
    if not answer["ok"]:
        raise HilcellError(f"run {folder.name}: {answer['error']}")
    return answer


def send_command(folder: Path, command: str, **facts: str) -> dict[str, object]:
    """Send ``command`` to the engine of the run in ``folder`` and return its answer.

    Raises `HilcellError` when no engine lives there, or when it does not answer.
    """
    engine = live_engine(folder)
    if engine is None:
        raise HilcellError(
            f"run {folder.name}: {_missing(folder)}",
            code="HC-J08",
        )
    words = {"command": command} | in_time(command, ANSWER_S) | facts
    with socket.socket(socket.AF_UNIX) as link:
        link.settimeout(ANSWER_S)
        try:
            link.connect(engine.socket)
            link.sendall(msgspec.json.encode(words) + b"\n")
            answer = link.makefile("rb").readline(LONGEST_ANSWER)
        except OSError as error:
            raise HilcellError(
                f"run {folder.name}: {command}: its engine, process {engine.pid}, has not answered"
                f" within {ANSWER_S:.0f} s ({error}): it stands still, or the machine has too much"
                " to do; where anything moves use the E-stop",
                code="HC-J08",
            ) from error
    if not answer:
        raise HilcellError(
            f"run {folder.name}: the engine has just ended; `hilcell show` tells",
            code="HC-J08",
        )
    return msgspec.json.decode(answer, type=dict[str, object])


def _missing(folder: Path) -> str:
    """Return why no engine was found."""
    try:
        is_there(folder / ENGINE)
    except OSError as error:
        return f"whether its engine is running cannot be told: {error.strerror}"
    return "no engine is running; `hilcell show` tells how it ended"
