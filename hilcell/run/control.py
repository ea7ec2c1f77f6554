"""The server of the control protocol: a local socket, mode 0600, beside a run.

The socket lies in a private folder of its own, because a run's folder may be on a disk that knows
no sockets or under a path too long for one; ``engine.json`` beside the journal says where. A
connection lives as long as its client: one that attends and ends without a ``leave`` was lost.
"""

from __future__ import annotations

import os
import shutil
import socket
import socketserver
import tempfile
import threading
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Protocol

import msgspec

from hilcell.journal.engine_file import ENGINE, EngineFile
from hilcell.journal.journal import StorageError
from hilcell.model.events import AlarmsAcknowledged
from hilcell.run.protocol import COMMANDS, LONGEST_REQUEST, Refusal, Request, Status
from hilcell.typed import decoded
from hilcell.writing import NotWritten, write_whole


class Engine(Protocol):
    """The engine as the control channel serves it; every method may come from any thread."""

    def stop(self) -> None:
        """Stop everything now."""

    def post(self, command: str) -> None:
        """Queue ``pause``, ``proceed``, ``abort`` or ``lost`` (nobody watches any more)."""

    def gone_on(self, since: int) -> str:
        """Return why an agreement to what was asked at record ``since`` holds no more, else ""."""

    def answer(self) -> str:
        """Say that the prompt is done; return why that is refused."""

    def retake(self, key: str) -> str:
        """Have a point re-measured; return why that is refused."""

    def acknowledge(self, made: AlarmsAcknowledged) -> str:
        """Journal that alarms were acknowledged; return why that is refused."""

    def watched(self, by: int) -> int:
        """Add ``by`` to the screens that attend; return how many do now."""

    def status(self) -> Status:
        """Return the run's state."""


class Control:
    """Listens for commands and hands them to the engine.

    Raises `StorageError`, and leaves nothing behind, where its files find no place.
    """

    def __init__(self, folder: Path, engine: Engine) -> None:
        self._file = folder / ENGINE
        with ExitStack() as undo:
            path = self._listen(engine, undo)
            # By a name that is no text no folder is found: a copy is then not recognised.
            place = os.fsencode(folder.resolve()).decode(errors="replace")
            _say_where(self._file, EngineFile(os.getpid(), str(path), place))
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
    """Write the file whole: a reader of half a file takes the engine for gone."""
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
            while line := self.rfile.readline(LONGEST_REQUEST):
                self.wfile.write(msgspec.json.encode(self._answer(line)) + b"\n")
                if not line.endswith(b"\n"):
                    return  # what follows is the rest of a line too long

    def finish(self) -> None:
        self.server.connections.discard(self.connection)
        if self.attends and self.server.engine.watched(-1) == 0:
            self.server.engine.post("lost")
        with suppress(OSError):
            super().finish()

    def _answer(self, line: bytes) -> Refusal | dict[str, object]:
        engine = self.server.engine
        try:
            request = decoded(line, Request)
        except (msgspec.DecodeError, UnicodeDecodeError):
            return Refusal(error=f"commands: {', '.join(COMMANDS)}")
        if request.command == "stop":
            engine.stop()  # before anything else is done, and however late
        elif refused := request.too_late() or self._do(request):
            return Refusal(error=refused)
        return engine.status().answer()

    def _do(self, request: Request) -> str:
        """Do what is asked; return why that is refused."""
        engine = self.server.engine
        match request.command:
            case "proceed" if request.until and (refused := engine.gone_on(request.until)):
                return refused
            case "pause" | "proceed" | "abort":
                engine.post(request.command)
            case "answer":
                return engine.answer()
            case "retake":
                return engine.retake(request.key)
            case "acknowledge":
                return engine.acknowledge(
                    AlarmsAcknowledged(codes=list(request.codes), until=request.until)
                )
            case "attend" | "leave":
                self._attend(attends=request.command == "attend")
        return ""

    def _attend(self, *, attends: bool) -> None:
        if attends != self.attends:
            self.attends = attends
            self.server.engine.watched(1 if attends else -1)
