"""The engine's control channel: a local socket, mode 0600, JSON lines in, JSON lines out.

The socket lies in a private folder of its own, because a run's folder may be on a disk that knows
no sockets or under a path too long for one; ``engine.json`` beside the journal says where.
"""

from __future__ import annotations

import os
import shutil
import socket
import socketserver
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import msgspec

from hilcell.ports import HilcellError

ANSWER_S = 5.0
LONGEST = 4096
COMMANDS = ("pause", "proceed", "stop", "status")


class EngineFile(msgspec.Struct, frozen=True):
    """Where a live engine listens."""

    pid: int
    socket: str


class Control:
    """Listens for commands and hands them to ``post``; ``status`` answers without the queue."""

    def __init__(
        self, folder: Path, post: Callable[[str], None], status: Callable[[], dict[str, object]]
    ) -> None:
        self._file = folder / "engine.json"
        self._private = Path(tempfile.mkdtemp(prefix="hilcell-"))
        path = self._private / "control"
        self._server = _Server(str(path), post, status)
        path.chmod(0o600)
        engine = EngineFile(os.getpid(), str(path))
        self._file.write_bytes(msgspec.json.encode(engine))
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.05,), name="control", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Stop listening and remove the socket."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
        self._file.unlink(missing_ok=True)
        shutil.rmtree(self._private, ignore_errors=True)


class _Server(socketserver.ThreadingUnixStreamServer):
    daemon_threads = True

    def __init__(
        self, path: str, post: Callable[[str], None], status: Callable[[], dict[str, object]]
    ) -> None:
        self.post, self.status = post, status
        super().__init__(path, _Handler)


class _Handler(socketserver.StreamRequestHandler):
    server: _Server
    timeout = ANSWER_S

    def handle(self) -> None:
        with suppress(OSError):  # whoever asked has left
            line = self.rfile.readline(LONGEST)
            if line:
                self.wfile.write(msgspec.json.encode(self._answer(line)) + b"\n")

    def _answer(self, line: bytes) -> dict[str, object]:
        try:
            command = msgspec.json.decode(line, type=dict[str, str]).get("command", "")
        except msgspec.DecodeError:
            command = ""
        if command not in COMMANDS:
            return {"ok": False, "error": f"commands: {', '.join(COMMANDS)}"}
        if command != "status":
            self.server.post(command)
        return {"ok": True} | self.server.status()


def send_command(folder: Path, command: str) -> dict[str, object]:
    """Send ``command`` to the engine of the run in ``folder`` and return its answer.

    Raises `HilcellError` when no engine lives there.
    """
    engine = live_engine(folder)
    if engine is None:
        raise HilcellError(
            f"run {folder.name}: no engine is running; `hilcell show` tells how it ended"
        )
    with socket.socket(socket.AF_UNIX) as link:
        link.settimeout(ANSWER_S)
        try:
            link.connect(engine.socket)
            link.sendall(msgspec.json.encode({"command": command}) + b"\n")
            answer = link.makefile("rb").readline(LONGEST)
        except OSError as error:
            raise HilcellError(f"run {folder.name}: the engine does not answer: {error}") from error
    return msgspec.json.decode(answer, type=dict[str, object])


def live_engine(folder: Path) -> EngineFile | None:
    """Return where the engine of a run listens, or None where none lives."""
    try:
        engine = msgspec.json.decode((folder / "engine.json").read_bytes(), type=EngineFile)
    except (OSError, msgspec.DecodeError):
        return None
    with socket.socket(socket.AF_UNIX) as link:
        link.settimeout(ANSWER_S)
        try:
            link.connect(engine.socket)
        except OSError:
            return None
    return engine
