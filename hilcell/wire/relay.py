"""Relays between drivers and devices: bytes pass in both directions, recorded or falsified.

``python -P -m hilcell.wire.relay`` records: it reads its orders, one line of JSON, prints its
addresses, and ends with its input. As a process of its own it delays no stop frame. A device that
does not answer, or closes, looks to the driver like a closed wire. Conformance tests and campaigns
use `Relay.mode` to falsify.
"""

from __future__ import annotations

import math
import os
import pty
import select
import socket
import struct
import sys
import tempfile
import termios
import threading
import time
import tty
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path

import msgspec
import serial

from hilcell.decoding import decoded
from hilcell.wire.channel import BAUD, SerialLine, Socket, wire_places, with_addresses
from hilcell.wire.recording import Event, Recorder, RelayOrder

READ = 65536  # bytes


class Acceptor:
    """Listens in place of a device, and hands on each connection of a driver at once."""

    def __init__(self, on_connection: Callable[[socket.socket], None], port: int = 0) -> None:
        loopback = "127.0.0.1"
        self._on_connection = on_connection
        self._listening = socket.create_server((loopback, port))
        self.port: int = self._listening.getsockname()[1]
        self.channel = f"socket://{loopback}:{self.port}"
        self._accepting = threading.Thread(target=self._accept, daemon=True)
        self._accepting.start()

    def close(self) -> None:
        """Accept no more connections; the last one has been handed on."""
        with suppress(OSError):
            self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        self._accepting.join()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listening.accept()
            except OSError:
                return
            self._on_connection(near)


class End:
    """One end of a wire. `send` never waits, so no side delays the other, and loses nothing."""

    on_bytes: Callable[[bytes], None]

    def __init__(self, descriptor: int, close: Callable[[], None]) -> None:
        os.set_blocking(descriptor, False)
        self._descriptor, self._close, self._unsent = descriptor, close, b""

    @property
    def full(self) -> bool:
        """Whether bytes wait for the other side to read."""
        return bool(self._unsent)

    def fileno(self) -> int:
        return self._descriptor

    def receive(self) -> bytes:
        return os.read(self._descriptor, READ)

    def send(self, data: bytes) -> None:
        self._unsent += data
        self.flush()

    def flush(self) -> None:
        """Send waiting bytes, as far as the other side reads them."""
        with suppress(BlockingIOError):
            while self._unsent:
                self._unsent = self._unsent[self._write(self._unsent) :]

    def _write(self, data: bytes) -> int:
        return os.write(self._descriptor, data)

    def close(self, *, reset: bool = False) -> None:
        """Close it, by RST where there is one."""
        self._close()

    def leave(self) -> None:
        """Close it when the other side has closed, too: a line has no connections."""
        self.close()


class DriverLine(End):
    """The driver's end of a serial line: bytes not read in time are lost, as at any UART."""

    def flush(self) -> None:
        super().flush()
        self._unsent = b""


class SocketEnd(End):
    """One end of a TCP connection; any thread may close it, so no descriptor outlives it."""

    RESET = struct.pack("ii", 1, 0)  # SO_LINGER: close by RST
    LEAVE_S = 1.0  # a device that is busy may keep its end open

    def __init__(self, link: socket.socket) -> None:
        super().__init__(link.fileno(), link.close)
        self._link = link
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def fileno(self) -> int:
        return self._link.fileno()

    def receive(self) -> bytes:
        return self._link.recv(READ)

    def _write(self, data: bytes) -> int:
        return self._link.send(data)

    def close(self, *, reset: bool = False) -> None:
        with suppress(OSError):
            if reset:
                self._link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, self.RESET)
            else:
                self._link.shutdown(socket.SHUT_RDWR)
        self._link.close()

    def leave(self) -> None:
        """Send the rest, and close when the other side has closed, `LEAVE_S` later at most."""
        end_s = time.monotonic() + self.LEAVE_S
        with self._link, suppress(OSError):
            self._link.settimeout(self.LEAVE_S)
            self._link.sendall(self._unsent)
            self._link.shutdown(socket.SHUT_WR)
            while (left_s := end_s - time.monotonic()) > 0:
                self._link.settimeout(left_s)
                if not self._link.recv(READ):
                    return


class Closed(OSError):
    """The other side of an ``end`` has closed it."""

    def __init__(self, end: End) -> None:
        super().__init__("closed")
        self.end = end


class Relay(ABC):
    """Passes bytes between pairs of ends; ``mode`` states how.

    ``pass``, ``blackhole`` (all is dropped, nothing closed), ``mute`` (answers are dropped),
    ``hold`` (answers wait until the mode changes), ``behind`` (waiting answers come right behind
    the driver's next request, `AHEAD_S` before its answer; without a request after `BEHIND_S`),
    ``keep`` (answers pass, and are copied), ``again`` (the copy comes, once, right behind the
    driver's next request, `AHEAD_S` before its answer), ``garbage`` (in place of answers),
    ``flood`` (without end), ``slices`` (1 byte each), ``pieces`` (one byte, then the rest in two),
    ``glue``, ``slow`` (each piece of an answer ``delay_s`` late).

    ``rewrite``: bytes of answers to replace. ``on_request`` is called before a request passes.
    """

    POLL_S = 0.05
    BEHIND_S = 0.3
    AHEAD_S = 0.05  # of an old answer to the right one
    NOISE = b"t" * 4096  # a line that never ends, a length that no packet has

    channel: str  # the driver's end

    def __init__(self, recorder: Recorder | None = None) -> None:
        self.mode, self.delay_s = "pass", 0.0
        self.rewrite: dict[bytes, bytes] = {}
        self.on_request: Callable[[], None] = lambda: None
        self._recorder, self._count = recorder, 0
        self._ended = False
        self._lock = threading.Lock()
        self._pairs: list[tuple[End, End]] = []
        self._threads: list[threading.Thread] = []

    @abstractmethod
    def lead_to(self, place: Socket | SerialLine) -> None:
        """Lead to another place from the next connection on."""

    @abstractmethod
    def drop(self) -> None:
        """End every connection, also one that was not accepted yet; a line has none."""

    @abstractmethod
    def reset(self) -> None:
        """Break every connection, by RST where there is one."""

    @abstractmethod
    def refuse(self) -> None:
        """Break every connection, and accept none."""

    @abstractmethod
    def admit(self) -> None: ...

    def close(self) -> None:
        """End every connection; a recording without its end would look cut off."""
        self._ended = True
        for thread in self._threads:
            thread.join()

    def _record(self, connection: int, event: Event, data: bytes = b"") -> None:
        if self._recorder is not None:
            self._recorder.record(connection, event, data)

    def _start(self, near: End, far: End) -> None:
        self._record(self._count, "open")
        with self._lock:
            self._pairs.append((near, far))
        near.on_bytes = partial(self._record, self._count, ">")
        far.on_bytes = partial(self._record, self._count, "<")
        thread = threading.Thread(target=self._serve, args=(near, far, self._count), daemon=True)
        self._threads.append(thread)
        thread.start()

    def _serve(self, near: End, far: End, connection: int) -> None:
        events: tuple[Event, ...] = ("end", "lost")
        try:
            self._pump(near, far)
            events = ("end",)
        except Closed as closed:
            events = events if closed.end is near else events[::-1]
        except (OSError, ValueError):
            pass
        for event in events:
            self._record(connection, event)
        with suppress(OSError):
            near.flush()
        near.close()
        far.leave()

    def _pump(self, near: End, far: End) -> None:
        """Pass bytes until the relay is closed; raises `Closed`, `OSError`, `ValueError`."""
        held, copy, due_s = b"", b"", math.inf
        while not self._ended:
            ready = self._poll(near, far)
            if self.mode == "flood":
                near.send(self.NOISE)
            now_s = time.monotonic()
            due_s = min(due_s, now_s + self.BEHIND_S) if self.mode == "behind" else math.inf
            asked = near in ready and (data := self._received(near))
            if asked:
                self.on_request()
                self._send(data, far)
            if asked and copy and self.mode == "again":
                near.send(copy)
                copy = b""
                time.sleep(self.AHEAD_S)
            late = self.mode == "behind" and not asked and now_s < due_s
            if held and not late and self.mode not in ("hold", "mute"):
                near.send(held)
                held = b""
                if self.mode == "behind":
                    time.sleep(self.AHEAD_S)
            if far in ready and (data := self._received(far)):
                mode = self.mode  # another thread may have changed it in this round
                if mode == "hold" or (held and mode == "behind"):
                    held += data
                else:
                    if held and mode != "mute":
                        near.send(held)
                        held = b""
                    copy += data if mode == "keep" else b""
                    self._answer(data, near)

    def _poll(self, near: End, far: End) -> list[End]:
        """Ends that have bytes; one whose bytes the other cannot take has to wait."""
        readers = [one for one, other in ((near, far), (far, near)) if not other.full]
        ready, writable, _ = select.select(
            readers, [each for each in (near, far) if each.full], [], self.POLL_S
        )
        for each in writable:
            each.flush()
        return ready

    def _received(self, end: End) -> bytes:
        """Bytes that have arrived and may pass; raises `Closed` at the end."""
        glue_s = 0.004  # replies that arrive within this time leave as one
        if self.mode == "glue":
            time.sleep(glue_s)
        data = end.receive()
        if not data:
            raise Closed(end)
        end.on_bytes(data)
        return b"" if self.mode in ("blackhole", "flood") else data

    def _answer(self, data: bytes, to: End) -> None:
        if self.mode == "mute":
            return
        if self.mode == "garbage":
            data = self.NOISE[: len(data)]
        if self.mode == "slow":
            time.sleep(self.delay_s)
        for old, new in self.rewrite.items():
            data = data.replace(old, new)
        self._send(data, to)

    def _send(self, data: bytes, to: End) -> None:
        apart_s = 0.0005  # the system would pass pieces on together
        if self.mode == "slices":
            for byte in data:
                to.send(bytes((byte,)))
        elif self.mode == "pieces":
            middle = 1 + len(data) // 2
            for piece in filter(None, (data[:1], data[1:middle], data[middle:])):
                to.send(piece)
                time.sleep(apart_s)
        else:
            to.send(data)


class SocketRelay(Relay):
    """Listens on a ``port`` of its own, and connects to the device for each connection."""

    CONNECT_S = 3.0

    def __init__(self, place: Socket, recorder: Recorder | None = None) -> None:
        super().__init__(recorder)
        self._place = place
        self._acceptor = Acceptor(self._connect)
        self.port, self.channel = self._acceptor.port, self._acceptor.channel

    def lead_to(self, place: Socket | SerialLine) -> None:
        if isinstance(place, Socket):
            self._place = place

    def drop(self) -> None:
        """End every connection, also one not accepted yet; the device has then received the end."""
        self._acceptor.close()
        with self._lock:
            pairs, self._pairs = self._pairs, []
            threads, self._threads = self._threads, []
        for near, _ in pairs:
            near.close()
        for thread in threads:
            thread.join()
        self.admit()

    def reset(self) -> None:
        with self._lock:
            pairs, self._pairs = self._pairs, []
        for pair in pairs:
            for each in pair:
                each.close(reset=True)

    def refuse(self) -> None:
        self._acceptor.close()
        self.reset()

    def admit(self) -> None:
        self._acceptor = Acceptor(self._connect, self.port)

    def close(self) -> None:
        self._ended = True
        self._acceptor.close()
        super().close()

    def _connect(self, near: socket.socket) -> None:
        self._count += 1
        try:
            far = socket.create_connection((self._place.host, self._place.port), self.CONNECT_S)
        except OSError as error:
            self._record(self._count, "refused", str(error).encode())
            near.close()
        else:
            self._start(SocketEnd(near), SocketEnd(far))


class SerialRelay(Relay):
    """A pseudo terminal in place of a serial line; ``path`` is the driver's end.

    The line is one connection while it is plugged in: a driver may close and come again. The
    constructor raises `OSError` where the line cannot be opened.
    """

    def __init__(self, place: SerialLine, recorder: Recorder | None = None) -> None:
        super().__init__(recorder)
        self._place = place
        self._folder = tempfile.TemporaryDirectory(prefix="hilcell-line-")
        self.path = f"{self._folder.name}/line"
        self.channel = self.path if place.baud == BAUD else f"{self.path}@{place.baud}"
        self._driver_end = -1  # kept open
        try:
            self.admit()
        except OSError:
            self._folder.cleanup()
            raise

    def lead_to(self, place: Socket | SerialLine) -> None:
        """Lead to another line after the next `admit`."""
        if isinstance(place, SerialLine):
            self._place = place

    def drop(self) -> None:
        """Leave the line as it is: it has no connections."""

    def refuse(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Unplug the line. Only its pump closes it: its descriptors name other files afterwards."""
        self._ended = True
        for thread in self._threads:
            thread.join()
        self._pairs, self._threads = [], []
        with suppress(OSError):
            os.close(self._driver_end)
        self._driver_end = -1
        Path(self.path).unlink(missing_ok=True)

    def admit(self) -> None:
        self._ended = False
        port = serial.Serial(self._place.path, self._place.baud, timeout=0, exclusive=True)
        near, self._driver_end = pty.openpty()
        for each in (near, self._driver_end):
            with suppress(termios.error):
                tty.setraw(each)
        Path(self.path).symlink_to(os.ttyname(self._driver_end))
        self._count += 1
        self._start(DriverLine(near, partial(os.close, near)), End(port.fileno(), port.close))

    def close(self) -> None:
        self.reset()
        self._folder.cleanup()


def relay_to(place: Socket | SerialLine, recorder: Recorder | None = None) -> Relay:
    """A relay before an address; raises `OSError` where a serial line cannot be opened."""
    if isinstance(place, Socket):
        return SocketRelay(place, recorder)
    return SerialRelay(place, recorder)


class Relays:
    """Relays before all addresses of devices; ``options`` lead their drivers through them."""

    def __init__(self, stated: Mapping[str, Mapping[str, object]]) -> None:
        self._relays: dict[str, Relay] = {}
        self.options: dict[str, dict[str, object]]
        self._counting, self._requests, self._hold_from = threading.Lock(), 0, math.inf
        self.lead_to(stated)

    @property
    def all(self) -> list[Relay]:
        return list(self._relays.values())

    def lead_to(self, stated: Mapping[str, Mapping[str, object]]) -> None:
        for name, place in wire_places(stated).items():
            if name in self._relays:
                self._relays[name].lead_to(place)
            elif isinstance(place, Socket) or Path(place.path).is_char_device():
                self._relays[name] = relay_to(place)
            else:
                continue
            self._relays[name].on_request = self._on_request
        self.options = with_addresses(stated, {name: e.channel for name, e in self._relays.items()})

    def set_mode(self, mode: str, delay_s: float = 0.0) -> None:
        for each in self.all:
            each.mode, each.delay_s = mode, delay_s

    def hold_after(self, requests: int) -> None:
        """Pass this number of requests with their answers; hold the answers to all later ones."""
        with self._counting:
            self._hold_from = self._requests + requests

    def _on_request(self) -> None:
        with self._counting:
            if self._requests >= self._hold_from:
                self._hold_from = math.inf
                self.set_mode("hold")
            self._requests += 1

    def rewrite(self, old: bytes, new: bytes) -> None:
        for each in self.all:
            each.rewrite[old] = new

    def pass_all(self) -> None:
        self._hold_from = math.inf
        for each in self.all:
            each.mode, each.rewrite = "pass", {}

    def drop(self) -> None:
        for each in self.all:
            each.drop()

    def refuse(self) -> None:
        for each in self.all:
            each.refuse()

    def admit(self) -> None:
        for each in self.all:
            each.admit()

    def close(self) -> None:
        for each in self.all:
            each.close()


def main() -> None:
    """Read orders from stdin, print the channels by wire name, and relay."""
    orders = decoded(sys.stdin.buffer.readline(), list[RelayOrder])
    with ExitStack() as stack:
        channels: dict[str, str] = {}
        for order in orders:
            file = stack.enter_context(Path(order.file).open("ab"))
            recorder = Recorder(file, order.began_s)
            recorder.record(0, "began", order.wire.encode())
            relay = relay_to(order.place, recorder)
            channels[order.wire] = relay.channel
            stack.callback(relay.close)
        sys.stdout.buffer.write(msgspec.json.encode(channels) + b"\n")
        sys.stdout.buffer.flush()
        sys.stdin.buffer.read()


if __name__ == "__main__":
    main()
