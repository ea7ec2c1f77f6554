"""An slcan gateway with a CiA 402 drive and a CiA 406 strip behind it, for tests.

The drive steps a third of its way at each SYNC. Every fault that a test wants is an attribute.
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import threading
from collections.abc import Callable

from tests.drivers.peers import Server

DRIVE, STRIP = 5, 6
HEARTBEAT_S = 0.05
STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0x04, 0x05, 0x7F
NO_RTR = 1 << 30  # of a PDO's COB-ID: its maker's devices answer no remote frame
HUNTING = (2, -1, 0, -3, 1, 2, -2)  # counts
DISABLED, READY, SWITCHED_ON, ENABLED, QUICK, FAULT = 0x40, 0x21, 0x23, 0x27, 0x07, 0x08


def u8(value: int) -> bytes:
    return struct.pack("<B", value)


def u16(value: int) -> bytes:
    return struct.pack("<H", value)


def u32(value: int) -> bytes:
    return struct.pack("<I", value)


def i32(value: int) -> bytes:
    return struct.pack("<i", value)


def pdo_objects(communication: int, mapping: int) -> dict[tuple[int, int], bytes]:
    objects = {(communication, 1): u32(NO_RTR), (communication, 2): u8(0), (mapping, 0): u8(0)}
    return objects | {(mapping, sub): u32(0) for sub in (1, 2)}


def common(device_type: int, product: int) -> dict[tuple[int, int], bytes]:
    return {
        (0x1000, 0): u32(device_type),
        (0x1001, 0): u8(0),
        (0x1017, 0): u16(0),
        (0x1018, 0): u8(4),
        (0x1018, 1): u32(0x484),
        (0x1018, 2): u32(product),
        (0x1018, 3): u32(1),
        (0x1018, 4): u32(4711),
    }


def drive_objects() -> dict[tuple[int, int], bytes]:
    words = {index: u16(0) for index in (0x6007, 0x603F, 0x6040, 0x605A, 0x605E)}
    longs = {index: u32(0) for index in (0x607C, 0x6081, 0x6083, 0x6084, 0x6085, 0x609A)}
    plain = words | longs | {0x6060: u8(0), 0x6098: u8(0)}
    return (
        common(0x00020192, 0x402)
        | {(index, 0): value for index, value in plain.items()}
        | {(0x1016, 1): u32(0), (0x6099, 1): u32(0), (0x6099, 2): u32(0)}
        | pdo_objects(0x1400, 0x1600)
        | pdo_objects(0x1800, 0x1A00)
        | pdo_objects(0x1801, 0x1A01)
    )


def strip_objects() -> dict[tuple[int, int], bytes]:
    return common(0x00080196, 0x406) | {(0x6005, 1): u32(10_000)} | pdo_objects(0x1800, 0x1A00)


class Axis:
    """The drive's state machine and its slide, stepped by SYNC."""

    def __init__(self) -> None:
        self.state, self.bits = DISABLED, 0x0400
        self.position, self.target, self.steps = 500_000, 500_000, 0
        self.mode, self.homing = 0, False
        self.frozen = self.deaf = self.lies = self.hunts = self.homes_at_once = False
        self.speed, self.looks, self.zero = 100_000, 0, 0
        self.supply = 0x0210  # voltage at the power stage; obeys the bus
        self.masked: set[int] = set()  # control words that it does not obey
        self.passed_s = 0.0  # in which the slide has gone its way at that speed

    def control(self, word: int, target: int) -> None:
        if word & 0x80 and self.state == FAULT:
            self.state = DISABLED
        elif self.state != FAULT and not self.deaf and word not in self.masked:
            self._transition(word)
        if self.homes_at_once and self.state == ENABLED and self.mode == 6 and word & 0x10:
            self.position, self.bits = 0, 0x1400
        elif self.state == ENABLED and word & 0x10 and not self.bits & 0x1000:
            self.target = self.zero if self.mode == 6 else target
            self.steps, self.homing = 3, self.mode == 6
            self.bits = 0 if self.homing else 0x1000
        if self.mode == 1 and not word & 0x10:
            self.bits &= ~0x1000
        if self.mode == 6 and not word & 0x10:
            self.homing = False

    def _transition(self, word: int) -> None:
        low = word & 0x8F
        if not low & 2 or not low & 4:
            self.state, self.steps = DISABLED, 0
        elif low == 6 and self.state != QUICK:
            self.state = READY
        elif low == 7 and self.state in (READY, ENABLED):
            self.state = SWITCHED_ON
        elif low == 15 and self.state in (READY, SWITCHED_ON):
            self.state = ENABLED

    def step(self) -> None:
        self.looks += 1
        if self.lies and self.steps:
            self.steps, self.bits = 0, self.bits | 0x400
        if not self.steps or self.frozen:
            return
        step = round((self.target - self.position) / self.steps)
        self.position += step
        self.passed_s += abs(step) / abs(self.speed)
        self.steps -= 1
        if not self.steps:
            self.bits |= 0x1400 if self.homing else 0x400

    @property
    def status(self) -> int:
        return self.state | self.bits | self.supply if self.state != FAULT else FAULT

    @property
    def velocity(self) -> int:
        moves = self.speed if self.steps and not self.frozen else 0
        return moves + (60 * (-1) ** self.looks if self._hunting else 0)

    @property
    def shown(self) -> int:
        """The position that a servo shows which hunts about it while it has power."""
        return self.position + (HUNTING[self.looks % len(HUNTING)] if self._hunting else 0)

    @property
    def _hunting(self) -> bool:
        return self.hunts and self.state == ENABLED


class CanPeer:
    """The gateway: every frame that comes is in ``heard``; ``tamper`` sees each line that goes."""

    def __init__(self) -> None:
        self.axis = Axis()
        self.objects = {DRIVE: drive_objects(), STRIP: strip_objects()}
        self.strip_offset, self.jitter, self.alarms = 0, 0, 0
        self.heard: list[tuple[int, bytes]] = []
        self.silent: set[int] = set()
        self.nmt = {DRIVE: 0x7F, STRIP: 0x7F}
        self.quick_stopped, self.beating = threading.Event(), threading.Event()
        self.tamper: Callable[[bytes], list[bytes]] = lambda line: [line]
        self.on_sync: Callable[[], None] = lambda: None
        self.abort: dict[tuple[int, int], int] = {}
        self.ignore: set[tuple[int, int]] = set()
        self.read_only: set[tuple[int, int]] = set()  # of the drive
        self.write_only: set[tuple[int, int]] = set()
        self.unmappable: set[int] = set()
        self.demands_no_rtr = True
        self.on_read: Callable[[int], None] = lambda index: None
        self.only: dict[tuple[int, int], bytes] = {}  # the one value that an object takes
        self.shortest_beat_ms: dict[int, int] = {}  # the shortest period that a node takes
        self.lost_stops = 0  # quick stops that the drive does not receive by PDO
        self.lost_heartbeat: set[int] = set()  # nodes that latch it, until the next beat
        self._lock = threading.RLock()
        self._connection: socket.socket | None = None
        self._syncs = 0
        self._end, self._waits = threading.Event(), threading.Event()
        self.server = Server(self._serve)
        self._beats = threading.Thread(target=self._beat, daemon=True)
        self._beats.start()

    @property
    def channel(self) -> str:
        return f"socket://127.0.0.1:{self.server.port}"

    def __enter__(self) -> CanPeer:
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._beats.join()
        self.server.close()

    def send(self, cob_id: int, data: bytes) -> None:
        line = f"t{cob_id:03X}{len(data)}{data.hex().upper()}\r".encode()
        with self._lock, contextlib.suppress(OSError):
            for piece in self.tamper(line):
                self.raw(piece)

    def raw(self, data: bytes) -> None:
        if self._connection is not None:
            self._connection.sendall(data)

    def written(self, index: int) -> list[bytes]:
        """Return the values that were written to an object of the drive by SDO."""
        return [
            data[4 : 8 - (data[0] >> 2 & 3)]
            for data in self.frames(0x600 + DRIVE)
            if data[0] & 0xE0 == 0x20 and struct.unpack_from("<H", data, 1)[0] == index
        ]

    def frames(self, cob_id: int) -> list[bytes]:
        return [data for found, data in self.heard if found == cob_id]

    def settle(self) -> None:
        """Return when the nodes have dealt with all that has arrived."""
        while (connection := self._connection) is not None:
            if self._waits.is_set() and not select.select([connection], [], [], 0.0)[0]:
                return
            threading.Event().wait(0.001)  # the other thread runs

    # -- the gateway --------------------------------------------------------------------------

    def _serve(self, connection: socket.socket) -> None:
        self._connection = connection
        self._waits = waits = threading.Event()
        buffer = b""
        try:
            while data := _next(connection, waits):
                buffer += data
                *lines, buffer = buffer.split(b"\r")
                for line in lines:
                    with self._lock:
                        self._line(line)
        finally:
            if self._connection is connection:
                self._connection = None

    def _line(self, line: bytes) -> None:
        if line == b"O":
            self.raw(b"\r")
            for node in (DRIVE, STRIP):
                self.send(0x700 + node, b"\0")
        elif line.startswith(b"t"):
            self.raw(b"z\r")
            self._frame(int(line[1:4], 16), bytes.fromhex(line[5:].decode()))
        else:
            self.raw(b"\r")

    def _beat(self) -> None:
        while not self._end.wait(HEARTBEAT_S):
            for node, state in self.nmt.items():
                if node not in self.silent:
                    self.send(0x700 + node, u8(state))

    def _frame(self, cob_id: int, data: bytes) -> None:
        self.heard.append((cob_id, data))
        if cob_id == 0x000:
            state = {1: 0x05, 0x80: 0x7F}[data[0]]
            self.nmt[data[1]] = 0x7F if data[1] in self.lost_heartbeat else state
            self.send(0x700 + data[1], u8(self.nmt[data[1]]))
        elif cob_id == 0x080:
            self._sync()
        elif cob_id == 0x200 + DRIVE:
            word, target = struct.unpack("<Hi", data)
            if word == 0x0002 and self.lost_stops:
                self.lost_stops -= 1
            elif self.nmt[DRIVE] == OPERATIONAL:
                self.axis.control(word, target)
            if word == 0x0002:
                self.quick_stopped.set()
        elif cob_id in (0x600 + DRIVE, 0x600 + STRIP):
            self._sdo(cob_id - 0x600, data)
        elif cob_id == 0x77F:
            self.lost_heartbeat.clear()
            self.beating.set()

    def _sync(self) -> None:
        self._syncs += 1
        self.on_sync()
        axis = self.axis
        axis.step()
        strip = axis.position // 10 + self.strip_offset + self.jitter * (self._syncs % 2)
        if self.nmt[DRIVE] == OPERATIONAL:
            self.send(0x180 + DRIVE, struct.pack("<Hi", axis.status, axis.shown))
            motion = struct.pack("<ib", axis.velocity, axis.mode)
            self.send(0x280 + DRIVE, motion if self._maps_two(DRIVE, 0x1A01) else motion[:4])
        if self.nmt[STRIP] == OPERATIONAL:
            place = struct.pack("<iH", strip, self.alarms)
            self.send(0x180 + STRIP, place if self._maps_two(STRIP, 0x1A00) else place[:4])

    def _maps_two(self, node: int, mapping: int) -> bool:
        return self.objects[node][mapping, 0] == u8(2)

    def _refusal(self, node: int, request: bytes) -> int:
        """Return the abort code that an access earns; 0 for none."""
        command, index, sub = struct.unpack_from("<BHB", request)
        key, reads = (index, sub), command == 0x40
        if code := self.abort.get(key, 0 if key in self.objects[node] else 0x06020000):
            return code
        if not reads and node == DRIVE and key in self.only:
            value = self.only[key]
            return 0 if request[4 : 4 + len(value)] == value else 0x06090030
        if key == (0x1017, 0) and not reads:
            shortest_ms = self.shortest_beat_ms.get(node, 0)
            return 0 if struct.unpack_from("<H", request, 4)[0] >= shortest_ms else 0x06090030
        if node == DRIVE and key in (self.write_only if reads else self.read_only):
            return 0x06010001 if reads else 0x06010002
        maps = index >> 8 in (0x16, 0x1A) and sub and not reads
        unmappable = maps and struct.unpack_from("<H", request, 6)[0] in self.unmappable
        return 0x06040041 if unmappable else 0

    def _insists(self, request: bytes) -> bool:
        return self.demands_no_rtr and not request[7] & 0x40

    # -- SDO ----------------------------------------------------------------------------------

    def _show(self, index: int) -> None:
        """Put what the axis shows now into the drive's objects; the slide goes on meanwhile."""
        axis, drive = self.axis, self.objects[DRIVE]
        if index == 0x6041:
            axis.step()
        drive[0x6041, 0], drive[0x6064, 0] = u16(axis.status), i32(axis.shown)
        drive[0x606C, 0], drive[0x6061, 0] = i32(axis.velocity), u8(axis.mode)

    def _sdo(self, node: int, request: bytes) -> None:
        command, index, sub = struct.unpack_from("<BHB", request)
        key, objects = (index, sub), self.objects[node]
        if command == 0x80 or key in self.ignore or self.nmt[node] == STOPPED:
            return
        head = request[1:4]
        if node == DRIVE:
            self._show(index)
        if command == 0x40:
            self.on_read(index)
        if code := self._refusal(node, request):
            self.send(0x580 + node, b"\x80" + head + u32(code))
        elif command == 0x40:
            value = objects[key]
            self.send(0x580 + node, u8(0x43 | (4 - len(value)) << 2) + head + value.ljust(4, b"\0"))
        elif key[0] >> 8 in (0x14, 0x18) and sub == 1 and self._insists(request):
            self.send(0x580 + node, b"\x80" + head + u32(0x06090030))
        else:
            objects[key] = request[4 : 8 - (command >> 2 & 3)]
            if key == (0x6060, 0):
                self.axis.mode = request[4]
            elif key == (0x6040, 0):
                self.axis.control(request[4], self.axis.target)
            self.send(0x580 + node, b"\x60" + head + bytes(4))


def _next(connection: socket.socket, waits: threading.Event) -> bytes:
    waits.set()
    select.select([connection], [], [])
    waits.clear()  # before the bytes are taken: either this or they tell `settle`
    return connection.recv(4096)
