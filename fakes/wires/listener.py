"""A TCP server on loopback with a blocking thread a client: the quickest answer Python gives."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
from collections.abc import Callable

from hilcell.ports import HilcellError

HOST = "127.0.0.1"


def listen(port: int) -> socket.socket:
    """Return a socket that listens on ``port``, 0 for one that the system chooses.

    Raises `HilcellError`.
    """
    try:
        return socket.create_server((HOST, port))
    except OSError as error:
        raise HilcellError(
            f"port {port} cannot be opened: {os.strerror(error.errno or 0)}; "
            "choose another with --ports"
        ) from error


class Listener:
    """Accepts clients on ``port``, 0 for one that the system chooses; hands each to ``serve``.

    ``serve`` returns when the client is done; OSError from a broken connection ends it too.
    """

    def __init__(
        self,
        name: str,
        serve: Callable[[socket.socket], None],
        *,
        limit: int = 10,
        port: int = 0,
        accepted: Callable[[socket.socket], None] | None = None,
    ) -> None:
        """``accepted`` takes note of each client, in the order in which they come."""
        self._name, self._serve, self._limit = name, serve, limit
        self._accepted = accepted
        self._socket = listen(port)
        self.port: int = self._socket.getsockname()[1]
        self._lock = threading.Lock()
        self._clients: dict[socket.socket, threading.Thread] = {}
        self._accepting = threading.Thread(target=self._accept, name=name, daemon=True)

    def start(self) -> None:
        """Begin to accept."""
        self._accepting.start()

    def hang_up(self) -> None:
        """Close every socket without waiting; callable from a client's own thread."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        with self._lock:
            clients = list(self._clients)
        for client in clients:
            with contextlib.suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close every socket and wait for every thread."""
        self.hang_up()
        if self._accepting.is_alive():
            self._accepting.join()
        with self._lock:
            threads = list(self._clients.values())
        for thread in threads:
            thread.join()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._socket.accept()
            except OSError:
                return
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            thread = threading.Thread(
                target=self._run, args=(client,), name=f"{self._name} client", daemon=True
            )
            with self._lock:
                if len(self._clients) >= self._limit:
                    client.close()
                    continue
                self._clients[client] = thread
            if self._accepted is not None:
                self._accepted(client)
            thread.start()

    def _run(self, client: socket.socket) -> None:
        with client, contextlib.suppress(OSError):
            self._serve(client)
        with self._lock:
            del self._clients[client]
