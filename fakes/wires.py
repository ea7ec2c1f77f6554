"""How simulated devices receive and answer: a TCP server, a serial line, late and cut segments.

A server on loopback has a blocking thread a client. Bytes leave sometimes late, and sometimes in
two segments, as with real devices; which ones depends on the number of sends over the connection,
so they are the same in each run.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import socket
import threading
import time
import tty
from collections.abc import Callable, Mapping
from typing import Protocol

from fakes.faults import Faults, Vanished
from hilcell.ports import HilcellError

HOST = "127.0.0.1"
RECEIVE = 4096


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

    ``serve`` returns when the client is done; OSError from a broken connection ends it too. Where
    it raises `Vanished`, the device is gone: ``vanish`` closes every socket, by default this one's.
    """

    def __init__(
        self,
        name: str,
        serve: Callable[[socket.socket], None],
        *,
        limit: int = 10,
        port: int = 0,
        accepted: Callable[[socket.socket], None] | None = None,
        vanish: Callable[[], None] | None = None,
    ) -> None:
        """``accepted`` takes note of each client, in the order in which they come."""
        self._name, self._serve, self._limit = name, serve, limit
        self._accepted, self._vanish = accepted, vanish or self.hang_up
        self._socket = listen(port)
        self.port: int = self._socket.getsockname()[1]
        self.channel = f"socket://{HOST}:{self.port}"
        self._lock = threading.Lock()
        self._clients: dict[socket.socket, threading.Thread] = {}
        self._accepting = threading.Thread(target=self._accept, name=name, daemon=True)

    def start(self) -> None:
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
            try:
                self._serve(client)
            except Vanished:
                self._vanish()
        with self._lock:
            del self._clients[client]


class SerialEnd:
    """A serial device's end of a line, which a pseudo terminal stands for; it has no connections.

    Both ends are kept open, as a cable is: the line stays when its user goes. Used like a client's
    socket, by one thread. Bytes that are not read within ``patience_s`` are lost, as on any UART.
    """

    def __init__(self, patience_s: float | None = None) -> None:
        self._patience_s = patience_s
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.channel = os.ttyname(self._theirs)
        self._open = True

    def fileno(self) -> int:
        return self._ours

    def recv(self, size: int, /) -> bytes:
        return os.read(self._ours, size)

    def sendall(self, data: bytes, /) -> None:
        """Send bytes; those that the line does not take in time are lost."""
        while data and select.select([], [self._ours], [], self._patience_s)[1]:
            data = data[os.write(self._ours, data) :]

    def close(self) -> None:
        """Unplug the device; a second close does nothing."""
        if self._open:
            self._open = False
            os.close(self._ours)
            os.close(self._theirs)


class Wire(Protocol):
    """Both directions of one connection."""

    def sendall(self, data: bytes, /) -> None:
        """Send all of ``data``."""

    def receive(self, timeout_s: float | None) -> bytes:
        """Return bytes, none after the timeout; raises `OSError` at the end."""


class SerialLine(SerialEnd):
    """Serves a serial line in one thread, as a `Listener` serves clients; it is a `Wire`."""

    def __init__(self, name: str, serve: Callable[[Wire], None]) -> None:
        super().__init__()
        self._serve = serve
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        """End the thread and unplug the device."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()
        super().close()

    def receive(self, timeout_s: float | None) -> bytes:
        ends_s = float("inf") if timeout_s is None else time.monotonic() + timeout_s
        look_s = 0.05
        while not self._closing.is_set():
            left_s = min(look_s, ends_s - time.monotonic())
            if left_s <= 0:
                return b""
            if select.select([self], [], [], left_s)[0]:
                return self.recv(RECEIVE)
        raise ConnectionAbortedError

    def _run(self) -> None:
        with contextlib.suppress(OSError, Vanished):
            self._serve(self)
        super().close()  # pulled out


class Connection:
    """A client's TCP connection as a `Wire`."""

    def __init__(self, client: socket.socket) -> None:
        self._client, self.sendall = client, client.sendall

    def receive(self, timeout_s: float | None) -> bytes:
        self._client.settimeout(timeout_s)
        try:
            data = self._client.recv(RECEIVE)
        except TimeoutError:
            return b""
        finally:
            self._client.settimeout(None)
        if not data:
            raise ConnectionAbortedError
        return data


class Server:
    """A simulated device behind what it listens on; satisfies `fakes.site.SimulatedDevice`."""

    def __init__(
        self,
        address: Mapping[str, object],
        *listeners: Listener | SerialLine | Server,
        restore: Callable[[], None] = lambda: None,  # its faults pass by themselves
    ) -> None:
        self.address: dict[str, object] = {**address}
        self.restore = restore
        self._listeners = listeners
        self._closing = threading.Event()

    def start(self) -> None:
        for each in self._listeners:
            each.start()

    def close(self) -> None:
        self._closing.set()
        for each in self._listeners:
            each.close()


class Segments:
    """The sending side of one connection, by what ``sends`` all bytes that it is given."""

    SPLIT_EVERY = 7
    LATE_EVERY, LATE_S = 47, 0.001

    def __init__(self, sends: Callable[[bytes], object]) -> None:
        self._sends = sends
        self.sent = 0

    def send(self, data: bytes) -> None:
        """Send ``data``; raises `OSError`."""
        self.sent += 1
        if self.sent % self.LATE_EVERY == 0:
            time.sleep(self.LATE_S)
        apart_every, apart_s = 3 * self.SPLIT_EVERY, 0.0005  # so that each half is read by itself
        if self.sent % self.SPLIT_EVERY == 0 and len(data) > 1:
            cut = 1 + self.sent % (len(data) - 1)
            self._sends(data[:cut])
            data = data[cut:]
            if self.sent % apart_every == 0:
                time.sleep(apart_s)
        self._sends(data)

    def send_in_two(self, data: bytes, cut: int) -> None:
        """Send ``data`` so that its first ``cut`` bytes are read by themselves."""
        self._sends(data[:cut])
        time.sleep(0.02)
        self.send(data[cut:])


class Answers:
    """The sending side of a robot's server: an answer changed by its faults, else by `Segments`."""

    def __init__(self, faults: Faults, closing: threading.Event) -> None:
        """``closing`` ends a wait for a late answer."""
        self._faults, self._closing = faults, closing

    def send(self, client: socket.socket, segments: Segments, answer: bytes) -> bool:
        """Send an answer; return whether the client stays connected."""
        strikes = self._faults.strikes
        if strikes("robot.idle_close"):
            return False
        if strikes("robot.half_open"):
            client.settimeout(None)
            while client.recv(RECEIVE):  # no answer until the client has closed
                pass
            return False
        if strikes("robot.no_reply"):
            return True
        late_s = self._faults.number("robot.late_reply")
        if late_s is not None:
            self._closing.wait(late_s)
        if strikes("robot.split_reply"):
            segments.send_in_two(answer, len(answer) // 2)
        else:
            segments.send(answer)
        return True


class LineSession:
    """Whole lines in, whole lines out; ``late`` wait for the next answer."""

    def __init__(self, wire: Wire) -> None:
        self._wire, self._segments = wire, Segments(wire.sendall)
        self._pending = b""
        self.lines: list[bytes] = []
        self.late: list[bytes] = []

    def say(self, line: bytes) -> None:
        self._segments.send(line + b"\r\n")

    def answer(self, line: bytes, faults: Faults) -> None:
        """Send a line after the late ones; a fault delays it, too, or splits it."""
        if faults.strikes("tracker.late_result"):
            self.late.append(line)
            return
        self.say_late()
        if faults.strikes("tracker.split_packet"):
            self._segments.send_in_two(line + b"\r\n", 5)
        else:
            self.say(line)

    def say_late(self) -> None:
        for late in self.late:
            self.say(late)
        self.late.clear()

    def line(self, timeout_s: float | None) -> bytes | None:
        """Return the next line that is not empty, None after the timeout."""
        if not self.lines:
            self.receive(timeout_s)
        return self.lines.pop(0) if self.lines else None

    def receive(self, timeout_s: float | None) -> None:
        *lines, self._pending = re.split(rb"[\r\n]", self._pending + self._wire.receive(timeout_s))
        self.lines += [line for line in lines if line]
