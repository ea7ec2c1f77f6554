"""The page's server: one static page and a stream of snapshots, for those who have its token.

Only two paths exist and none is a file's. Each viewer has a thread, and shares nothing with others
but the newest snapshot: one that reads slowly misses snapshots, and one that reads nothing is
disconnected.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import re
import secrets
import socket
import socketserver
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from importlib.resources import files
from types import TracebackType
from typing import Any, ClassVar, Self

import msgspec

from hilcell.errors import HilcellError

LOOPBACK = "127.0.0.1"
PAGE = files("hilcell.web").joinpath("page.html").read_text("utf-8")


def _allowed(element: str) -> str:
    """Return the source of a content security policy that allows the page's one element."""
    found = re.search(rf"<{element}>(.*?)</{element}>", PAGE, re.DOTALL)
    text = found[1] if found else ""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": (
        f"default-src 'none'; script-src {_allowed('script')}; style-src {_allowed('style')}; "
        "connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    ),
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",  # the address holds the token
    "X-Content-Type-Options": "nosniff",
}


class PageServer(socketserver.ThreadingTCPServer):
    """Serves the newest published snapshot; raises `HilcellError` where it cannot listen."""

    MOST_CONNECTIONS: ClassVar = 128
    REQUEST_S: ClassVar = 10.0  # until a connection has sent its request
    BEAT_S: ClassVar = 2.0  # between signs of life, by which both ends notice a lost connection
    allow_reuse_address = True
    request_queue_size = 128

    def __init__(self, bind: str, port: int) -> None:
        self.token = secrets.token_urlsafe(24)
        self._news = threading.Condition()
        self._data, self._number, self._closing = b"", 0, False
        self._connections = dict[socket.socket, float]()  # until when it has sent its request
        self.address_family = socket.AF_INET6 if ":" in bind else socket.AF_INET
        try:
            super().__init__((bind, port), _Viewer)
        except OSError as error:
            raise HilcellError(
                f"watch --web: cannot listen at {bind}, port {port}: {error.strerror or error}; "
                "choose an address of this PC by --bind, or another port by --port"
            ) from error
        host, number = self.server_address[:2]
        self.place = str(host), number
        self._thread = threading.Thread(target=self.serve_forever, name="page")

    @property
    def url(self) -> str:
        host, port = self.place
        host = socket.gethostname() if host in ("0.0.0.0", "::") else host  # noqa: S104 - shown
        return f"http://{f'[{host}]' if ':' in host else host}:{port}/{self.token}"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc_val: BaseException | None,
        exc_tb: TracebackType | None,
    ) -> None:
        """End every connection."""
        with self._news:
            self._closing = True
            self._news.notify_all()
        self.shutdown()
        for connection in tuple(self._connections):
            _end(connection)
        self.server_close()
        self._thread.join()

    def publish(self, snapshot: Mapping[str, object]) -> None:
        """Send a snapshot to all viewers, unless nothing has changed."""
        data = msgspec.json.encode(snapshot)
        with self._news:
            if data != self._data:
                self._data = data
                self._number += 1
                self._news.notify_all()

    def events(self, seen: str) -> Iterator[bytes]:
        """Yield the newest snapshot, then each newer one; ``seen`` is the last one's number."""
        yield b"retry: 2000\n\n"
        while True:
            with self._news:
                if not self._closing and seen == str(self._number or seen):
                    self._news.wait(self.BEAT_S)
                if self._closing:
                    return
                data, number = self._data, str(self._number or seen)
            if number == seen:
                yield b"event: beat\ndata: -\n\n"
            else:
                seen = number
                yield b"id: %s\ndata: %s\n\n" % (number.encode(), data)

    def wait_for_events(self, connection: socket.socket) -> None:
        """Keep a connection whose request is answered for as long as its viewer reads."""
        if connection in self._connections:
            self._connections[connection] = float("inf")

    def service_actions(self) -> None:
        """End connections that have sent no request in time; called twice a second."""
        for connection, until_s in tuple(self._connections.items()):
            if not time.monotonic() <= until_s:
                _end(connection)

    def verify_request(self, request: Any, client_address: Any) -> bool:
        if len(self._connections) >= self.MOST_CONNECTIONS:
            return False  # closed at once
        self._connections[request] = time.monotonic() + self.REQUEST_S
        return True

    def shutdown_request(self, request: Any) -> None:
        self._connections.pop(request, None)
        super().shutdown_request(request)


def _end(connection: socket.socket) -> None:
    with suppress(OSError):  # already ended
        connection.shutdown(socket.SHUT_RDWR)


class _Viewer(BaseHTTPRequestHandler):
    """One connection, which has one request."""

    server: PageServer
    server_version, sys_version = "hilcell", ""
    timeout = 10.0  # s, of one event: a viewer that has not read it by then is disconnected

    def handle(self) -> None:
        with suppress(OSError):  # the viewer has left, or reads nothing
            super().handle()

    def do_GET(self) -> None:
        token, _, rest = self.path.removeprefix("/").partition("/")
        if not hmac.compare_digest(token.encode(), self.server.token.encode()):
            self.send_error(HTTPStatus.FORBIDDEN)
        elif rest == "events":
            self._start("text/event-stream")
            self.server.wait_for_events(self.connection)
            for event in self.server.events(self.headers.get("Last-Event-ID", "")):
                self.wfile.write(event)
        elif not rest:
            self._start("text/html; charset=utf-8")
            self.wfile.write(PAGE.encode())
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def _start(self, kind: str) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.end_headers()

    def end_headers(self) -> None:
        for name, value in HEADERS.items():
            self.send_header(name, value)
        super().end_headers()

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - its name there
        """Log nothing: a path holds the token."""
