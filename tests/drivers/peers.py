"""Far sides of the drivers' wires, for tests: small servers on loopback that end by themselves."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator

from hilcell.clock import WallClock

Handler = Callable[[socket.socket], None]
WAIT_S = 10.0


def wall_clock() -> WallClock:
    """Return a clock that nothing stops."""
    return WallClock(threading.Event())


class Server:
    """Serves every connection in a thread of its own until ``close``."""

    def __init__(self, handler: Handler) -> None:
        self._handler = handler
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._connections: list[socket.socket] = []
        self._threads: list[threading.Thread] = []
        self._accept = threading.Thread(target=self._serve, daemon=True)
        self._accept.start()

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def drop(self) -> None:
        """Close all connections, keep listening."""
        for connection in self._connections:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """End everything; raises when a thread does not end."""
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.drop()
        for thread in (self._accept, *self._threads):
            thread.join(WAIT_S)
            assert not thread.is_alive()
        for connection in self._connections:
            connection.close()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._listener.accept()
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._connections.append(connection)
                thread = threading.Thread(target=self._handle, args=(connection,), daemon=True)
                self._threads.append(thread)
                thread.start()

    def _handle(self, connection: socket.socket) -> None:
        with contextlib.suppress(OSError, EOFError):
            self._handler(connection)


def exactly(connection: socket.socket, size: int) -> bytes:
    """Return ``size`` bytes; raises EOFError."""
    data = b""
    while len(data) < size:
        piece = connection.recv(size - len(data))
        if not piece:
            raise EOFError
        data += piece
    return data


def scripted(script: list[tuple[bytes, list[bytes]]], surprises: list[bytes]) -> Handler:
    """Return a handler that expects each request byte for byte and answers in the given pieces.

    Other frames are appended to ``surprises``.
    """

    def handle(connection: socket.socket) -> None:
        for expected, pieces in script:
            found = exactly(connection, len(expected))
            if found != expected:
                surprises.append(found)
                return
            for piece in pieces:
                connection.sendall(piece)
                threading.Event().wait(0.005)  # lets the pieces arrive apart
        connection.recv(1)

    return handle


@contextlib.contextmanager
def eventually(timeout_s: float = WAIT_S) -> Iterator[threading.Event]:
    """Yield an event that must be set when the block ends."""
    event = threading.Event()
    yield event
    assert event.wait(timeout_s)
