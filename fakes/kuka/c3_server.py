"""A controller's variables over TCP, by the C3 Bridge Interface Protocol 1.5 and KUKAVARPROXY.

Big-endian. Request ``tag u16 | length of the rest u16 | type u8 | nameLen u16 | name [| valueLen
u16 | value]``, reply ``tag | length | type | valueLen | value | error u16 | ok u8``. As the
original it closes a client after 30 s of silence, serves ten at most, and leaves unknown types
unanswered. Unlike it, it puts split requests together. Replies leave as `fakes.wires` says.
"""

from __future__ import annotations

import socket
import struct

from fakes.kuka.controller import KrlController
from fakes.site import Site
from fakes.wires import HOST, RECEIVE, Answers, Listener, Segments, Server


class C3Server(Server):
    """Serves one controller on a port, 0 for one that the system chooses."""

    HEAD = struct.Struct("!HH")
    READ, WRITE = 0, 1
    IDLE_S = 30.0
    SUCCESS = b"\x00\x01\x01"
    FAILURES = (b"\x00\x00\x00", b"\x00\x01\x00")  # C3 Bridge's, KUKAVARPROXY's

    def __init__(self, site: Site, port: int = 0) -> None:
        self._faults, self._time = site.faults, site.time
        self.controller = KrlController(site)
        max_clients = 10
        listener = Listener("c3", self._serve, limit=max_clients, port=port)
        self.port = listener.port
        address = {"host": HOST, "port": self.port}
        super().__init__(address, listener, restore=self.controller.restore)
        self._answers = Answers(site.faults, self._closing)

    def _serve(self, client: socket.socket) -> None:
        client.settimeout(self.IDLE_S)
        segments, pending = Segments(client.sendall), b""
        while data := client.recv(RECEIVE):
            pending += data
            while len(pending) >= self.HEAD.size:
                tag, length = self.HEAD.unpack_from(pending)
                end = self.HEAD.size + length
                if len(pending) < end:
                    break
                request, pending = pending[self.HEAD.size : end], pending[end:]
                reply = self.answer(tag, request)
                self._time.catch_up()
                if reply is not None and not self._answers.send(client, segments, reply):
                    return

    def answer(self, tag: int, request: bytes) -> bytes | None:
        """Return the reply to a request's body, None where the server keeps silent."""
        parsed = self._parse(request)
        if parsed is None:
            return None
        kind, name, text = parsed
        restarted = self._faults.strikes("robot.restarted")
        failure = 1 if restarted else self._faults.number("robot.failure_footer")
        footer = self.SUCCESS if failure is None else self.FAILURES[int(failure)]
        try:
            if footer != self.SUCCESS:
                text = ""
            elif kind == self.READ:
                text = self.controller.read(name)
            else:
                self.controller.write(name, text)
        except ValueError:
            text, footer = "", self.FAILURES[1]
        value = text.encode("ascii", "replace")
        tag = (tag + 1) % 0x10000 if self._faults.strikes("robot.tag_mismatch") else tag
        body = struct.pack("!BH", kind, len(value)) + value + footer
        return self.HEAD.pack(tag, len(body)) + body

    def _parse(self, request: bytes) -> tuple[int, str, str] | None:
        """Return type, name and value of a request, None where it is malformed or unknown."""
        try:
            kind, length = struct.unpack_from("!BH", request)
            name = request[3 : 3 + length]
            if len(name) != length or kind not in (self.READ, self.WRITE):
                return None
            text = b""
            if kind == self.WRITE:
                (size,) = struct.unpack_from("!H", request, 3 + length)
                text = request[5 + length : 5 + length + size]
            return kind, name.decode("ascii"), text.decode("ascii")
        except (struct.error, UnicodeDecodeError):
            return None


serve = C3Server
