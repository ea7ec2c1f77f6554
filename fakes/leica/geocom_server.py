"""A total station behind GeoCOM, on TCP or on a pseudo terminal in place of a serial line.

Empty lines end half a request and are not answered; ``c`` ends a motion and is answered by ``?``.
An instrument works off one request after another. A line has no connection: an answer that
one program did not wait for reaches the next one.
"""

from __future__ import annotations

import contextlib
import os
import pty
import re
import select
import socket
import threading
import time as real_time
import tty

from fakes.faults import Faults, Vanished
from fakes.leica.geocom_device import Answer, Code, GeocomDevice
from fakes.site import Site
from fakes.time import PlantTime
from fakes.wires.line_session import RECEIVE, Connection, LineSession, Wire
from fakes.wires.listener import HOST, Listener


class GeocomServer:
    """Serves one instrument on a port (0: a free one), or on a serial line."""

    NOT_DECODED, UNAVAILABLE = 3080, 3081  # communication codes: no request, no such procedure
    REQUEST = re.compile(rb"%R1Q,(\d{1,6})(?:,(\d{1,9}))?:(.*)")

    def __init__(
        self,
        device: GeocomDevice,
        faults: Faults,
        time: PlantTime,
        *,
        port: int = 0,
        serial: bool = False,
    ) -> None:
        self._device, self._faults, self._time = device, faults, time
        self._requests = threading.Lock()
        self._line: _Line | None = _Line() if serial else None
        self._listener = None if serial else Listener("geocom", self._serve_client, port=port)
        self._thread = threading.Thread(target=self._serve_line, name="geocom line", daemon=True)

    @property
    def address(self) -> dict[str, object]:
        """Return where it listens, as options of the driver."""
        if self._line is not None:
            return {"channel": self._line.path}
        return {"channel": f"socket://{HOST}:{self._listener.port if self._listener else 0}"}

    def start(self) -> None:
        """Begin to serve."""
        if self._listener is not None:
            self._listener.start()
        else:
            self._thread.start()

    def restore(self) -> None:
        """Leave the instrument as it is: its faults pass by themselves."""

    def close(self) -> None:
        """Stop serving."""
        if self._listener is not None:
            self._listener.close()
        if self._line is not None:
            self._line.closing.set()
            if self._thread.is_alive():
                self._thread.join()
            self._line.close()

    def _serve_client(self, client: socket.socket) -> None:
        try:
            self._serve(Connection(client))
        except Vanished:
            if self._listener is not None:
                self._listener.hang_up()

    def _serve_line(self) -> None:
        if self._line is not None:
            with contextlib.suppress(OSError, Vanished):
                self._serve(self._line)
            self._line.close()  # pulled out

    def _serve(self, wire: Wire) -> None:
        session = _Session(wire)
        while True:
            line = session.line(None)
            if line is None:
                continue
            if line == b"c":
                self._abort(session)
                continue
            found = self.REQUEST.fullmatch(line)
            if found is None:
                session.send(self.NOT_DECODED, 0, Answer())
                continue
            rpc, transaction = int(found[1]), int(found[2] or 0)
            with self._requests:
                answer = self._answer(session, rpc, found[3])
            self._reply(session, rpc, transaction, answer)

    def _answer(self, session: _Session, rpc: int, text: bytes) -> Answer:
        try:
            parameters = [float(each) for each in text.split(b",")] if text else []
        except ValueError:
            return Answer(Code.INVALID)
        answer = self._device.handle(rpc, parameters)
        while answer.finish is not None:
            if not self._let_pass(session, answer.after_s):
                return Answer(Code.ABORTED)
            answer = answer.finish()
        return answer

    def _let_pass(self, session: _Session, duration_s: float) -> bool:
        """Let plant time pass; return False where it was ended meanwhile."""
        if self._time.stepped:
            self._time.advance(duration_s)
            return True
        ends_s = real_time.monotonic() + duration_s / self._time.speed
        while (left_s := ends_s - real_time.monotonic()) > 0:
            if session.aborted(left_s):
                self._abort(session)
                return False
        return True

    def _abort(self, session: _Session) -> None:
        self._device.abort()
        session.say(b"?")

    def _reply(self, session: _Session, rpc: int, transaction: int, answer: Answer) -> None:
        """Send a reply as the faults want it on the wire."""
        results = (2082, 2108)
        if rpc not in results:
            known = self._device.knows(rpc)
            session.send(0 if known else self.UNAVAILABLE, transaction, answer)
            return
        take = self._faults.take
        if take("tracker.eof") is not None:
            raise ConnectionAbortedError
        if take("tracker.no_result") is not None:
            return
        noise = b"\xfe\x80\xf8\x06"
        if take("tracker.geocom_noise") is not None:
            session.say(noise)
        if take("tracker.geocom_number") is not None:
            transaction += 1
        session.answer(encoded(0, transaction, answer), self._faults)


def encoded(communication: int, transaction: int, answer: Answer) -> bytes:
    """Return a reply without its line's end."""
    values = "".join(f",{value}" for value in answer.values)
    return f"%R1P,{communication},{transaction}:{answer.code}{values}".encode("ascii")


class _Session(LineSession):
    """A client that may end the request under way."""

    def send(self, communication: int, transaction: int, answer: Answer) -> None:
        self.say(encoded(communication, transaction, answer))

    def aborted(self, timeout_s: float) -> bool:
        """Whether the request under way is to end; others wait for their turn."""
        if b"c" not in self.lines:
            self.receive(timeout_s)
        if b"c" not in self.lines:
            return False
        self.lines.clear()
        return True


class _Line:
    """A pseudo terminal in place of a serial line; both ends are kept open, as a cable is."""

    def __init__(self) -> None:
        self._end, self._far = pty.openpty()
        tty.setraw(self._far)
        self.path = os.ttyname(self._far)
        self.closing = threading.Event()
        self._open = True

    def sendall(self, data: bytes, /) -> None:
        while data:
            data = data[os.write(self._end, data) :]

    def receive(self, timeout_s: float | None) -> bytes:
        ends_s = None if timeout_s is None else real_time.monotonic() + timeout_s
        look_s = 0.05
        while not self.closing.is_set():
            left_s = look_s if ends_s is None else min(look_s, ends_s - real_time.monotonic())
            if left_s <= 0:
                return b""
            if select.select([self._end], [], [], left_s)[0]:
                return os.read(self._end, RECEIVE)
        raise ConnectionAbortedError

    def close(self) -> None:
        if self._open:
            self._open = False
            os.close(self._end)
            os.close(self._far)


def serve(site: Site, port: int) -> GeocomServer:
    """Return the total station of a simulated cell; on a serial line where its file names one."""
    options = site.cell.tracker.options
    channel, prism_mm = str(options.get("channel", "")), options.get("prism_constant_mm", 0.0)
    device = GeocomDevice(site.plant.tracker, site.faults, float(prism_mm) / 1000.0)
    serial = bool(channel) and "://" not in channel
    return GeocomServer(device, site.faults, site.time, port=port, serial=serial)
