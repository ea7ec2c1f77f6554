"""The control of a live run from other processes: the protocol, its server and its client.

Each line is one request or one answer, in JSON. A request may arrive late, after its sender has
reported a failure, where the engine's process was suspended; so a command states when it expires.

The server listens at a local socket, mode 0600, in a private folder of its own: a run's folder may
be on a disk without sockets or under a path too long for one. ``engine.json`` beside the journal
has its path. A connection lives as long as its client; one that attends and ends without a
``leave`` was lost.

The client has one connection for requests and one for stops alone, open from the start, so that a
stop is one `sendall` away in any state. A late answer must not be taken for the next request's: it
is awaited and dropped before the next request.
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
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Literal, Protocol, Self, TypedDict, Unpack, get_args

import msgspec

from hilcell.atomic_files import NotWritten, write_whole
from hilcell.decoding import Json, decoded, typed
from hilcell.errors import HilcellError
from hilcell.journal.journal import StorageError, is_regular_file
from hilcell.journal.runs import ENGINE, EngineFile, read_engine_file
from hilcell.journal.runs_folder import command_on
from hilcell.model.events import AlarmsAcknowledged

ANSWER_S = 2.0  # of a screen, which asks repeatedly
ORDER_S = 5.0  # of a command, which asks once
MEASURED_S = 90.0  # of an answer to a prompt, which the tracker verifies, perhaps by a wide search

Command = Literal[
    "status", "pause", "proceed", "stop", "abort", "answer", "retake", "acknowledge", "attend",
    "leave",
]  # fmt: skip
COMMANDS: tuple[Command, ...] = get_args(Command)
TIMELESS = ("stop", "status", "acknowledge", "attend", "leave")  # the others expire


class Subject(TypedDict, total=False):
    """The fields of a `Request` that name its subject."""

    key: str
    codes: tuple[str, ...]
    until: int
    choice: str


class Request(msgspec.Struct, frozen=True, omit_defaults=True):
    """A client's request: ``key`` names the point of a ``retake``, ``choice`` the kind of an
    ``answer``, "" for "done".

    ``codes`` and ``until`` are the alarms of an ``acknowledge`` and its last known record; a
    ``proceed`` with an ``until`` agrees to the question of that record. ``before`` is the expiry in
    seconds of CLOCK_MONOTONIC, one clock for all processes of a machine; None never expires.
    """

    command: Command
    key: str = ""
    before: str | None = None
    codes: tuple[str, ...] = ()
    until: int = 0
    choice: str = ""

    @classmethod
    def within(cls, timeout_s: float, command: Command, **subject: Unpack[Subject]) -> Self:
        """Return a request that expires in ``timeout_s``; to be sent at once."""
        before = None if command in TIMELESS else str(time.monotonic() + timeout_s)
        return cls(command, before=before, **subject)

    @property
    def line(self) -> bytes:
        return msgspec.json.encode(self) + b"\n"

    def too_late(self) -> str:
        """Return the refusal of an expired request, else ""."""
        if self.command in TIMELESS or self.before is None:
            return ""
        try:
            late_s = time.monotonic() - float(self.before)
        except ValueError:
            late_s = math.nan
        if not math.isfinite(late_s):
            found = self.before[:80]
            return f"before: expected a finite number of seconds, got {found!r}; nothing was done"
        return f"the order came {late_s:.1f} s too late; nothing was done" if late_s > 0 else ""


class DeviceStatus(msgspec.Struct, frozen=True):
    """A device's last reading and its age; ``reason`` states why it is lost."""

    state: str = "unknown"  # or fresh, moving, lost
    age_s: float | None = None
    text: str = ""
    reason: str = ""


class Interlock(msgspec.Struct, frozen=True):
    """One condition of motion; ``blocked`` states why it is not met, ``code`` is its alarm's."""

    name: str
    blocked: str = ""
    code: str = ""


RELEASE, HERE, WIDER = "release", "here", "wider"  # choices: let go of the beam, take a place


class Choice(msgspec.Struct, frozen=True):
    """An answer to a prompt besides "done", by its name; ``text`` says what it does."""

    name: str
    text: str


class PromptStatus(msgspec.Struct, frozen=True):
    """The prompt to the operator and its last verification, tracker's frame."""

    title: str
    text: str
    place: str = ""
    expected_mm: tuple[float, float, float] | None = None
    limit_mm: float | None = None
    seen_mm: float | None = None
    age_s: float | None = None
    ready: bool = False
    check: bool = True
    choices: tuple[Choice, ...] = ()


class Status(msgspec.Struct, frozen=True, kw_only=True):
    """The state of a run: the answer to every request that is not refused."""

    run: str = ""
    state: str
    calibration: str = ""
    points: int = 0
    unattended: bool = False
    screens: int = 0
    pausing: bool = False
    devices: dict[str, DeviceStatus] = {}
    link: dict[str, int] = {}
    interlocks: list[Interlock] = []
    prompt: PromptStatus | None = None
    retakes: list[str] = []

    def answer(self) -> dict[str, object]:
        return {"ok": True} | msgspec.structs.asdict(self)


class Refusal(msgspec.Struct, frozen=True):
    """The answer to a request that is refused."""

    ok: bool = False
    error: str = "the engine refused without a reason"


# -- the server -----------------------------------------------------------------------------------


class _Runner(Protocol):
    """`hilcell.run.runner.Runner` as the control socket calls it; each method from any thread."""

    def stop(self) -> None: ...
    def post(self, command: str) -> None: ...
    def proceed_refusal(self, since: int) -> str: ...
    def answer(self, choice: str) -> str: ...
    def retake(self, key: str) -> str: ...
    def acknowledge(self, made: AlarmsAcknowledged) -> str: ...
    def watched(self, by: int) -> int: ...
    def status(self) -> Status: ...


class Control:
    """Listens for commands and passes them to the engine.

    Raises `StorageError`, and leaves nothing behind, where its files cannot be written.
    """

    def __init__(self, folder: Path, runner: _Runner) -> None:
        self._file = folder / ENGINE
        with ExitStack() as undo:
            path = self._listen(runner, undo)
            # A name that is not UTF-8 matches no folder: a copy is then not recognized.
            place = os.fsencode(folder.resolve()).decode(errors="replace")
            where = msgspec.json.encode(EngineFile(os.getpid(), str(path), place))
            try:
                write_whole(self._file, where)  # a reader of half a file takes the engine for gone
            except NotWritten as error:
                raise StorageError(
                    f"{ENGINE} could not be written: {error}; make room or repair the disk, "
                    f"then `{command_on(folder, 'resume')}`",
                    code="HC-J01",
                ) from error
            undo.pop_all()
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.05,), name="control", daemon=True
        )
        self._thread.start()

    def _listen(self, runner: _Runner, undo: ExitStack) -> Path:
        try:
            self._private = Path(tempfile.mkdtemp(prefix="hilcell-"))
            undo.callback(shutil.rmtree, self._private, ignore_errors=True)
            path = self._private / "control"
            self._server = _Server(str(path), runner)
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
        with suppress(OSError):  # a file without a listener counts as none
            self._file.unlink()


class _Server(socketserver.ThreadingUnixStreamServer):
    daemon_threads = True
    request_queue_size = 128  # while the process is suspended

    def __init__(self, path: str, runner: _Runner) -> None:
        self.runner, self.connections = runner, set[socket.socket]()
        super().__init__(path, _Handler)

    def end_connections(self) -> None:
        for connection in tuple(self.connections):
            with suppress(OSError):  # already ended
                connection.shutdown(socket.SHUT_RDWR)


class _Handler(socketserver.StreamRequestHandler):
    """One connection."""

    LONGEST_REQUEST = 4096  # bytes of a line
    server: _Server

    def setup(self) -> None:
        super().setup()
        self.attends = False
        self.server.connections.add(self.connection)

    def handle(self) -> None:
        with suppress(OSError):  # the client has left
            while line := self.rfile.readline(self.LONGEST_REQUEST):
                self.wfile.write(msgspec.json.encode(self._answer(line)) + b"\n")
                if not line.endswith(b"\n"):
                    return  # the rest of a line that is too long

    def finish(self) -> None:
        self.server.connections.discard(self.connection)
        if self.attends and self.server.runner.watched(-1) == 0:
            self.server.runner.post("lost")
        with suppress(OSError):
            super().finish()

    def _answer(self, line: bytes) -> Refusal | dict[str, object]:
        runner = self.server.runner
        try:
            request = decoded(line, Request)
        except (msgspec.DecodeError, UnicodeDecodeError):
            return Refusal(error=f"commands: {', '.join(COMMANDS)}")
        if request.command == "stop":
            runner.stop()  # before anything else is done, and however late
        elif refused := request.too_late() or self._do(request):
            return Refusal(error=refused)
        return runner.status().answer()

    def _do(self, request: Request) -> str:
        """Perform a request; return its refusal, else ""."""
        runner = self.server.runner
        match request.command:
            case "proceed" if request.until and (refused := runner.proceed_refusal(request.until)):
                return refused
            case "pause" | "proceed" | "abort":
                runner.post(request.command)
            case "answer":
                return runner.answer(request.choice)
            case "retake":
                return runner.retake(request.key)
            case "acknowledge":
                return runner.acknowledge(
                    AlarmsAcknowledged(codes=list(request.codes), until=request.until)
                )
            case "attend" | "leave" if self.attends != (request.command == "attend"):
                self.attends = not self.attends
                runner.watched(1 if self.attends else -1)
        return ""


# -- the client -----------------------------------------------------------------------------------


class EngineSilent(HilcellError):
    """The engine's process lives but has not answered in time."""

    code = "HC-J08"


class EngineLost(HilcellError):
    """The engine has hung up or sent an invalid answer; the client is closed."""

    code = "HC-J08"


class OrderRefused(HilcellError):
    """The engine refuses the request, with its reason."""


class EngineClient:
    """A client of one live engine. Safe to use from several threads."""

    LONGEST_ANSWER = 1 << 16

    def __init__(self, engine: EngineFile, timeout_s: float | None = None) -> None:
        """Connect; raises `OSError`. ``timeout_s`` is that of each answer."""
        self._lock = threading.Lock()
        self._patience_s = ANSWER_S if timeout_s is None else timeout_s
        self._asking = self._connect(engine.socket, self._patience_s)
        try:
            self._stopping = self._connect(engine.socket, self._patience_s)
            self._stopping.setblocking(False)  # a stop waits for nothing
        except OSError:
            self._asking.close()
            raise
        self._read = b""
        self._pending = 0  # answers still expected

    @classmethod
    def of_run(cls, folder: Path, timeout_s: float | None = None) -> Self | None:
        """Return a client of the engine of a run, or None where none lives.

        Raises `EngineSilent` where an engine lives but accepts no connection.
        """
        engine = read_engine_file(folder)
        try:
            return None if engine is None else cls(engine, timeout_s)
        except (BlockingIOError, TimeoutError) as error:
            raise EngineSilent(f"engine: connect: no answer: {error}") from error
        except OSError:
            return None

    def stop(self) -> bool:
        """Request a stop without waiting; return whether it was sent."""
        try:
            with suppress(BlockingIOError):  # else the engine blocks on its next answer
                while self._stopping.recv(self.LONGEST_ANSWER):
                    pass
            self._stopping.sendall(Request("stop").line)
        except OSError:
            return False
        return True

    def leave(self) -> None:
        """Announce an intentional disconnect.

        Pending answers are awaited: an engine that answers into a closed line reads no further.
        """
        with suppress(HilcellError):  # the engine has ended
            self.ask("leave")

    def ask(self, command: Command, **subject: Unpack[Subject]) -> Status:
        """Send a command and return the answer.

        Raises `OrderRefused`, `EngineSilent` on a timeout, `EngineLost` on a lost connection and
        `HilcellError` for an invalid answer.
        """
        with self._lock:
            try:
                while self._pending:
                    self._answer()
                request = Request.within(self._patience_s, command, **subject)
                self._asking.sendall(request.line)
                self._pending += 1
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
            raise HilcellError(f"engine: {command}: invalid answer: {error}") from error

    def close(self) -> None:
        """Close both connections; a thread that waits for an answer gets `EngineLost`."""
        for each in (self._asking, self._stopping):
            with suppress(OSError):  # already ended
                each.shutdown(socket.SHUT_RDWR)
            each.close()

    def _answer(self) -> bytes:
        """Return the next pending answer."""
        while b"\n" not in self._read:
            came = self._asking.recv(self.LONGEST_ANSWER)
            if not came or len(self._read) > self.LONGEST_ANSWER:
                raise ConnectionError(
                    "the connection was closed"
                    if not came
                    else "the reply exceeds the maximum length"
                )
            self._read += came
        line, _, self._read = self._read.partition(b"\n")
        self._pending -= 1
        return line

    @staticmethod
    def _connect(path: str, timeout_s: float) -> socket.socket:
        connection = socket.socket(socket.AF_UNIX)
        connection.settimeout(timeout_s)
        try:
            connection.connect(path)
        except OSError:
            connection.close()
            raise
        return connection


def order(
    folder: Path, command: Command, *, timeout_s: float = ORDER_S, **subject: Unpack[Subject]
) -> Status:
    """Send one command to the engine of the run in ``folder``; raises `HilcellError`."""
    try:
        client = EngineClient.of_run(folder, timeout_s)
        if client is None:
            raise HilcellError(f"run {folder.name}: {_missing(folder)}", code="HC-J08")
        with closing(client):
            return client.ask(command, **subject)
    except EngineSilent as error:
        engine = read_engine_file(folder)
        process = "" if engine is None else f", process {engine.pid},"
        raise HilcellError(
            f"run {folder.name}: {command}: its engine{process} has not answered within "
            f"{timeout_s:.0f} s ({error.__cause__}): it is suspended, or the machine is "
            "overloaded; if anything moves, use the E-stop",
            code="HC-J08",
        ) from error
    except EngineLost as error:
        raise HilcellError(
            f"run {folder.name}: the engine has just ended; see `hilcell show`", code="HC-J08"
        ) from error
    except OrderRefused as error:
        raise HilcellError(f"run {folder.name}: {error}") from error


def stop_engine(folder: Path) -> bool:
    """Request a stop by a new connection; return whether an engine lives."""
    with suppress(EngineSilent):
        if client := EngineClient.of_run(folder):
            with closing(client):
                return client.stop()
    return False


def _missing(folder: Path) -> str:
    try:
        is_regular_file(folder / ENGINE)
    except OSError as error:
        return f"its engine may be running: {ENGINE} cannot be read: {error.strerror}"
    return "no engine is running; `hilcell show` shows how it ended"
