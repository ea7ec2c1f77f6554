"""GeoCOM, the ASCII protocol of Leica total stations: requests, replies, angles to positions.

``%R1Q,<procedure>,<transaction>:<parameters>`` asks, and is answered by
``%R1P,<communication code>,<transaction>:<return code>[,values]``. Lengths are metres, angles
radians; Hz turns clockwise seen from above, V is zero at the zenith.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from drivers.tracker_readings import DEVICE
from hilcell.clean import clean
from hilcell.ports import Array, DeviceError, NoReading

TRANSACTIONS = 2**15
ABORT = "c"  # ends a motion or measurement; answered by "?"
RAD_PER_ARCSEC = math.pi / 648_000
MM_PER_M = 1000.0
PLACES = 15  # decimal places that the instrument is to send
FARTHEST = 1e5  # m or rad; figures above are no reading
AUTOMATIC_TILT = 1  # of DO_MEASURE and GET_MEASUREMENT
BUSY = frozenset({13, 786, 1293})
# Communication codes of an instrument that is in step: unknown procedure, asleep, off.
REFUSED_UNREAD = (3080, 3081, 3108, 3109)
# A name may have the mark of an arcsecond in it, escaped or not: a quote that ends no value.
_VALUE = re.compile(r'"((?:[^"\\]|\\.|"(?!,|$))*)"(?=,|$)|((?!")[^,]*)')


class GeocomError(Exception):
    """Text that is no reply, or no value of the expected kind."""


class Code(IntEnum):
    """Return codes that are looked at."""

    OK = 0
    NOT_IMPLEMENTED = 5
    UNCORRECTED = 1283  # with values
    INACCURATE = 1284  # with values


class Program(IntEnum):
    """Programs of DO_MEASURE."""

    DISTANCE = 1
    CLEAR = 3


class Rpc(IntEnum):
    """The procedures that are used."""

    NULL = 0
    SET_PRECISION = 107
    GET_PRECISION = 108
    GET_TILT_SWITCH = 2007
    SET_TILT_SWITCH = 2006
    DO_MEASURE = 2008
    GET_ANGLE_CORRECTIONS = 2014
    SET_ANGLE_CORRECTIONS = 2016
    SET_EDM_MODE = 2020
    GET_EDM_MODE = 2021
    GET_PRISM_CONSTANT = 2023
    SET_PRISM_CONSTANT = 2024
    SET_ATMOSPHERE = 2028
    GET_ATMOSPHERE = 2029
    GET_MEASUREMENT = 2108
    GET_SERIAL = 5003
    GET_NAME = 5004
    GET_FIRMWARE = 5034
    TURN_TO = 9027
    FINE_ADJUST = 9037
    SET_ATR = 18005
    GET_ATR = 18006

    @property
    def spoken(self) -> str:
        """The procedure in words."""
        return self.name.lower().replace("_", " ")

    @property
    def measures(self) -> bool:
        """Whether its failure is one of a measurement, which may be tried again."""
        return self in (Rpc.TURN_TO, Rpc.FINE_ADJUST, Rpc.DO_MEASURE, Rpc.GET_MEASUREMENT)

    def failed(self, code: int) -> DeviceError:
        """Return the error of a refused request."""
        kind = NoReading if self.measures and code not in FAULTS else DeviceError
        alarm = ALARMS.get(code, "HC-T24")
        act, fields = ACTS.get(alarm, ACT), {"status": code}
        return kind(alarm, DEVICE, self.spoken, status_text(code), act=act, fields=fields)


STATUS = {
    2: "invalid parameter",
    5: "not implemented",
    8: "aborted",
    12: "instrument shuts down",
    13: "system busy",
    16: "battery low",
    18: "battery empty",
    21: "out of its temperature range",
    22: "tilted",
    25: "asleep",
    27: "no licence for this command",
    769: "distance meter does not communicate",
    770: "no signal",
    775: "distance meter timed out",
    776: "signal fluctuates",
    786: "distance meter busy",
    790: "distance meter not available",
    791: "distance measurement aborted",
    819: "signal too weak for its noise",
    823: "several targets in the distance meter's beam",
    1283: "not fully corrected",
    1284: "accuracy not guaranteed",
    1285: "angles without a distance",
    1288: "angles without a distance, not fully corrected",
    1289: "angles without a distance, accuracy not guaranteed",
    1290: "no angle measurement",
    1291: "wrong corrections of the distance meter",
    1292: "distance measurement failed",
    1293: "measurement busy",
    8704: "positioning timed out",
    8706: "angle measurement failed",
    8707: "motors failed",
    8708: "position not exact",
    8709: "deviation could not be determined",
    8710: "no target found",
    8711: "several targets found",
    8712: "bad light or air",
    8713: "target recognition failed",
    8714: "target recognition not switched on",
    3072: "failed",
    3077: "timed out",
    3078: "of a wrong form",
    3079: "versions differ",
    3080: "request not decoded",
    3081: "no such command",
    3108: "instrument asleep",
    3109: "instrument off",
    8716: "position outside of the tolerance",
}
ALARMS = {
    **dict.fromkeys(BUSY, "HC-T21"),
    **dict.fromkeys((2, 3, 5, 27, 3080, 3081, 8714), "HC-T23"),
    **dict.fromkeys((12, 16, 18, 21, 25, 3108, 3109), "HC-T55"),
    22: "HC-T20",
    **dict.fromkeys(range(769, 786), "HC-T53"),
    **dict.fromkeys(range(787, 836), "HC-T53"),
    Code.UNCORRECTED: "HC-T50",
    Code.INACCURATE: "HC-T51",
    **dict.fromkeys((1285, 1288, 1289, 1292, 1294), "HC-T52"),
    1291: "HC-T06",
    **dict.fromkeys((1290, *range(8704, 8710), 8716), "HC-T54"),
    **dict.fromkeys((8710, 8712, 8713), "HC-T11"),
    8711: "HC-T56",
}
FAULTS = frozenset({2, 3, 5, 12, 18, 22, 25, 27, 778, 779, 790, 1291, *REFUSED_UNREAD, 8707, 8714})
ACT = "look at the instrument, then resume"
ACTS = {
    "HC-T11": "clear the view or seat the reflector, then resume",
    "HC-T50": "level the instrument and switch its compensator on",
    "HC-T51": "level and check the instrument, or state tracker.options.accept_uncorrected = true",
    "HC-T56": "take other reflectors out of the view",
}


@dataclass(frozen=True, slots=True)
class Reply:
    """The reply to a request."""

    communication: int
    transaction: int
    code: int
    values: tuple[str, ...] = ()

    @property
    def is_empty(self) -> bool:
        """Whether a reply of success has no values, where a whole one would have some."""
        return not any(value.strip() for value in self.values)

    @property
    def is_whole(self) -> bool:
        """Whether each value has all its places: the line has no check sum and loses characters.

        Some instruments leave zeros at the end out, so a value that is not whole may be a good one.
        """
        return all(re.fullmatch(rf"-?\d+\.\d{{{PLACES}}}", value) for value in self.values)


def request(rpc: int, transaction: int, *parameters: float) -> str:
    """Return the line of a request; whole numbers stay whole."""
    return f"%R1Q,{rpc},{transaction}:{','.join(map(_number, parameters))}"


def _number(value: float) -> str:
    if isinstance(value, int):
        return str(int(value))
    text = f"{value:.12f}".rstrip("0")
    return f"{text}0" if text.endswith(".") else text


def parse(line: str) -> Reply:
    """Return the reply in a line; raises `GeocomError`."""
    found = re.fullmatch(r"%R1P,(\d{1,9}),(\d{1,9})(?:,\d{1,9})?:(\d{1,9})(?:,(.*))?", line)
    if found is None:
        raise GeocomError(f"no reply: {clean(line[:80])!r}")
    communication, transaction, code, text = found.groups()
    values, at = list[str](), 0
    while text is not None and at <= len(text):
        value = _VALUE.match(text, at)
        if value is None or text[value.end() : value.end() + 1] not in ("", ","):
            raise GeocomError(f"no values: {clean(text[:80])!r}")
        values.append(value[2] if value[1] is None else re.sub(r'\\(["\\])', r"\1", value[1]))
        at = value.end() + 1
    return Reply(int(communication), int(transaction), int(code), tuple(values))


def numbers(values: tuple[str, ...], count: int) -> tuple[float, ...]:
    """Return ``count`` numbers, perhaps not finite ones; raises `GeocomError`."""
    try:
        found = tuple(map(float, values))
    except ValueError:
        found = ()
    if len(found) != count:
        raise GeocomError(f"expected {count} numbers, got {clean(','.join(values)[:80])!r}")
    return found


def possible(values: tuple[float, ...]) -> bool:
    """Whether angles and a distance may be those of a reading."""
    return all(abs(value) < FARTHEST for value in values) and values[-1] > 0.0


def status_text(code: int) -> str:
    """Return a return code with its meaning."""
    return f"code {code} ({STATUS.get(code, 'unknown')})"


def angles_to(xyz_mm: Array) -> tuple[float, float]:
    """Return Hz, in [0, 2 pi), and V of a position (3,) in the instrument's frame.

    Its x points to Hz zero and its z up; y is to the left, as in every right-handed frame.
    """
    x, y, z = map(float, xyz_mm)
    return -math.atan2(y, x) % math.tau, math.atan2(math.hypot(x, y), z)


def position_mm(hz_rad: float, v_rad: float, distance_m: float) -> Array:
    """Return the position (3,) at two angles and a slope distance."""
    across_m = distance_m * math.sin(v_rad)
    xyz_m = (
        across_m * math.cos(hz_rad),
        -across_m * math.sin(hz_rad),
        distance_m * math.cos(v_rad),
    )
    return MM_PER_M * np.array(xyz_m)


def class_std_mm(xyz_mm: Array, along_mm: float, across_rad: float) -> Array:
    """Return the standard deviations (3,) at a position, of a length along and angles across."""
    range_mm = float(np.linalg.norm(xyz_mm))
    along_2 = (xyz_mm / range_mm) ** 2
    return np.sqrt(along_mm**2 * along_2 + (across_rad * range_mm) ** 2 * (1 - along_2))
