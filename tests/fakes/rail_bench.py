"""A served rail and its clients: a raw slcan line, and python-can with canopen as peers."""

from __future__ import annotations

import math
import socket
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import canopen
from canopen import objectdictionary as od
from canopen.network import PeriodicMessageTask

from fakes.canopen.rail_server import RailServer
from fakes.faults import Faults
from fakes.time import PlantTime
from fakes.truth.rail_truth import RailTruth
from hilcell.cell.file import load_cell

DEADLINE_S = 5.0
DRIVE, STRIP, MASTER = 5, 6, 127
HUNTING = 200  # counts/s
BIT_10, BIT_11, BIT_12, BIT_13 = 1 << 10, 1 << 11, 1 << 12, 1 << 13


@dataclass
class Bench:
    server: RailServer
    rail: RailTruth
    faults: Faults
    time: PlantTime


@contextmanager
def served(speed: float = math.inf) -> Iterator[Bench]:
    """Serve a fresh rail; paced at ``speed`` times real time, or stepped."""
    cell, plant_time, faults = load_cell("paper"), PlantTime(speed), Faults()
    rail = RailTruth(cell, 1, plant_time, faults)
    server = RailServer(rail, faults, cell, plant_time)
    server.start()
    try:
        yield Bench(server, rail, faults, plant_time)
    finally:
        server.close()


def until(holds: Callable[[], bool], what: str, deadline_s: float = DEADLINE_S) -> None:
    """Ask again and again until ``holds``; fail after ``deadline_s``."""
    end_s = time.monotonic() + deadline_s
    while not holds():
        assert time.monotonic() < end_s, f"{what}: not within {deadline_s} s"
        time.sleep(0.002)


class Line:
    """A raw client of the gateway."""

    def __init__(self, port: int, *, opened: bool = True) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=DEADLINE_S)
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

    def reply(self, deadline_s: float = DEADLINE_S) -> bytes:
        """Return the next answer with its CR or BELL; b"" at the end of the connection."""
        self._socket.settimeout(deadline_s)
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

    def frame(self, deadline_s: float = DEADLINE_S) -> bytes:
        """Return the next frame from the bus without its CR; acknowledges are passed over."""
        while True:
            answer = self.reply(deadline_s)
            if answer not in {b"z\r", b"\r"}:
                return answer.rstrip(b"\r")

    def silent(self, duration_s: float) -> bool:
        """Whether no frame comes for a while."""
        try:
            self.frame(duration_s)
        except TimeoutError:
            return True
        return False


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
STRIP_OBJECTS = {
    "position": (0x6004, 0, od.INTEGER32),
    "alarms": (0x6503, 0, od.UNSIGNED16),
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


class Master:
    """A canopen master with both nodes; boot-ups may have come already."""

    def __init__(self, port: int) -> None:
        self.network = canopen.Network()
        self.network.NOTIFIER_CYCLE = 0.02
        self.drive = canopen.BaseNode402(DRIVE, dictionary(DRIVE_OBJECTS))
        self.strip = canopen.RemoteNode(STRIP, dictionary(STRIP_OBJECTS))
        self.network.add_node(self.drive)
        self.network.add_node(self.strip)
        self.network.connect(
            interface="slcan",
            channel=f"socket://127.0.0.1:{port}",
            bitrate=500_000,
            sleep_after_open=0,
        )
        self._closed = False

    def __enter__(self) -> Master:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self.network.disconnect()

    def read(self, index: int, sub: int = 0, kind: str = "I", node: int = DRIVE) -> int:
        data = self.network[node].sdo.upload(index, sub)
        value: int = struct.unpack("<" + kind, data)[0]
        return value

    def write(self, index: int, sub: int, value: int, kind: str, node: int = DRIVE) -> None:
        self.network[node].sdo.download(index, sub, struct.pack("<" + kind, value))

    def status(self) -> int:
        return self.read(0x6041, 0, "H")

    def enable(self, mode: int) -> None:
        """Take the drive to OPERATION ENABLED in ``mode`` by SDO alone."""
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
        until(lambda: self.status() & (BIT_10 | BIT_12) == BIT_10 | BIT_12, "homed")
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
        until(self.arrived, "arrived")

    def start_heartbeat(self, period_s: float = 0.05) -> PeriodicMessageTask:
        return self.network.send_periodic(0x700 + MASTER, b"\x05", period_s)
