"""A Leica total station over GeoCOM: a serial line, or TCP 1212. It measures at rest only.

The trap: the instrument stores its last distance, and an answer may come after its timeout. So the
distance is cleared before each start, every request has a number of its own, and an answer to an
abandoned request is dropped; one to no request at all ends the connection. A line has no check sum:
a reading with fewer decimals than set has lost a character, or a zero at its end.

``%R1Q,<procedure>,<transaction>:<parameters>`` is answered by ``%R1P,<communication
code>,<transaction>:<return code>[,values]``. Lengths are metres, angles radians; Hz is clockwise
from above, V is zero at the zenith.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Mapping
from contextlib import closing
from enum import IntEnum
from functools import partial
from itertools import count
from pathlib import Path
from threading import Event
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from drivers.device_errors import TRACKER, ProtocolError
from drivers.supervision import Deadline, on_failure
from drivers.tracker_readings import (
    BUSY_PAUSE_S,
    Positive,
    TrackerAbilities,
    changed,
    check_reflector,
    check_samples,
    check_serial,
    checked_request,
    checked_search,
    leica_identity,
    off_target,
    readback_error,
    repeats_std,
    retry_while_busy,
)
from drivers.wires import Link, TextLines, open_link
from hilcell.clock import WallClock
from hilcell.decoding import typed
from hilcell.ports import (
    Ability,
    Array,
    Candidate,
    Clock,
    DeviceError,
    Identity,
    NoReading,
    TrackerReading,
)
from hilcell.sanitize import clean
from hilcell.wire.channel import SerialLine, parse_channel

MM_PER_M = 1000.0
PLACES = 15  # decimal places that the instrument is to send
FARTHEST = 1e5  # m or rad; figures above are no reading
BUSY = frozenset({13, 786, 1293})
# Communication codes of an instrument that is in step: unknown procedure, asleep, off.
REFUSED_UNREAD = (3080, 3081, 3108, 3109)
# A name may have the mark of an arcsecond in it, escaped or not: a quote that ends no value.
_VALUE = re.compile(r'(?:^|,)(?:"((?:[^"\\]|\\.|"(?!,|$))*)"(?=,|$)|((?!")[^,]*))')


class Rpc(IntEnum):
    """The procedures that are used."""

    NULL = 0
    SET_PRECISION = 107
    GET_PRECISION = 108
    GET_ANGLES = 2003
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
    GET_CONFIGURATION = 5035
    STOP_MOTORS = 6002
    TURN_TO = 9027
    FINE_ADJUST = 9037
    SET_ATR = 18005
    GET_ATR = 18006

    @property
    def label(self) -> str:
        return self.name.lower().replace("_", " ")

    @property
    def measures(self) -> bool:
        """Whether its failure is one of a measurement, which may be tried again."""
        return self in (Rpc.TURN_TO, Rpc.FINE_ADJUST, Rpc.DO_MEASURE, Rpc.GET_MEASUREMENT)

    def failed(self, code: int) -> DeviceError:
        again = self.measures and code not in FAULTS
        error = TRACKER.no_reading if again else TRACKER.failed
        return error(CODES.get(code, UNKNOWN)[0], self.label, status_text(code), status=code)


CODES = {  # alarm and text
    **dict.fromkeys(range(769, 836), ("HC-T53", "unknown")),
    **dict.fromkeys(range(8704, 8710), ("HC-T54", "unknown")),
    2: ("HC-T23", "invalid parameter"),
    3: ("HC-T23", "unknown"),
    5: ("HC-T23", "not implemented"),
    8: ("HC-T24", "aborted"),
    12: ("HC-T55", "instrument shuts down"),
    13: ("HC-T21", "system busy"),
    16: ("HC-T55", "battery low"),
    18: ("HC-T55", "battery empty"),
    21: ("HC-T55", "out of its temperature range"),
    22: ("HC-T20", "tilted"),
    25: ("HC-T55", "asleep"),
    27: ("HC-T23", "no licence for this command"),
    769: ("HC-T53", "distance meter does not communicate"),
    770: ("HC-T53", "no signal"),
    775: ("HC-T53", "distance meter timed out"),
    776: ("HC-T53", "signal fluctuates"),
    786: ("HC-T21", "distance meter busy"),
    790: ("HC-T53", "distance meter not available"),
    791: ("HC-T53", "distance measurement aborted"),
    819: ("HC-T53", "signal too weak for its noise"),
    823: ("HC-T53", "several targets in the distance meter's beam"),
    1283: ("HC-T50", "not fully corrected"),
    1284: ("HC-T51", "accuracy not guaranteed"),
    1285: ("HC-T52", "angles without a distance"),
    1288: ("HC-T52", "angles without a distance, not fully corrected"),
    1289: ("HC-T52", "angles without a distance, accuracy not guaranteed"),
    1290: ("HC-T54", "no angle measurement"),
    1291: ("HC-T06", "wrong corrections of the distance meter"),
    1292: ("HC-T52", "distance measurement failed"),
    1293: ("HC-T21", "measurement busy"),
    1294: ("HC-T52", "unknown"),
    3072: ("HC-T24", "failed"),
    3077: ("HC-T24", "timed out"),
    3078: ("HC-T24", "of a wrong form"),
    3079: ("HC-T24", "versions differ"),
    3080: ("HC-T23", "request not decoded"),
    3081: ("HC-T23", "no such command"),
    3108: ("HC-T55", "instrument asleep"),
    3109: ("HC-T55", "instrument off"),
    8704: ("HC-T54", "positioning timed out"),
    8706: ("HC-T54", "angle measurement failed"),
    8707: ("HC-T54", "motors failed"),
    8708: ("HC-T54", "position not exact"),
    8709: ("HC-T54", "deviation could not be determined"),
    8710: ("HC-T11", "no target found"),
    8711: ("HC-T56", "several targets found"),
    8712: ("HC-T11", "bad light or air"),
    8713: ("HC-T11", "target recognition failed"),
    8714: ("HC-T23", "target recognition not switched on"),
    8716: ("HC-T54", "position outside of the tolerance"),
}
UNKNOWN = ("HC-T24", "unknown")
FAULTS = frozenset({2, 3, 5, 12, 18, 22, 25, 27, 778, 779, 790, 1291, *REFUSED_UNREAD, 8707, 8714})


class Reply(NamedTuple):
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
    numbers = (
        str(int(each)) if isinstance(each, int) else re.sub(r"(\.\d+?)0+$", r"\1", f"{each:.12f}")
        for each in parameters
    )
    return f"%R1Q,{rpc},{transaction}:{','.join(numbers)}"


def parse(line: str) -> Reply:
    """Return the reply in a line; raises `ProtocolError`."""
    found = re.fullmatch(r"%R1P,(\d{1,9}),(\d{1,9})(?:,\d{1,9})?:(\d{1,9})(?:,(.*))?", line)
    if found is None:
        raise ProtocolError(f"no reply: {clean(line[:80])!r}")
    communication, transaction, code, text = found.groups()
    parts = [] if text is None else list(_VALUE.finditer(text))
    if "".join(part.group() for part in parts) != (text or ""):
        raise ProtocolError(f"no values: {clean(text[:80])!r}")
    values = (m[2] if m[1] is None else re.sub(r'\\(["\\])', r"\1", m[1]) for m in parts)
    return Reply(int(communication), int(transaction), int(code), tuple(values))


def numbers(values: tuple[str, ...], count: int) -> tuple[float, ...]:
    """Return ``count`` numbers, perhaps not finite ones; raises `ProtocolError`."""
    try:
        found = tuple(map(float, values))
    except ValueError:
        found = ()
    if len(found) != count:
        raise ProtocolError(f"expected {count} numbers, got {clean(','.join(values)[:80])!r}")
    return found


def possible(values: tuple[float, ...]) -> bool:
    """Whether angles and a distance may be those of a reading."""
    return all(abs(value) < FARTHEST for value in values) and values[-1] > 0.0


def status_text(code: int) -> str:
    return f"code {code} ({CODES.get(code, UNKNOWN)[1]})"


def position_mm(hz_rad: float, v_rad: float, distance_m: float) -> Array:
    """Return the position (3,) at two angles and a slope distance."""
    across_m = distance_m * math.sin(v_rad)
    x_m, y_m = across_m * math.cos(hz_rad), -across_m * math.sin(hz_rad)
    return MM_PER_M * np.array([x_m, y_m, distance_m * math.cos(v_rad)])


class LeicaGeocomTracker:
    """Satisfies `hilcell.ports.Tracker`, and its `Aims`, `Inspects` and `Discovers`."""

    TRANSACTIONS = 2**15
    SERIAL_LINES = Path("/dev/serial/by-id")
    ABORT = "c"  # ends a motion or measurement; answered by "?"
    CLEAR, DISTANCE = 3, 1  # programs of DO_MEASURE
    AUTOMATIC_TILT = 1  # of DO_MEASURE and GET_MEASUREMENT
    NOT_IMPLEMENTED, MOTORS_IDLE = 5, 1798
    MOTORISED, TARGET_RECOGNITION = 0x04, 0x08  # bits of the configuration
    UNCORRECTED = (1283, 1284)  # not fully, or of no accuracy; with values
    NOWHERE_MM = np.full(3, np.nan)
    DISTANCE_MS = 5000  # that the instrument may take for a distance, besides `reading_s`
    TRIES = 5  # distances until one comes with all its places; zeros at the end take one in four
    CORRECTED = (1, 1, 1, 1)  # for tilt, tilt of the standing axis, collimation, tilting axis

    AIMED_RAD = 0.02  # window in which the target is found that a person has pointed at

    # Deadlines on the wire, in real time.
    REPLY_S = 5.0
    MOVE_S = 30.0

    # Angle at which its target recognition separates reflectors: 6 mm at 4 m, with their offsets.
    SIGHTS_APART_RAD = 3e-3

    class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
        """Where the instrument is, its air and prism, and the accuracy that its maker states.

        ``angle_arcsec``, ``distance_mm`` and ``distance_ppm`` are 1 sigma of one reading (ISO
        17123); a point that is measured once has its uncertainty from them.
        """

        channel: str
        reflector: str
        max_std_mm: Positive
        find_radius_mm: Positive
        reading_s: Annotated[float, Meta(ge=0.1, le=100)] = 0.5
        serial: str = ""
        prism_constant_mm: Annotated[float, Meta(ge=-200, le=200)] = 0.0
        temperature_c: Annotated[float, Meta(ge=-40, le=60)] = 20.0
        wet_bulb_c: Annotated[float, Meta(ge=-40, le=60)] | None = None
        pressure_mbar: Annotated[float, Meta(ge=500, le=1200)] = 1013.25
        edm_mode: Annotated[int, Meta(ge=0, le=20)] = 2  # single, standard, infrared
        angle_arcsec: Annotated[float, Meta(gt=0, le=60)] = 1.0
        distance_mm: Annotated[float, Meta(gt=0, le=20)] = 0.6
        distance_ppm: Annotated[float, Meta(ge=0, le=20)] = 1.0
        accept_uncorrected: bool = False

        def __post_init__(self) -> None:
            parse_channel(self.channel)
            if self.wet_bulb_c is not None and not self.wet_bulb_c <= self.temperature_c:
                raise ValueError(
                    f"wet_bulb_c is {self.wet_bulb_c:g}, expected at most temperature_c"
                    f" ({self.temperature_c:g}): a wet bulb is never warmer than the air"
                )

        def accuracy(self, range_m: float) -> tuple[float, float]:
            """Make these options `hilcell.ports.StatesAccuracy`."""
            along_mm = self.distance_mm + self.distance_ppm * 1e-3 * range_m
            return along_mm, self.angle_arcsec * (math.pi / 648_000)

        def std_mm(self, xyz_mm: Array) -> Array:
            """Return the standard deviations (3,) of one reading at a position (3,)."""
            range_mm = float(np.linalg.norm(xyz_mm))
            along_mm, across_rad = self.accuracy(range_mm / MM_PER_M)
            along_2 = (xyz_mm / range_mm) ** 2
            return np.sqrt(along_mm**2 * along_2 + (across_rad * range_mm) ** 2 * (1 - along_2))

    def __init__(self, options: Options, clock: Clock) -> None:
        self._options, self._clock = options, clock
        self._lines: TextLines | None = None
        # So an answer to an earlier program matches no request.
        self._transactions = count(time.time_ns() // 1_000_000)
        self._given_up: set[int] = set()
        self._settings: dict[str, tuple[Rpc, tuple[float, ...]]] = {}
        self._arrived_s = 0.0

    # -- the port -----------------------------------------------------------------------------

    def connect(self) -> list[Identity]:
        link = self._open()
        with on_failure(self.close):
            self._begin()
            identity = self._identity(link.address)
            check_serial(identity.serial, self._options.serial)
            self._set_up()
        return [identity]

    def inspect(self) -> list[Ability]:
        options, found = self._options, TrackerAbilities()
        link = self._open()
        with closing(self):
            self._begin()
            identity = self._identity(link.address)
            right = options.serial in ("", identity.serial)
            expected = "" if right else f"; the cell file has {options.serial}"
            found.need("serial number", right, f"{identity.serial}{expected}")
            found.need("GeoCOM", True, f"{identity.model}, firmware {identity.firmware}")
            configuration = self._told(Rpc.GET_CONFIGURATION)
            for feature, bit in (
                ("motors", self.MOTORISED),
                ("automatic target recognition", self.TARGET_RECOGNITION),
            ):
                if configuration is None:
                    found.may(feature, False, "not reported; see the maker's data sheet")
                else:
                    found.need(feature, bool(int(configuration[1]) & bit), "")
            for feature, read in (
                ("compensator", Rpc.GET_TILT_SWITCH),
                ("angle corrections", Rpc.GET_ANGLE_CORRECTIONS),
                ("distance mode", Rpc.GET_EDM_MODE),
                ("atmosphere", Rpc.GET_ATMOSPHERE),
                ("target recognition switch", Rpc.GET_ATR),
            ):
                values = self._told(read)
                note = "" if values is None else f"now {', '.join(f'{each:g}' for each in values)}"
                add = found.may if read is Rpc.GET_ANGLE_CORRECTIONS else found.need
                add(feature, values is not None, note)
            prism = self._told(Rpc.GET_PRISM_CONSTANT)
            prism_mm = math.nan if prism is None else MM_PER_M * prism[0]
            stated = f"{prism_mm:.2f} mm, the cell file has {options.prism_constant_mm:.2f} mm"
            found.need("prism constant", prism is not None, stated)
        found.may("weather station", False, "the air of tracker.options is used")
        found.may("second face", False, "errors of its axes are corrected by the instrument")
        found.may("stream", False, "no axis sweeps: gear ripple remains")
        return found.listed

    @classmethod
    def discover(cls, known: Mapping[str, object]) -> list[Candidate]:
        """Return the instrument at a channel, or a host's port 1212, that a person gave.

        Without one the serial lines are listed, by the names that they keep; nothing is sent.
        """
        channel = known.get("channel") or (known.get("host") and f"socket://{known['host']}:1212")
        if not channel:
            return [
                Candidate(f"serial line {line.name}", {"channel": str(line)}, [])
                for line in sorted(cls.SERIAL_LINES.glob("*"))
            ]
        anything = {"reflector": "", "max_std_mm": 1.0, "find_radius_mm": 1.0}
        try:
            options = typed({"channel": channel, **anything}, cls.Options)
            tracker = cls(options, WallClock(Event()))
            link = tracker._open()
            with closing(tracker):
                tracker._begin()
                identity = tracker._identity(link.address)
        except (DeviceError, msgspec.ValidationError):
            return []
        found: dict[str, object] = {"channel": options.channel, "serial": identity.serial}
        return [Candidate(f"{identity.text}, at {identity.address}", found, [identity])]

    def measure(self, near_mm: Array, reflector: str, samples: int) -> TrackerReading:
        near_mm = checked_request(near_mm, samples)
        return self._turned_reading(near_mm, reflector, samples, self._options.find_radius_mm)

    def search(
        self, near_mm: Array, reflector: str, samples: int, radius_mm: float
    ) -> TrackerReading:
        near_mm = checked_search(near_mm, samples, radius_mm)
        return self._turned_reading(near_mm, reflector, samples, radius_mm)

    def release_beam(self) -> None:
        """Stop the motors: the telescope is turned by hand."""
        reply = self._exchange(Rpc.STOP_MOTORS, (0,), self.REPLY_S)
        if reply.communication or reply.code not in (0, self.MOTORS_IDLE):
            raise Rpc.STOP_MOTORS.failed(reply.communication or reply.code)

    def measure_aimed(self, reflector: str, samples: int) -> TrackerReading:
        check_samples(samples)
        self._check_prism(reflector)
        points_mm = list[Array]()
        for _ in range(samples):
            self._fine_adjust(self.AIMED_RAD)
            points_mm.append(self._single())
        return self._reading(points_mm, reflector)

    def stop(self) -> None:
        if (lines := self._lines) is not None:  # another thread may be closing
            lines.send(self.ABORT, "stop")

    def close(self) -> None:
        if self._lines is not None:
            self._lines.link.close()
        self._lines = None

    # -- connecting ---------------------------------------------------------------------------

    def _open(self) -> Link:
        self.close()
        link = open_link(TRACKER, self._options.channel, self._clock.check)
        self._lines, self._given_up, self._settings = TextLines(link), set(), {}
        return link

    def _begin(self) -> None:
        """Get in step: an empty line ends half a request, and older answers are passed over."""
        self._wire().send("", "connect")
        transaction = self._send(Rpc.NULL)
        deadline = Deadline(self.REPLY_S)
        while (line := self._line(deadline)) is not None:
            if line.startswith("%R1P,") and self._parsed(line).transaction == transaction:
                return
        place = parse_channel(self._options.channel)
        at = f"at {place.baud} baud" if isinstance(place, SerialLine) else "on this port"
        came = f", but {count} bytes without an end" if (count := self._wire().unended) else ""
        raise self._lost(f"no answer in time{came}; is GeoCOM spoken {at}?", "connect")

    def _identity(self, address: str) -> Identity:
        options = self._options
        (serial_value,) = self._numbers(Rpc.GET_SERIAL, 1)
        if not math.isfinite(serial_value):
            raise self._lost(f"serial number {serial_value}", "connect")
        serial = f"{serial_value:.0f}"
        name = clean(",".join(self._stated(Rpc.GET_NAME).values))
        if not name.strip():
            raise self._lost("it does not tell its name", "connect")
        firmware = ".".join(f"{part:.0f}" for part in self._numbers(Rpc.GET_FIRMWARE, 3))
        uncorrected = ", readings without full correction are accepted"
        besides = uncorrected if options.accept_uncorrected else ""
        return leica_identity(name, besides, serial, address, firmware)

    def _set_up(self) -> None:
        options, set_to = self._options, self._set_checked
        # With fewer places an angle is good to 0.1 mm in a metre only.
        set_to("decimal places", Rpc.SET_PRECISION, Rpc.GET_PRECISION, PLACES)
        wet_c = options.temperature_c if options.wet_bulb_c is None else options.wet_bulb_c
        wavelength, *_ = self._numbers(Rpc.GET_ATMOSPHERE, 4)
        air = (wavelength, options.pressure_mbar, options.temperature_c, wet_c)
        set_to("atmosphere", Rpc.SET_ATMOSPHERE, Rpc.GET_ATMOSPHERE, *air)
        prism_m = options.prism_constant_mm / MM_PER_M
        set_to("prism constant", Rpc.SET_PRISM_CONSTANT, Rpc.GET_PRISM_CONSTANT, prism_m)
        set_to("distance mode", Rpc.SET_EDM_MODE, Rpc.GET_EDM_MODE, options.edm_mode)
        read = Rpc.GET_ANGLE_CORRECTIONS
        if self._exchange(read, (), self.REPLY_S).code != self.NOT_IMPLEMENTED:
            set_to("angle corrections", Rpc.SET_ANGLE_CORRECTIONS, read, *self.CORRECTED)
        set_to("compensator", Rpc.SET_TILT_SWITCH, Rpc.GET_TILT_SWITCH, 1)
        set_to("target recognition", Rpc.SET_ATR, Rpc.GET_ATR, 1)
        self._ask(Rpc.DO_MEASURE, self.CLEAR, self.AUTOMATIC_TILT)

    def _set_checked(self, what: str, write: Rpc, read: Rpc, *expected: float) -> None:
        """Write a setting where it reads differently, and read it back. Newer instruments accept
        the prism at their keyboard only: a right one is left alone.
        """
        found = self._numbers(read, len(expected))
        refusal = ""
        if not self._same(found, expected):
            try:
                self._ask(write, *expected)
            except DeviceError as error:
                if self._lines is None:
                    raise
                refusal = f", {error.found}"
            found = self._numbers(read, len(expected))
        if not self._same(found, expected):
            act = "set it at the instrument, or correct tracker.options; then resume"
            raise readback_error(what, found, expected, refusal, act)
        self._settings[what] = read, expected

    def _verify_settings(self) -> None:
        """Read all settings again: one may have been changed at the keyboard."""
        for what, (read, kept) in self._settings.items():
            reply = self._ask(read)
            if not reply.is_empty and self._same(self._decoded(reply, len(kept)), kept):
                continue
            found = self._numbers(read, len(kept))  # a character may have been lost
            if not self._same(found, kept):
                act = "changed at the instrument? resume sets it again, or correct the cell file"
                raise changed(what, f"now reads {found}", f"{kept}", act)

    # -- measuring ----------------------------------------------------------------------------

    def _turned_reading(
        self, near_mm: Array, reflector: str, samples: int, radius_mm: float
    ) -> TrackerReading:
        """Return a reading of the reflector within a radius of (3,) mm."""
        self._check_prism(reflector)
        self._ask(Rpc.TURN_TO, *self.angles_to(near_mm), 0, 0, 0, limit_s=self.MOVE_S)
        window_rad = 2.0 * radius_mm / max(float(np.linalg.norm(near_mm)), 1.0)
        points_mm = list[Array]()
        for _ in range(samples):
            try:
                self._fine_adjust(window_rad)
            except NoReading as error:
                error.fields.update(self._beam(), searched_mm=radius_mm)
                raise
            xyz_mm = self._single()
            off_mm = float(np.linalg.norm(xyz_mm - near_mm))
            if not off_mm <= radius_mm:
                raise off_target(off_mm, radius_mm)
            points_mm.append(xyz_mm)
        return self._reading(points_mm, reflector)

    def _check_prism(self, reflector: str) -> None:
        """Refuse a reflector of another prism constant, and settings that were changed."""
        known = self._options.reflector
        check_reflector(reflector, [known], f"the prism constant is that of {known!r}")
        self._verify_settings()

    def _reading(self, points_mm: list[Array], reflector: str) -> TrackerReading:
        options, samples = self._options, len(points_mm)
        std_mm = options.std_mm(points_mm[0])
        if samples > 1:
            std_mm = repeats_std(np.array(points_mm), options.max_std_mm)
        mean_mm = np.mean(points_mm, axis=0)
        return TrackerReading(mean_mm, std_mm, samples, reflector, None, self._arrived_s)

    def _beam(self) -> dict[str, object]:
        """Return where the telescope looks after a search; {} where it does not tell."""
        reply = self._exchange(Rpc.GET_ANGLES, (self.AUTOMATIC_TILT,), self.REPLY_S)
        if reply.communication or reply.is_empty:
            return {}
        hz_rad, v_rad = self._decoded(reply._replace(values=reply.values[:2]), 2)
        beam = position_mm(hz_rad, v_rad, 1.0) / MM_PER_M
        return {"beam": beam.tolist()} if bool(np.all(np.isfinite(beam))) else {}

    def _fine_adjust(self, window_rad: float) -> None:
        """Aim at the reflector in a window around the line of sight."""
        self._ask(Rpc.FINE_ADJUST, window_rad, window_rad, 0, limit_s=self.MOVE_S)

    def _single(self) -> Array:
        """Return one position (3,) of the reflector that is aimed at, measured from no distance."""
        options = self._options
        before_mm = self.NOWHERE_MM
        for _ in range(self.TRIES):
            reply = self._measured()
            values = self._decoded(reply, 3)
            if reply.is_whole:
                break
            at_mm = position_mm(*values) if possible(values) else self.NOWHERE_MM
            if float(np.linalg.norm(at_mm - before_mm)) <= options.max_std_mm:
                break  # no two lose the same character: both have lost zeros alone
            before_mm = at_mm
        else:
            found = f"the result {','.join(reply.values)[:80]} has lost characters"
            expected = f"{PLACES} decimal places, or two that agree"
            raise TRACKER.no_reading("HC-T14", "measure", clean(found), expected=expected)
        if not possible(values):
            raise TRACKER.no_reading(
                "HC-T14", "measure", f"the result {values} is no position", values=values
            )
        return position_mm(*values)

    def _measured(self) -> Reply:
        """Angles and a new distance; reading it makes it an old one."""
        options = self._options
        for program in (self.CLEAR, self.DISTANCE):
            self._ask(Rpc.DO_MEASURE, program, self.AUTOMATIC_TILT)
        wait_ms = self.DISTANCE_MS + round(1000 * options.reading_s)
        reply = self._ask(
            Rpc.GET_MEASUREMENT,
            wait_ms,
            self.AUTOMATIC_TILT,
            limit_s=wait_ms / 1000.0 + self.REPLY_S,
            accepted=options.accept_uncorrected,
        )
        if reply.is_empty:
            raise TRACKER.no_reading(
                "HC-T13", "measure", "the answer has no values", expected="some"
            )
        return reply

    # -- lines --------------------------------------------------------------------------------

    def _numbers(self, rpc: Rpc, size: int) -> tuple[float, ...]:
        return self._decoded(self._stated(rpc), size)

    def _told(self, rpc: Rpc) -> tuple[float, ...] | None:
        """Return the numbers of a setting; None of an instrument that does not know it."""
        try:
            values = self._stated(rpc).values
        except DeviceError as error:
            if error.fields.get("status") not in (self.NOT_IMPLEMENTED, *REFUSED_UNREAD):
                raise
            return None
        return self._decoded(Reply(0, 0, 0, values), len(values))

    def _stated(self, rpc: Rpc) -> Reply:
        """Ask for values until two answers in a row are the same; the line has no check sum."""
        deadline = Deadline(self.REPLY_S, self.REPLY_S)
        before = self._ask(rpc)
        while (reply := self._ask(rpc)).is_empty or reply.values != before.values:
            if deadline.expired():
                raise self._lost("answers without values, or each another one", rpc.label)
            before = reply
            self._clock.wait(BUSY_PAUSE_S)
        return reply

    def _ask(
        self, rpc: Rpc, *parameters: float, limit_s: float = 0.0, accepted: bool = False
    ) -> Reply:
        """Request, again while the instrument is busy, and return the reply.

        Raises the error of a refusal. ``accepted``: readings without full correction are taken.
        """
        limit_s = limit_s or self.REPLY_S
        ask = partial(self._exchange, rpc, parameters, limit_s)
        reply = retry_while_busy(ask, lambda reply: reply.code in BUSY, limit_s, self._clock)
        uncorrected = reply.code in self.UNCORRECTED
        if reply.communication or (reply.code and not (accepted and uncorrected)):
            raise rpc.failed(reply.communication or reply.code)
        return reply

    def _exchange(self, rpc: Rpc, parameters: tuple[float, ...], limit_s: float) -> Reply:
        transaction = self._send(rpc, *parameters)
        deadline = Deadline(limit_s)
        while (line := self._line(deadline)) is not None:
            reply = self._parsed(line)
            if reply.transaction == transaction:
                return reply
            if reply.transaction not in self._given_up:
                found = f"an answer to request {reply.transaction} came, not to {transaction}"
                raise self._lost(f"{found}; does another program use this line?", rpc.label)
        self._given_up.add(transaction)
        if not rpc.measures:
            raise self._lost("no answer in time", rpc.label)
        self._exchange(Rpc.NULL, (), self.REPLY_S)  # it lives, or the line is lost
        found = f"no answer to {rpc.label} in {limit_s:.1f} s"
        raise TRACKER.no_reading("HC-T13", "measure", found, waited_s=limit_s)

    def _send(self, rpc: Rpc, *parameters: float) -> int:
        transaction = 1 + next(self._transactions) % (self.TRANSACTIONS - 1)
        self._given_up.discard(transaction)
        self._wire().send(request(rpc, transaction, *parameters), rpc.label)
        return transaction

    def _line(self, deadline: Deadline) -> str | None:
        """Return the next line, None when ``deadline`` is over; a line that failed is closed."""
        try:
            line = self._wire().receive(deadline)
        except DeviceError:
            self.close()
            raise
        self._clock.check()  # the answer to a stop is none to a request
        return line

    def _parsed(self, line: str) -> Reply:
        """Return a reply; the line is lost where it is none, or reports a failure of the wire."""
        self._arrived_s = self._clock.pc_s()
        try:
            reply = parse(line)
        except ProtocolError as error:
            raise self._lost(str(error), "receive") from error
        if reply.communication not in (0, *REFUSED_UNREAD):
            found = f"communication {status_text(reply.communication)}"
            raise self._lost(found, "receive")
        return reply

    def _decoded(self, reply: Reply, size: int) -> tuple[float, ...]:
        try:
            return numbers(reply.values, size)
        except ProtocolError as error:
            raise self._lost(str(error), "decode") from error

    def _lost(self, found: str, operation: str) -> DeviceError:
        """Return the error after which the line cannot be trusted; the wire is closed."""
        error = self._wire().link.broken(operation, found)
        self.close()
        return error

    def _wire(self) -> TextLines:
        return TRACKER.connected(self._lines)

    @staticmethod
    def _same(found: tuple[float, ...], expected: tuple[float, ...]) -> bool:
        close = np.isclose(found, expected, rtol=1e-6, atol=1e-6)
        return bool(np.all(close & np.isfinite(found)))

    @staticmethod
    def angles_to(xyz_mm: Array) -> tuple[float, float]:
        """Return Hz, in [0, 2 pi), and V of a position (3,) in the instrument's frame.

        Its x points to Hz zero and its z up; y is to the left, as in every right-handed frame.
        """
        x, y, z = map(float, xyz_mm)
        return -math.atan2(y, x) % math.tau, math.atan2(math.hypot(x, y), z)
