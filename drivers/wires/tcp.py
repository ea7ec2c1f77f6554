"""A device's wire, whose every wait ends within 20 ms of a stop; here a TCP connection.

By default keepalive notices a dead peer after two hours. So the probe times are set, unsent bytes
expire by TCP_USER_TIMEOUT where the system has it, and every read has a deadline. It counts from
bytes that are not there, never from the clock of a thread that did not run.
"""

from __future__ import annotations

import errno
import select
import socket
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress

from drivers.device_errors import Device
from drivers.supervision import Patience
from hilcell.ports import DeviceError

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
    def _come(self, size: int, *, wait: bool) -> bytes:
        """Return what has come, or comes within `POLL_S`; raises `DeviceError` at the end."""

    def receive(self, size: int, patience: Patience) -> bytes:
        """Return 1 to ``size`` bytes, or none when ``patience`` is over; raises `DeviceError`."""
        while True:
            self._check()
            over = patience.over()
            if (data := self._come(size, wait=not over)) or over:
                return data

    def broken(self, operation: str, found: str) -> DeviceError:
        """Return the error that this wire's failure is."""
        return self._device.broken(self.address, operation, found)


class TcpLink(Link):
    """A connected socket."""

    CONNECT_S = 3.0
    LEAVE_S = 0.5
    KEEPALIVE_S = 5
    UNSENT_MS = 5000

    def __init__(self, device: Device, host: str, port: int, check: Callable[[], None]) -> None:
        super().__init__(device, f"{host}:{port}", check)
        self.unheard = False  # something was sent whose answer nobody awaits
        try:
            self._socket = socket.create_connection((host, port), timeout=self.CONNECT_S)
        except OSError as error:
            raise device.unreached(self.address, str(error)) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        probes = {"TCP_KEEPIDLE": self.KEEPALIVE_S, "TCP_KEEPINTVL": 1, "TCP_KEEPCNT": 3}
        # Not every system names all of these; the deadlines of the reads hold without them.
        for name, value in (probes | {"TCP_USER_TIMEOUT": self.UNSENT_MS}).items():
            if hasattr(socket, name):
                self._socket.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
        self._socket.setblocking(False)  # a wait is a call of its own, and most bytes need none

    def send(self, data: bytes, operation: str) -> None:
        patience = Patience(SEND_S)
        rest = memoryview(data)
        while rest:
            over = patience.over()
            try:
                rest = rest[self._socket.send(rest) :]
            except BlockingIOError:
                if over:
                    raise self.broken(operation, "the device takes no bytes") from None
                select.select([], [self._socket], [], POLL_S)
            except OSError as error:
                raise self.broken(operation, _words(error)) from error

    def _come(self, size: int, *, wait: bool) -> bytes:
        try:
            ready, _, _ = select.select([self._socket], [], [], POLL_S if wait else 0.0)
            data = self._socket.recv(size) if ready else b""
        except BlockingIOError:  # ready, and then nothing after all: the next look tells
            return b""
        except (OSError, ValueError) as error:
            raise self.broken("receive", _words(error)) from error
        if ready and not data:
            raise self.broken("receive", "the device closed the connection")
        return data

    def close(self) -> None:
        """Close the socket; a second close does nothing.

        After a stop that nobody waited for, the device first takes it, or `LEAVE_S` pass: it could
        otherwise arrive behind what the next connection says.
        """
        if self.unheard:
            self.unheard = False
            with suppress(OSError, ValueError):
                self._leave()
        self._socket.close()

    def _leave(self) -> None:
        """End what is sent; return when the device has closed its end, too."""
        patience = Patience(self.LEAVE_S)
        self._socket.shutdown(socket.SHUT_WR)
        while not patience.over():
            ready, _, _ = select.select([self._socket], [], [], POLL_S)
            if ready and not self._socket.recv(4096):
                return


def _words(error: OSError | ValueError) -> str:
    """Return the system's words; a socket that this program has closed has no number any more."""
    closed = isinstance(error, ValueError) or error.errno == errno.EBADF
    return "this program has closed the connection" if closed else str(error)
