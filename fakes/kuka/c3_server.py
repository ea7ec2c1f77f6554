"""C3 Bridge / KUKAVARPROXY server: a controller's variables over TCP (protocols, section 2).

Big-endian. Request ``tag u16 | length of the rest u16 | type u8 | nameLen u16 | name [| valueLen
u16 | value]``, reply ``tag | length | type | valueLen | value | error u16 | ok u8``. As the
original it closes a client after 30 s of silence, serves ten at most, and leaves unknown types
unanswered. Unlike it, it puts split requests together. Replies leave as `fakes.wires` says.
"""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable

from fakes.faults import Faults
from fakes.kuka.controller import KrlController, KrlError, controller_of
from fakes.site import Site
from fakes.wires import HOST, RECEIVE, Answers, Listener, Segments

READ, WRITE = 0, 1
IDLE_S = 30.0

FAILURES = {0: b"\x00\x00\x00", 1: b"\x00\x01\x00"}  # C3 Bridge's, KUKAVARPROXY's


class C3Server:
    """Serves one controller on a port, 0 for one that the system chooses."""

    HEAD = struct.Struct("!HH")

    def __init__(
        self,
        controller: KrlController,
        faults: Faults,
        catch_up: Callable[[], None] = lambda: None,
        *,
        port: int = 0,
    ) -> None:
        """``catch_up`` lets others do work that became due while a request was answered."""
        self._controller, self._faults, self._catch_up = controller, faults, catch_up
        self._closing = threading.Event()
        self._answers = Answers(faults, self._closing)
        max_clients = 10
        self._listener = Listener("c3", self._serve, limit=max_clients, port=port)
        self.port = self._listener.port

    @property
    def address(self) -> dict[str, object]:
        """Return where it listens, as options of the driver."""
        return {"host": HOST, "port": self.port}

    def restore(self) -> None:
        """Put the controller right, as an operator does."""
        self._controller.restore()

    def start(self) -> None:
        """Begin to serve."""
        self._listener.start()

    def close(self) -> None:
        """Stop serving."""
        self._closing.set()
        self._listener.close()

    def _serve(self, client: socket.socket) -> None:
        client.settimeout(IDLE_S)
        segments, pending = Segments(client), b""
        while data := client.recv(RECEIVE):
            pending += data
            while len(pending) >= self.HEAD.size:
                tag, length = self.HEAD.unpack_from(pending)
                end = self.HEAD.size + length
                if len(pending) < end:
                    break
                request, pending = pending[self.HEAD.size : end], pending[end:]
                reply = self.answer(tag, request)
                self._catch_up()
                if reply is not None and not self._answers.send(client, segments, reply):
                    return

    def answer(self, tag: int, request: bytes) -> bytes | None:
        """Return the reply to a request's body, None where the server keeps silent."""
        parsed = _parse(request)
        if parsed is None:
            return None
        kind, name, text = parsed
        success = b"\x00\x01\x01"
        footer = success
        try:
            self._fail_if_wanted()
            if kind == READ:
                text = self._controller.read(name)
            else:
                self._controller.write(name, text)
        except _Failure as failure:
            text, footer = "", FAILURES[failure.footer]
        except KrlError:
            text, footer = "", FAILURES[1]
        value = text.encode("ascii", "replace")
        tag = (tag + 1) % 0x10000 if self._faults.take("robot.tag_mismatch") is not None else tag
        body = struct.pack("!BH", kind, len(value)) + value + footer
        return self.HEAD.pack(tag, len(body)) + body

    def _fail_if_wanted(self) -> None:
        if self._faults.take("robot.restarted") is not None:
            raise _Failure(1)
        footer = self._faults.number("robot.failure_footer")
        if footer is not None:
            raise _Failure(int(footer))


class _Failure(Exception):
    def __init__(self, footer: int) -> None:
        super().__init__(footer)
        self.footer = footer


def _parse(request: bytes) -> tuple[int, str, str] | None:
    """Return type, name and value of a request's body, None where it is malformed or unknown."""
    try:
        kind, length = struct.unpack_from("!BH", request)
        name = request[3 : 3 + length]
        if len(name) != length or kind not in (READ, WRITE):
            return None
        text = b""
        if kind == WRITE:
            (size,) = struct.unpack_from("!H", request, 3 + length)
            text = request[5 + length : 5 + length + size]
        return kind, name.decode("ascii"), text.decode("ascii")
    except (struct.error, UnicodeDecodeError):
        return None


def serve(site: Site, port: int) -> C3Server:
    """Return the robot of a simulated cell behind C3 Bridge."""
    return C3Server(controller_of(site), site.faults, site.time.catch_up, port=port)
