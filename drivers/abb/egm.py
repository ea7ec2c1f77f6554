"""The position stream of Externally Guided Motion (EGM): UDP, protobuf, one datagram in 4 ms.

Application manual 3HAC073319, and egm.proto of RobotWare (field numbers below). A datagram is one
message EgmRobot: header 1 (seqno 1, tm 2 in ms, mtype 3: MSGTYPE_DATA = 2), feedBack 2 (joints 1
with repeated doubles 1 in deg; time 4 with sec 1 and usec 2), motorState 4 (state 1: 1 on),
rapidExecState 8 (state 1: 2 running). The controller is the client: it sends to the PC's port that
its system parameters state. Datagrams may be lost, doubled or late: a number that is not above the
last one is not used. Only one controller may send to the port.
"""

from __future__ import annotations

import math
import select
import socket
import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from drivers.device_errors import ROBOT, ProtocolError
from drivers.supervision import Deadline
from hilcell.ports import Array

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5
DATA, MOTORS_ON, RUNNING = 2, 1, 2
LARGEST_DEG = 36_000.0  # of a joint: 100 turns


@dataclass(frozen=True, slots=True)
class Sample:
    """One datagram: joints (6,) as measured, the controller's time, when it arrived here."""

    number: int
    joints_rad: Array
    device_s: float
    motors_on: bool
    running: bool  # a RAPID program
    by_s: float = math.nan  # monotonic


def fields(message: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Yield number and value of each field of a protobuf message; raises `ProtocolError`."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        number, kind = key >> 3, key & 7
        if number == 0:
            raise ProtocolError("field 0 in a message")
        if kind == VARINT:
            value, at = _varint(message, at)
            yield number, value
            continue
        if kind == BYTES:
            length, at = _varint(message, at)
        elif kind in (FIXED64, FIXED32):
            length = 8 if kind == FIXED64 else 4
        else:
            raise ProtocolError(f"wire type {kind} of field {number}")
        if at + length > len(message):
            raise ProtocolError(f"field {number} ends after its message")
        yield number, message[at : at + length]
        at += length


def _varint(message: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(message):
            raise ProtocolError("a number ends after its message")
        byte = message[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ProtocolError("a number of more than 10 bytes")


def inner(message: bytes, *path: int) -> int | bytes | None:
    """Return the last value of a field within fields, None if it is missing."""
    found: int | bytes | None = message
    for number in path:
        if not isinstance(found, bytes):
            raise ProtocolError(f"field {number} of a number")
        last = None
        for each, value in fields(found):
            if each == number:
                last = value
        if last is None:
            return None
        found = last
    return found


def whole(message: bytes, *path: int) -> int | None:
    found = inner(message, *path)
    if isinstance(found, bytes):
        raise ProtocolError(f"field {path} is no whole number")
    return found


def doubles(message: bytes) -> list[float]:
    """Return the repeated doubles 1 of a message, each by itself or packed."""
    found: list[float] = []
    for number, value in fields(message):
        if number == 1 and isinstance(value, bytes) and len(value) % 8 == 0:
            found += struct.unpack(f"<{len(value) // 8}d", value)
    return found


def parse(datagram: bytes) -> Sample:
    """Return the sample of a datagram EgmRobot; raises `ProtocolError`."""
    number, tm_ms = whole(datagram, 1, 1), whole(datagram, 1, 2)
    if whole(datagram, 1, 3) != DATA or number is None:
        raise ProtocolError("no header of a position stream")
    joints = inner(datagram, 2, 1)
    joints_deg = doubles(joints) if isinstance(joints, bytes) else []
    if len(joints_deg) < 6 or not all(abs(each) <= LARGEST_DEG for each in joints_deg):
        raise ProtocolError(f"joints {joints_deg[:7]}, expected six up to {LARGEST_DEG:g} deg")
    seconds, micro = whole(datagram, 2, 4, 1), whole(datagram, 2, 4, 2)
    if seconds is not None and micro is not None:
        device_s = seconds + 1e-6 * micro
    elif tm_ms is not None:  # RobotWare before 6.08
        device_s = 1e-3 * tm_ms
    else:
        raise ProtocolError("no time of the controller")
    return Sample(
        number,
        np.radians(joints_deg[:6]),
        device_s,
        whole(datagram, 4, 1) == MOTORS_ON,
        whole(datagram, 8, 1) == RUNNING,
    )


class PositionStream:
    """The PC's end of the stream; used by one thread at a time."""

    SILENT_S = 1.0  # wire deadline: 250 datagrams
    POLL_S = 0.02
    WRAP = 1 << 32

    def __init__(self, port: int, check: Callable[[], None]) -> None:
        self._check, self.port = check, port
        self._source: tuple[str, int] | None = None
        self._last: int | None = None
        self.lost = 0  # numbers that were left out
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind(("", port))
        except OSError as error:
            self._socket.close()
            raise ROBOT.refused(
                "HC-B85",
                "connect",
                f"UDP port {port} of this PC: {error.strerror}",
                expected="the port of the position stream, free",
                act="end the other program that listens there",
            ) from error
        self._socket.setblocking(False)

    def close(self) -> None:
        self._socket.close()

    def newest(self) -> Sample:
        """Return the newest sample since the last call; raises `DeviceError` where none comes."""
        return self.following()[-1]

    def fresh(self, silent_s: float | None = None) -> Sample:
        """Return a sample that arrived after the call began, waiting ``silent_s`` at most."""
        for _ in self._datagrams():
            pass
        return self.following(silent_s)[-1]

    def some(self, count: int) -> list[Sample]:
        """Return at least so many samples that follow."""
        found = list[Sample]()
        while len(found) < count:
            found += self.following()
        return found

    def following(self, silent_s: float | None = None) -> list[Sample]:
        """Return the samples that have arrived since the last call, at least one."""
        limit_s = self.SILENT_S if silent_s is None else silent_s
        deadline = Deadline(limit_s)
        while True:
            self._check()
            if found := list(self._datagrams()):
                return found
            if deadline.expired():
                raise ROBOT.failed(
                    "HC-B85",
                    "read",
                    f"no position on UDP port {self.port} for {limit_s:g} s",
                    expected="one in 4 ms",
                )
            select.select([self._socket], [], [], self.POLL_S)

    def _datagrams(self) -> Iterator[Sample]:
        """Yield the samples that wait; those that are doubled or late are left out."""
        while True:
            try:
                datagram, source = self._socket.recvfrom(2048)
            except BlockingIOError:
                return
            except OSError as error:
                raise ROBOT.broken(f"UDP port {self.port}", "read", str(error)) from error
            by_s = time.monotonic()
            self._check_source(source)
            try:
                sample = parse(datagram)
            except ProtocolError as error:
                raise ROBOT.failed(
                    "HC-B26",
                    "read",
                    f"a datagram from {source[0]}: {error}",
                    expected="a message EgmRobot with joints",
                ) from error
            if self._is_new(sample.number):
                yield Sample(
                    sample.number,
                    sample.joints_rad,
                    sample.device_s,
                    sample.motors_on,
                    sample.running,
                    by_s,
                )

    def _check_source(self, source: tuple[str, int]) -> None:
        if self._source is None:
            self._source = source
        elif source != self._source:
            first, other = (f"{host}:{port}" for host, port in (self._source, source))
            raise ROBOT.refused(
                "HC-B85",
                "read",
                f"positions come from {first} and from {other} to UDP port {self.port}",
                expected="one controller",
                act="give each controller a port of its own",
            )

    def _is_new(self, number: int) -> bool:
        """Take note of a number; return whether it is above all before it."""
        if self._last is not None:
            ahead = (number - self._last) % self.WRAP
            if not 0 < ahead < self.WRAP // 2:
                return False
            self.lost += ahead - 1
        self._last = number
        return True

    @property
    def source_host(self) -> str:
        return self._source[0] if self._source is not None else ""
