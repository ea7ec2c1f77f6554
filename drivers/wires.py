"""Wires of drivers: a TCP connection or a serial line, used alike, and lines of text over either.

Every wait for bytes ends within 20 ms of a stop; connecting takes 3 s at most. By default keepalive
notices a dead peer after two hours, so the probe times are set, unsent bytes expire by
TCP_USER_TIMEOUT where the system has it, and every read has a deadline, which counts polls that
received nothing, never the clock of a thread that did not run.
"""

from __future__ import annotations

import errno
import os
import re
import select
import socket
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress

import serial

from drivers.device_errors import Device
from drivers.supervision import Deadline
from hilcell.ports import DeviceError
from hilcell.wire.channel import SerialLine, Socket, parse_channel

POLL_S = 0.02
SEND_S = 1.0


class Link(ABC):
    """An open wire. One thread receives; any thread may send."""

    def __init__(self, device: Device, address: str, check: Callable[[], None]) -> None:
        self._device, self.address, self._check = device, address, check
        check()

    @abstractmethod
    def send(self, data: bytes, operation: str) -> None:
        """Send all of ``data``; raises `DeviceError` when it does not leave in time."""

    @abstractmethod
    def close(self) -> None:
        """Close the wire; a second close does nothing."""

    @abstractmethod
    def _poll(self, size: int, *, wait: bool) -> bytes:
        """Return bytes that arrived, or arrive within `POLL_S`; raises `DeviceError` at the end."""

    def receive(self, size: int, deadline: Deadline) -> bytes:
        """Return 1 to ``size`` bytes, or none after the ``deadline``; raises `DeviceError`."""
        while True:
            self._check()
            expired = deadline.expired()
            if (data := self._poll(size, wait=not expired)) or expired:
                return data

    def broken(self, operation: str, found: str) -> DeviceError:
        return self._device.broken(self.address, operation, found)


class TcpLink(Link):
    """A connected socket."""

    CONNECT_S = 3.0
    LEAVE_S = 0.5
    KEEPALIVE_S = 5
    UNSENT_MS = 5000

    def __init__(self, device: Device, host: str, port: int, check: Callable[[], None]) -> None:
        super().__init__(device, f"{host}:{port}", check)
        self.reply_pending = False  # something was sent whose reply is not awaited
        try:
            self._socket = socket.create_connection((host, port), timeout=self.CONNECT_S)
        except OSError as error:
            raise device.unreached(self.address, str(error)) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        probes = {"TCP_KEEPIDLE": self.KEEPALIVE_S, "TCP_KEEPINTVL": 1, "TCP_KEEPCNT": 3}
        # Not every system names all of these; the reads have their deadlines without them.
        for name, value in (probes | {"TCP_USER_TIMEOUT": self.UNSENT_MS}).items():
            if hasattr(socket, name):
                self._socket.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
        self._socket.setblocking(False)  # most bytes need no wait

    def send(self, data: bytes, operation: str) -> None:
        deadline = Deadline(SEND_S)
        rest = memoryview(data)
        while rest:
            expired = deadline.expired()
            try:
                rest = rest[self._socket.send(rest) :]
            except BlockingIOError:
                if expired:
                    raise self.broken(operation, "the device takes no bytes") from None
                select.select([], [self._socket], [], POLL_S)
            except OSError as error:
                raise self.broken(operation, _text(error)) from error

    def _poll(self, size: int, *, wait: bool) -> bytes:
        try:
            ready, _, _ = select.select([self._socket], [], [], POLL_S if wait else 0.0)
            data = self._socket.recv(size) if ready else b""
        except BlockingIOError:  # ready, and then nothing after all
            return b""
        except (OSError, ValueError) as error:
            raise self.broken("receive", _text(error)) from error
        if ready and not data:
            raise self.broken("receive", "the device closed the connection")
        return data

    def close(self) -> None:
        """Close the socket; a second close does nothing.

        A request without an awaited reply must reach the device first, or `LEAVE_S` pass: it could
        otherwise arrive after the first request of the next connection.
        """
        if self.reply_pending:
            self.reply_pending = False
            with suppress(OSError, ValueError):
                self._shut_down()
        self._socket.close()

    def _shut_down(self) -> None:
        """End the sending side; return when the device has closed its end, too."""
        deadline = Deadline(self.LEAVE_S)
        self._socket.shutdown(socket.SHUT_WR)
        while not deadline.expired():
            ready, _, _ = select.select([self._socket], [], [], POLL_S)
            if ready and not self._socket.recv(4096):
                return


def _text(error: OSError | ValueError) -> str:
    """Return the system's message; a socket that this program has closed has no descriptor."""
    closed = isinstance(error, ValueError) or error.errno == errno.EBADF
    return "this program has closed the connection" if closed else str(error)


class SerialLink(Link):
    """An open serial line, for this program alone: a second one would take half of the answers.

    Bytes from before it was opened answer no request, and are dropped.
    """

    def __init__(self, device: Device, line: SerialLine, check: Callable[[], None]) -> None:
        super().__init__(device, line.path, check)
        try:
            self._port = serial.Serial(
                line.path, line.baud, timeout=POLL_S, write_timeout=SEND_S, exclusive=True
            )
            self._port.reset_input_buffer()
        except (serial.SerialException, OSError, ValueError) as error:
            found = f"{line.path} at {line.baud} baud: {system_message(error)}"
            act = (
                "check the cable, the path (/dev/serial/by-id keeps its name), the right to open "
                "it, and that no other program has it"
            )
            raise device.failed(
                device.unreachable, "connect", found, act=act, address=line.path, baud=line.baud
            ) from error

    def send(self, data: bytes, operation: str) -> None:
        try:
            self._port.write(data)
        except (serial.SerialException, OSError, TypeError) as error:
            raise self._failed(operation, error) from error

    def _poll(self, size: int, *, wait: bool) -> bytes:
        """Wait by the port's own timeout: another one would write its settings again."""
        try:
            first = self._port.read(1)
            return first + self._port.read(min(self._port.in_waiting, size - 1)) if first else b""
        except (serial.SerialException, OSError, TypeError) as error:
            raise self._failed("receive", error) from error

    def _failed(self, operation: str, error: Exception) -> DeviceError:
        found = f"the line failed: {system_message(error)}"
        return self.broken(operation, f"{found}; was its cable pulled, or its path renamed?")

    def close(self) -> None:
        self._port.close()


def system_message(error: Exception) -> str:
    """Return the system's message alone: pyserial repeats the path and the error's number."""
    numbers = [getattr(each, "errno", None) for each in (error, error.__context__)]
    number = next(filter(None, numbers), None)
    if number == errno.EAGAIN:
        return "another program has it"
    return str(error) if number is None else os.strerror(number)


def open_link(device: Device, channel: str, check: Callable[[], None]) -> Link:
    """Open ``socket://HOST:PORT`` or ``PATH[@BAUD]``; raises `DeviceError`."""
    place = parse_channel(channel)
    if isinstance(place, Socket):
        return TcpLink(device, place.host, place.port, check)
    return SerialLink(device, place, check)


class TextLines:
    """Lines of ASCII text over one wire: whole lines in, whole lines out.

    A wrong baud rate or a line that failed in mid-byte shows as bytes that are no text: such a line
    is an error, never an answer. A line without an end is one, too.
    """

    MAX_LINE = 4096

    def __init__(
        self,
        link: Link,
        end: bytes = b"\r\n",
        split: bytes = rb"\r\n|\r|\n",
        *,
        letters: bool = False,
    ) -> None:
        """``end`` closes a line that is sent; the pattern ``split`` ends one that is received.

        ``letters``: letters of an unknown encoding may occur; each byte of them becomes a "?".
        """
        self.link = link
        self._text = re.compile(rb"[\t\x20-\x7e\x80-\xff]*" if letters else rb"[\t\x20-\x7e]*")
        self._end, self._split = end, re.compile(split)
        self._bytes = b""

    def send(self, line: str, operation: str) -> None:
        self.link.send(line.encode("ascii") + self._end, operation)

    def receive(self, deadline: Deadline) -> str | None:
        """Return the next line that is not empty, None after the ``deadline``.

        Raises `DeviceError` for a line that is no text, or too long.
        """
        while True:
            while (end := self._split.search(self._bytes)) is not None:
                line, self._bytes = self._bytes[: end.start()], self._bytes[end.end() :]
                if not self._text.fullmatch(line):
                    raise self.link.broken(
                        "receive", f"no text: {line[:40]!r}; is the baud rate right?"
                    )
                if line.strip():
                    return re.sub(rb"[\x80-\xff]", b"?", line).decode("ascii").strip()
            if len(self._bytes) > self.MAX_LINE:
                start = self._bytes[:40]
                raise self.link.broken("receive", f"a line without an end: {start!r} ..")
            if not (data := self.link.receive(self.MAX_LINE, deadline)):
                return None
            self._bytes += data

    @property
    def unended(self) -> int:
        """Return how many bytes of a line without an end have arrived."""
        return len(self._bytes)

    def drop_pending(self) -> None:
        """Drop all bytes that were received and not read."""
        self._bytes = b""
        while self.link.receive(self.MAX_LINE, Deadline(0.0)):
            pass
