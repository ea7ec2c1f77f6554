"""A wire between driver and device that fails on demand, whichever device is behind it."""

from __future__ import annotations

import math
import os
import select
import socket
import struct
import tempfile
import termios
import threading
import time
import tty
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

from hilcell.wire.channel import BAUD, SerialLine, Socket, addressed, wires_of
from hilcell.wire.relay import Door

PIECE = 65536


class End:
    """One end of a serial line."""

    def __init__(self, descriptor: int) -> None:
        os.set_blocking(descriptor, False)
        self._descriptor = descriptor

    def fileno(self) -> int:
        return self._descriptor

    def receive(self) -> bytes:
        """Return bytes that have come; none at the end."""
        return os.read(self.fileno(), PIECE)

    def send(self, data: bytes) -> None:
        """Send them; bytes that nobody reads are lost, as at a UART that overruns."""
        with suppress(BlockingIOError):
            while data:
                data = data[os.write(self._descriptor, data) :]

    def close(self, *, reset: bool) -> None:
        """Close it, by RST where it has one."""
        os.close(self._descriptor)

    def leave(self) -> None:
        """Close it when the other end has been closed, too: a line has no connections."""
        self.close(reset=False)


class _SocketEnd(End):
    """One end of a TCP connection."""

    RESET = struct.pack("ii", 1, 0)  # SO_LINGER: close by RST
    LEAVES_S = 1.0  # a device that has something under way may hold its end open

    def __init__(self, link: socket.socket) -> None:
        self._link = link
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def fileno(self) -> int:
        return self._link.fileno()

    def send(self, data: bytes) -> None:
        self._link.sendall(data)

    def close(self, *, reset: bool) -> None:
        with suppress(OSError):
            if reset:
                self._link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, self.RESET)
            else:
                self._link.shutdown(socket.SHUT_RDWR)
        self._link.close()

    def leave(self) -> None:
        """Close it when the other end has been closed, too, `LEAVES_S` later at the latest."""
        end_s = time.monotonic() + self.LEAVES_S
        with self._link, suppress(OSError):
            self._link.shutdown(socket.SHUT_WR)
            while (left_s := end_s - time.monotonic()) > 0:
                self._link.settimeout(left_s)
                if not self._link.recv(PIECE):
                    return


class Wire:
    """Hands bytes on between pairs of ends; ``mode`` says how.

    ``pass``, ``blackhole`` (all is swallowed, nothing closed), ``mute`` (answers are swallowed),
    ``hold`` (answers are kept until the mode changes), ``behind`` (what is kept comes right behind
    the driver's next request, `AHEAD_S` before its answer; where none is sent, after `BEHIND_S`),
    ``keep`` (answers pass, and are copied), ``again`` (the copy comes, once, right behind the
    driver's next request, `AHEAD_S` before its answer), ``garbage`` (in place of answers),
    ``flood`` (without end), ``slices`` (1 byte each), ``pieces`` (one byte, then the rest in two),
    ``glue``, ``slow`` (each piece of an answer ``delay_s`` late).
    ``rewrite``: bytes of answers to replace. ``asked`` is called before a request is handed on.
    """

    LOOK_S = 0.05
    BEHIND_S = 0.3
    AHEAD_S = 0.05  # of an old answer to the right one
    NOISE = b"t" * 4096  # a line that never ends, a length that no packet has

    def __init__(self) -> None:
        self.mode, self.delay_s = "pass", 0.0
        self.rewrite: dict[bytes, bytes] = {}
        self.asked: Callable[[], None] = lambda: None
        self._ended = False
        self._lock = threading.Lock()
        self._pairs: list[tuple[End, End]] = []
        self._threads: list[threading.Thread] = []

    def reset(self) -> None:
        """Break every connection, by RST where there is one."""
        with self._lock:
            pairs, self._pairs = self._pairs, []
        for pair in pairs:
            for each in pair:
                each.close(reset=True)

    def close(self) -> None:
        self._ended = True
        self.reset()
        for thread in self._threads:
            thread.join()

    def _start(self, near: End, far: End) -> None:
        with self._lock:
            self._pairs.append((near, far))
        thread = threading.Thread(target=self._pump, args=(near, far), daemon=True)
        self._threads.append(thread)
        thread.start()

    def _pump(self, near: End, far: End) -> None:
        kept, copy, due_s = b"", b"", math.inf
        with suppress(OSError, ValueError):
            while not self._ended:
                ready, _, _ = select.select([near, far], [], [], self.LOOK_S)
                if self.mode == "flood":
                    near.send(self.NOISE)
                now_s = time.monotonic()
                due_s = min(due_s, now_s + self.BEHIND_S) if self.mode == "behind" else math.inf
                asked = near in ready and (data := self._received(near))
                if asked:
                    self.asked()
                    self._pieces(data, far)
                if asked and copy and self.mode == "again":
                    near.send(copy)
                    copy = b""
                    time.sleep(self.AHEAD_S)
                late = self.mode == "behind" and not asked and now_s < due_s
                if kept and not late and self.mode not in ("hold", "mute"):
                    near.send(kept)
                    kept = b""
                    if self.mode == "behind":
                        time.sleep(self.AHEAD_S)
                if far in ready and (data := self._received(far)):
                    mode = self.mode  # another thread may have changed it in this round
                    if mode == "hold" or (kept and mode == "behind"):
                        kept += data
                    else:
                        if kept and mode != "mute":
                            near.send(kept)
                            kept = b""
                        copy += data if mode == "keep" else b""
                        self._answer(data, near)
        near.close(reset=False)
        far.leave()

    def _received(self, end: End) -> bytes:
        """Return what has come and may pass; raises OSError at the end."""
        glue_s = 0.004  # replies that come within this time leave as one
        if self.mode == "glue":
            time.sleep(glue_s)
        data = end.receive()
        if not data:
            raise OSError("the other end has closed it")
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
        self._pieces(data, to)

    def _pieces(self, data: bytes, to: End) -> None:
        apart_s = 0.0005  # the system would hand pieces on together
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


class Proxy(Wire):
    """A wire over TCP: listens on a ``port`` of its own before the device's."""

    def __init__(self, place: Socket) -> None:
        super().__init__()
        self._behind = place
        self._door = Door(self._entered)
        self.port, self.channel = self._door.port, self._door.channel  # the driver's end

    def lead_to(self, place: Socket | SerialLine) -> None:
        """Lead to another place from the next connection on."""
        if isinstance(place, Socket):
            self._behind = place

    def drop(self) -> None:
        """End every connection, also one that was not taken yet; the device has seen it then."""
        self._door.close()
        with self._lock:
            pairs, self._pairs = self._pairs, []
            threads, self._threads = self._threads, []
        for near, _ in pairs:
            near.close(reset=False)
        for thread in threads:
            thread.join()
        self.admit()

    def refuse(self) -> None:
        """Break every connection, and take none."""
        self._door.close()
        self.reset()

    def admit(self) -> None:
        self._door = Door(self._entered, self.port)

    def close(self) -> None:
        self._ended = True
        self._door.close()
        super().close()

    def _entered(self, near: socket.socket) -> None:
        try:
            far = socket.create_connection((self._behind.host, self._behind.port))
        except OSError:
            near.close()
        else:
            self._start(_SocketEnd(near), _SocketEnd(far))


class Line(Wire):
    """A wire of pseudo terminals before a serial line; ``path`` is the driver's end."""

    def __init__(self, place: SerialLine) -> None:
        super().__init__()
        self._behind = place
        self._folder = tempfile.TemporaryDirectory(prefix="hilcell-line-")
        self.path = f"{self._folder.name}/line"
        self._ours = -1  # the driver's end, kept open: a line has no connections
        self.admit()

    @property
    def channel(self) -> str:
        """Return the driver's end, at the baud rate that was stated."""
        baud = self._behind.baud
        return self.path if baud == BAUD else f"{self.path}@{baud}"

    def lead_to(self, place: Socket | SerialLine) -> None:
        """Lead to another line after the next `admit`."""
        if isinstance(place, SerialLine):
            self._behind = place

    def drop(self) -> None:
        """Leave the line as it is: it has no connections."""

    def refuse(self) -> None:
        """Unplug the line."""
        self.reset()

    def reset(self) -> None:
        """Unplug the line. Only its pump closes it: its numbers name other files from then on."""
        self._ended = True
        for thread in self._threads:
            thread.join()
        self._pairs, self._threads = [], []
        with suppress(OSError):
            os.close(self._ours)
        self._ours = -1
        Path(self.path).unlink(missing_ok=True)

    def admit(self) -> None:
        self._ended = False
        near, self._ours = os.openpty()
        far = os.open(self._behind.path, os.O_RDWR | os.O_NOCTTY)
        for each in (near, self._ours, far):
            with suppress(termios.error):
                tty.setraw(each)
        Path(self.path).symlink_to(os.ttyname(self._ours))
        self._start(End(near), End(far))

    def close(self) -> None:
        super().close()
        self._folder.cleanup()


class Wires:
    """The wires before all places of devices; ``options`` lead their drivers through them.

    Devices are known by their tables, places by the options that their drivers state.
    """

    def __init__(self, stated: Mapping[str, Mapping[str, object]]) -> None:
        self._wires: dict[str, Proxy | Line] = {}
        self.options: dict[str, dict[str, object]]
        self._asking, self._asked, self._hold_from = threading.Lock(), 0, math.inf
        self.lead_to(stated)

    @property
    def all(self) -> list[Proxy | Line]:
        return list(self._wires.values())

    def lead_to(self, stated: Mapping[str, Mapping[str, object]]) -> None:
        """Lead to where the devices listen now."""
        for name, place in wires_of(stated).items():
            if name in self._wires:
                self._wires[name].lead_to(place)
            elif isinstance(place, Socket):
                self._wires[name] = Proxy(place)
            elif Path(place.path).is_char_device():
                self._wires[name] = Line(place)
            else:
                continue
            self._wires[name].asked = self._count
        self.options = addressed(stated, {name: e.channel for name, e in self._wires.items()})

    def set(self, mode: str, delay_s: float = 0.0) -> None:
        for each in self.all:
            each.mode, each.delay_s = mode, delay_s

    def hold_after(self, requests: int) -> None:
        """Hand on so many more requests with their answers; keep the answers to all later ones."""
        with self._asking:
            self._hold_from = self._asked + requests

    def _count(self) -> None:
        with self._asking:
            if self._asked >= self._hold_from:
                self._hold_from = math.inf
                self.set("hold")
            self._asked += 1

    def rewrite(self, old: bytes, new: bytes) -> None:
        """Replace bytes of all answers from now on."""
        for each in self.all:
            each.rewrite[old] = new

    def straight(self) -> None:
        """Hand everything on as it is."""
        self._hold_from = math.inf
        for each in self.all:
            each.mode, each.rewrite = "pass", {}

    def drop(self) -> None:
        """End all connections that there are; a serial line has none."""
        for each in self.all:
            each.drop()

    def refuse(self) -> None:
        """Break all connections, and take none."""
        for each in self.all:
            each.refuse()

    def admit(self) -> None:
        for each in self.all:
            each.admit()

    def close(self) -> None:
        for each in self.all:
            each.close()
