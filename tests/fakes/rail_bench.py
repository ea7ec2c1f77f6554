"""The simulated rail and its masters: on a bus without a wire, or served, to a line or to canopen.

`Bus` hands frames over by calls, in time that the test drives. `Master` is canopen's own, an
independent peer behind the gateway.
"""

from __future__ import annotations

import math
import select
import socket
import struct
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import SimpleNamespace
from typing import cast

import canopen
from canopen import objectdictionary as od

from fakes.canopen.rail_device import RailDevice
from fakes.canopen.rail_server import RailServer
from fakes.faults import Faults
from fakes.site import Site
from fakes.time import CellTime
from fakes.truth.cell_truth import CellTruth
from fakes.truth.rail_truth import RailTruth
from hilcell.cell.file import load_cell

CELL = load_cell("paper")
AS_STATED = RailDevice()
DRIVE, STRIP, MASTER = 5, 6, 127
HUNTING = 200  # counts/s
BIT_10, BIT_11, BIT_12, BIT_13 = 1 << 10, 1 << 11, 1 << 12, 1 << 13
TICK_S = 0.01
PATIENT_S = 600.0  # of canopen, which a busy PC would keep waiting


def site_of(
    rail: RailTruth, faults: Faults, time: CellTime, device: RailDevice = AS_STATED
) -> Site:
    """Return a site whose truth is a rail alone, which is made sooner."""
    return Site(CELL, cast("CellTruth", SimpleNamespace(rail=rail)), faults, time, device)


def until(holds: Callable[[], bool]) -> None:
    """Ask again and again until ``holds``; the pytest time limit bounds the wait."""
    while not holds():
        threading.Event().wait(0.002)


class SdoAbort(Exception):
    """The node refused; ``code`` is that of CiA 301."""

    def __init__(self, code: int) -> None:
        super().__init__(f"0x{code:08X}")
        self.code = code


class Asker(ABC):
    """What a master does by SDO alone."""

    @abstractmethod
    def read(self, index: int, sub: int = 0, kind: str = "I", node: int = DRIVE) -> int: ...

    @abstractmethod
    def write(self, index: int, sub: int, value: int, kind: str, node: int = DRIVE) -> None: ...

    def status(self) -> int:
        return self.read(0x6041, 0, "H")

    def position(self) -> int:
        return self.read(0x6064, 0, "i")

    def enable(self, mode: int) -> None:
        """Take the drive to OPERATION ENABLED in ``mode``."""
        self.write(0x6060, 0, mode, "b")
        for word, wanted in ((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)):
            self.control(word)
            assert self.status() & 0x6F == wanted

    def control(self, word: int) -> None:
        self.write(0x6040, 0, word, "H")

    def home(self) -> None:
        """Find the reference and leave the drive enabled in profile position mode."""
        self.enable(6)
        self.write(0x6098, 0, 17, "b")
        self.control(0x1F)
        until(lambda: self.status() & (BIT_10 | BIT_12) == BIT_10 | BIT_12)
        self.control(0x0F)
        self.write(0x6060, 0, 1, "b")

    def start(self, target: int) -> None:
        """Give a set-point in counts and withdraw it."""
        self.write(0x607A, 0, target, "i")
        self.control(0x0F)
        self.control(0x1F)

    def arrived(self) -> bool:
        return bool(self.status() & BIT_10) and self.slow()

    def slow(self) -> bool:
        """Whether the speed is no more than a servo's that holds a position."""
        return abs(self.read(0x606C, 0, "i")) <= HUNTING

    def move(self, target: int) -> None:
        self.start(target)
        assert self.status() & BIT_12
        self.control(0x0F)
        until(self.arrived)

    def faulty(self) -> bool:
        return self.status() & 0x4F == 0x08

    def map_pdo(
        self, number: int, entries: tuple[int, ...], node: int = DRIVE, kind: int = 1
    ) -> None:
        """Map objects into a TPDO the way the standard asks for."""
        cob_id = 1 << 30 | 0x180 + 0x100 * number + node
        self.write(0x1800 + number, 1, cob_id | 1 << 31, "I", node)
        self.write(0x1800 + number, 2, kind, "B", node)
        self.write(0x1A00 + number, 0, 0, "B", node)
        for sub, entry in enumerate(entries, start=1):
            self.write(0x1A00 + number, sub, entry, "I", node)
        self.write(0x1A00 + number, 0, len(entries), "B", node)
        self.write(0x1800 + number, 1, cob_id, "I", node)


class Bus(Asker):
    """A fresh rail behind an open channel; ``now_s`` is the time of heartbeats and timers."""

    def __init__(self, device: RailDevice = AS_STATED) -> None:
        self.time, self.faults = CellTime(), Faults()
        self.rail = RailTruth(CELL, 1, self.time, self.faults)
        self.server = RailServer(site_of(self.rail, self.faults, self.time, device))
        self.now_s = 0.0
        self.frames: list[tuple[int, bytes]] = []
        self.server._gateway.send = lambda *frame: self.frames.append(frame)  # type: ignore[method-assign]
        self.server.now_s = lambda: self.now_s
        self.server._open()

    def send(self, cob_id: int, data: bytes = b"") -> None:
        self.server._receive(cob_id, data)
        self.server._tick(self.now_s)

    def heard(self, cob_id: int) -> list[bytes]:
        return [data for found, data in self.frames if found == cob_id]

    def emergencies(self, node: int = DRIVE) -> list[int]:
        return [struct.unpack_from("<H", data)[0] for data in self.heard(0x080 + node)]

    def sync(self, count: int = 1) -> None:
        for _ in range(count):
            self.send(0x080)

    def start_nodes(self) -> None:
        self.send(0x000, b"\x01\x00")

    def beat(self) -> None:
        """Send the master's heartbeat."""
        self.send(0x700 + MASTER, b"\x05")

    def let_pass(self, duration_s: float) -> None:
        for _ in range(round(duration_s / TICK_S)):
            self.now_s += TICK_S
            self.server._tick(self.now_s)

    def ask(self, node: int, request: bytes) -> bytes:
        """Return the one answer to a request by SDO; raises `SdoAbort`."""
        before = len(self.heard(0x580 + node))
        self.send(0x600 + node, request)
        (answer,) = self.heard(0x580 + node)[before:]
        if answer[0] == 0x80:
            raise SdoAbort(struct.unpack_from("<I", answer, 4)[0])
        return answer

    def read(self, index: int, sub: int = 0, kind: str = "I", node: int = DRIVE) -> int:
        answer = self.ask(node, struct.pack("<BHBI", 0x40, index, sub, 0))
        value: int = struct.unpack("<" + kind, answer[4 : 8 - (answer[0] >> 2 & 3)])[0]
        return value

    def write(self, index: int, sub: int, value: int, kind: str, node: int = DRIVE) -> None:
        data = struct.pack("<" + kind, value)
        head = struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, sub)
        self.ask(node, head + data.ljust(4, b"\0"))


@contextmanager
def on_bus(device: RailDevice = AS_STATED) -> Iterator[Bus]:
    bus = Bus(device)
    try:
        yield bus
    finally:
        bus.server.close()


@dataclass
class Bench:
    server: RailServer
    rail: RailTruth
    faults: Faults


@contextmanager
def served(speed: float = math.inf, device: RailDevice = AS_STATED) -> Iterator[Bench]:
    """Serve a fresh rail; paced at ``speed`` times real time, or stepped."""
    cell_time, faults = CellTime(speed), Faults()
    rail = RailTruth(CELL, 1, cell_time, faults)
    server = RailServer(site_of(rail, faults, cell_time, device))
    server.start()
    try:
        yield Bench(server, rail, faults)
    finally:
        server.close()


class Line:
    """A raw client of the gateway."""

    def __init__(self, port: int, *, opened: bool = True) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port))
        self._received = b""
        if opened:
            for command in (b"C", b"S6", b"O"):
                self.send(command)
                assert self.reply() == b"\r"

    def __enter__(self) -> Line:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def send(self, line: bytes) -> None:
        self._socket.sendall(line + b"\r")

    def send_bytes(self, data: bytes) -> None:
        self._socket.sendall(data)

    def reply(self) -> bytes:
        """Return the next answer with its CR or BELL; b"" at the end of the connection."""
        while True:
            ends = [i for i in (self._received.find(c) for c in (b"\r", b"\a")) if i >= 0]
            if ends:
                cut = min(ends) + 1
                answer, self._received = self._received[:cut], self._received[cut:]
                return answer
            data = self._socket.recv(4096)
            if not data:
                return b""
            self._received += data

    def quiet(self) -> bool:
        """Whether nothing has come that was not read."""
        return not self._received and not select.select([self._socket], [], [], 0.0)[0]

    def frame(self) -> bytes:
        """Return the next frame from the bus without its CR; acknowledges are passed over."""
        while True:
            answer = self.reply()
            if answer not in {b"z\r", b"\r"}:
                return answer.rstrip(b"\r")


DRIVE_OBJECTS = {
    "status": (0x6041, 0, od.UNSIGNED16),
    "control": (0x6040, 0, od.UNSIGNED16),
    "mode": (0x6060, 0, od.INTEGER8),
    "mode shown": (0x6061, 0, od.INTEGER8),
    "position": (0x6064, 0, od.INTEGER32),
    "velocity": (0x606C, 0, od.INTEGER32),
    "target": (0x607A, 0, od.INTEGER32),
    "supported modes": (0x6502, 0, od.UNSIGNED32),
}


def dictionary(objects: dict[str, tuple[int, int, int]], pdos: int = 2) -> od.ObjectDictionary:
    """Return what a canopen peer must know of a node."""
    known = od.ObjectDictionary()
    for name, (index, sub, kind) in objects.items():
        known.add_object(_variable(name, index, sub, kind))
    for base in (0x1400, 0x1600, 0x1800, 0x1A00):
        for number in range(pdos):
            known.add_object(_pdo_record(base + number))
    return known


def _variable(name: str, index: int, sub: int, kind: int) -> od.ODVariable:
    variable = od.ODVariable(name, index, sub)
    variable.data_type, variable.pdo_mappable = kind, True
    return variable


def _pdo_record(index: int) -> od.ODRecord:
    record = od.ODRecord(f"pdo {index:04X}", index)
    if index & 0x200:
        kinds = [od.UNSIGNED8] + [od.UNSIGNED32] * 8
    else:
        kinds = [od.UNSIGNED8, od.UNSIGNED32, od.UNSIGNED8, od.UNSIGNED16]
    for sub, kind in enumerate(kinds):
        record.add_member(_variable(f"{index:04X}:{sub}", index, sub, kind))
    return record


class Master(Asker):
    """A canopen master with both nodes; boot-ups may have come already."""

    def __init__(self, port: int) -> None:
        self.network = canopen.Network()
        self.network.NOTIFIER_CYCLE = 0.02
        self.drive = canopen.BaseNode402(DRIVE, dictionary(DRIVE_OBJECTS))
        self.strip = canopen.RemoteNode(STRIP, dictionary({}))
        for node in (self.drive, self.strip):
            node.sdo.RESPONSE_TIMEOUT = PATIENT_S
            self.network.add_node(node)
        self.network.connect(
            interface="slcan",
            channel=f"socket://127.0.0.1:{port}",
            bitrate=500_000,
            sleep_after_open=0,
        )

    def __enter__(self) -> Master:
        return self

    def __exit__(self, *_: object) -> None:
        self.network.disconnect()

    def read(self, index: int, sub: int = 0, kind: str = "I", node: int = DRIVE) -> int:
        data = self.network[node].sdo.upload(index, sub)
        value: int = struct.unpack("<" + kind, data)[0]
        return value

    def write(self, index: int, sub: int, value: int, kind: str, node: int = DRIVE) -> None:
        self.network[node].sdo.download(index, sub, struct.pack("<" + kind, value))
