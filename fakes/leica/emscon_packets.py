"""emScon TPI packets: little-endian, pack 4 (protocols, section 3; names after the header).

Every packet begins ``size i32 | type u32``; commands and their replies go on ``command u32``,
replies ``status u32``, then the command's own fields.
"""

from __future__ import annotations

import struct
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

HEAD = struct.Struct("<iI")
COMMAND = struct.Struct("<iII")


class Type(IntEnum):
    """Type of a packet."""

    COMMAND = 0
    ERROR = 1
    SINGLE_RESULT = 2
    MULTI_RESULT = 3
    STATUS_CHANGE = 8


class Command(IntEnum):
    """Commands of an emScon tracker, besides its settings."""

    GET_SYSTEM_STATUS = 1
    GET_TRACKER_STATUS = 2
    INITIALIZE = 7
    GET_ORIENTATION = 13
    GET_TRANSFORMATION = 15
    GET_REFLECTORS = 42
    START_MEASUREMENT = 49
    STOP_MEASUREMENT = 52
    CHANGE_FACE = 53
    GO_BIRD_BATH = 54
    GO_POSITION = 55
    POINT_LASER = 58
    FIND_REFLECTOR = 63
    GET_DIRECTION = 66
    GET_FACE = 98
    GET_MEASUREMENT_STATUS = 122
    GET_TRACKER_INFO = 132
    GO_AND_MEASURE = 135
    GET_SOFTWARE_VERSION = 142


class Status(IntEnum):
    """Result status of a reply."""

    OK = 0
    BUSY = 1
    NOT_IMPLEMENTED = 2
    WRONG_PARAMETER = 3
    WRONG_PARAMETER_1 = 4
    OUT_OF_RANGE_1 = 12
    WRONG_REFLECTOR = 23
    NO_DISTANCE = 37
    NOT_INITIALIZED = 39
    WEATHER_OUT_OF_RANGE = 57
    NO_TEMPERATURE = 94
    NOT_READY = 10004
    NO_STATIONARY_RESULT = 10009
    NOT_WARMED_UP = 10012


class Change(IntEnum):
    """Unsolicited system status changes, besides those of settings."""

    ENVIRONMENT = 2
    REFRACTION = 3
    NOT_READY = 25
    MEASURING = 26
    READY = 27
    INITIALIZATION = 151


def reply(command: int, status: int = Status.OK, body: bytes = b"") -> bytes:
    """Return a reply; errors are packets of a type of their own, without body."""
    layout = struct.Struct("<iIII")
    if status != Status.OK:
        return layout.pack(layout.size, Type.ERROR, command, status)
    return layout.pack(layout.size + len(body), Type.COMMAND, command, status) + body


def status_change(change: int) -> bytes:
    """Return an unsolicited status change."""
    return COMMAND.pack(COMMAND.size, Type.STATUS_CHANGE, change)


def single_result(values: tuple[float, ...], status: int = Status.OK) -> bytes:
    """Return SingleMeasResult: ReturnDataT's status, mode 0, no try mode, 17 doubles."""
    layout = struct.Struct("<iIIIi17d")
    return layout.pack(layout.size, Type.SINGLE_RESULT, status, 0, 0, *values)


def multi_result(
    times_s: NDArray[np.float64], xyz: NDArray[np.float64], air: tuple[float, float, float]
) -> bytes:
    """Return MultiMeasResult in mode 1: samples with the tracker's time in s and us."""
    layout = struct.Struct("<iIIiII3d")
    sample = np.dtype([("status", "<i4"), ("s", "<i4"), ("us", "<i4"), ("xyz", "<f8", (3,))])
    samples = np.zeros(len(times_s), sample)
    samples["s"], samples["us"] = np.divmod(np.rint(times_s * 1e6), 1_000_000)
    samples["xyz"] = xyz
    size = layout.size + samples.nbytes
    head = layout.pack(size, Type.MULTI_RESULT, Status.OK, len(samples), 1, 0, *air)
    return head + samples.tobytes()


def wide(text: str) -> bytes:
    """Return a name as 32 UTF-16 units."""
    return text[:31].encode("utf-16-le").ljust(64, b"\0")
