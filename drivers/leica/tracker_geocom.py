"""A Leica total station over GeoCOM: a serial line, or TCP 1212. It measures at rest only.

The trap: the instrument keeps its last distance, and an answer may come after it was given up. So
the distance is cleared before each start, every request has a number of its own, and an answer to
a request that was given up is dropped; one to no request at all ends the connection. A line has no
check sum: a reading with fewer places than were set has lost a character, or a zero at its end.
"""

from __future__ import annotations

import math
import time
from itertools import count
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from drivers.leica import geocom
from drivers.leica.geocom import Code, Program, Reply, Rpc
from drivers.supervision import Patience, on_failure
from drivers.tracker_readings import (
    ALARMS,
    DEVICE,
    another_tracker,
    check_reflector,
    checked_order,
    misplaced,
    no_reading,
    refused,
    std_of_repeats,
    with_maker,
)
from drivers.wires.link import open_link
from drivers.wires.text_lines import TextLines
from hilcell.clean import clean
from hilcell.ports import (
    Array,
    Clock,
    DeviceError,
    Identity,
    TrackerReading,
    says_simulated,
)
from hilcell.wire.channel import SerialLine, parse_channel

BUSY_PAUSE_S = 0.1
DISTANCE_MS = 5000  # that the instrument may take for a distance, besides `reading_s`
SETTING_SHARE = 1e-6
NOWHERE_MM = np.full(3, np.nan)
TRIES = 5  # distances until one comes with all its places; zeros at the end take one in four
CORRECTED = (1, 1, 1, 1)  # for tilt, tilt of the standing axis, collimation, tilting axis

Positive = Annotated[float, Meta(gt=0)]


class LeicaGeocomTracker:
    """Satisfies `hilcell.ports.Tracker`."""

    # Deadlines on the wire, in real time.
    REPLY_S = 5.0
    MOVE_S = 30.0

    # Reflectors that its target recognition tells apart, and what a place may be off: 6 mm at 4 m.
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
            """Return 1 sigma of one reading: along the beam, mm, and across it, rad."""
            along_mm = self.distance_mm + self.distance_ppm * 1e-3 * range_m
            return along_mm, self.angle_arcsec * geocom.RAD_PER_ARCSEC

    def __init__(self, options: Options, clock: Clock) -> None:
        self._options, self._clock = options, clock
        self._lines: TextLines | None = None
        # An answer to a program that ran before is then nobody's.
        self._transactions = count(time.time_ns() // 1_000_000)
        self._given_up: set[int] = set()
        self._kept: dict[str, tuple[Rpc, tuple[float, ...]]] = {}
        self._arrived_s = 0.0

    # -- the port -----------------------------------------------------------------------------

    def connect(self) -> list[Identity]:
        """Open the wire, identify, set air, prism and modes, and read all of them back."""
        self.close()
        link = open_link(DEVICE, self._options.channel, self._clock.check, ALARMS)
        self._lines, self._given_up, self._kept = TextLines(link), set(), {}
        with on_failure(self.close):
            self._begin()
            identity = self._identify(link.address)
            self._set_up()
        return [identity]

    def measure(self, near_mm: Array, reflector: str, samples: int) -> TrackerReading:
        """Measure the reflector expected at ``near_mm`` (3,), tracker frame, ``samples`` times."""
        near_mm = checked_order(near_mm, samples)
        options = self._options
        known = options.reflector
        check_reflector(reflector, known, f"the prism constant is that of {known!r}")
        self._prove()
        self._ask(Rpc.TURN_TO, *geocom.angles_to(near_mm), 0, 0, 0, limit_s=self.MOVE_S)
        points_mm = np.array([self._single(near_mm) for _ in range(samples)])
        if samples > 1:
            std_mm = std_of_repeats(points_mm, options.max_std_mm)
        else:
            range_m = float(np.linalg.norm(points_mm[0])) / geocom.MM_PER_M
            std_mm = geocom.class_std_mm(points_mm[0], *options.accuracy(range_m))
        return TrackerReading(
            points_mm.mean(axis=0), std_mm, samples, reflector, None, self._arrived_s
        )

    def stop(self) -> None:
        """Stop turning and measuring; any thread; waits for no answer."""
        if self._lines is not None:
            self._lines.send(geocom.ABORT, "stop")

    def close(self) -> None:
        """Close the wire."""
        if self._lines is not None:
            self._lines.link.close()
        self._lines = None

    # -- connecting ---------------------------------------------------------------------------

    def _begin(self) -> None:
        """Get in step: an empty line ends half a request, and older answers are passed over."""
        self._wire().send("", "connect")
        transaction = self._send(Rpc.NULL)
        patience = Patience(self.REPLY_S)
        while (line := self._line(patience)) is not None:
            if line.startswith("%R1P,") and self._parsed(line).transaction == transaction:
                return
        place = parse_channel(self._options.channel)
        at = f"at {place.baud} baud" if isinstance(place, SerialLine) else "on this port"
        came = f", but {count} bytes without an end" if (count := self._wire().unended) else ""
        raise self._lost(f"no answer in time{came}; is GeoCOM spoken {at}?", "connect")

    def _identify(self, address: str) -> Identity:
        options = self._options
        (serial_value,) = self._numbers(Rpc.GET_SERIAL, 1)
        if not math.isfinite(serial_value):
            raise self._lost(f"serial number {serial_value}", "connect")
        serial = f"{serial_value:.0f}"
        if options.serial not in ("", serial):
            raise another_tracker(serial, options.serial)
        name = clean(",".join(self._stated(Rpc.GET_NAME).values))
        if not name.strip():
            raise self._lost("it does not tell its name", "connect")
        firmware = ".".join(f"{part:.0f}" for part in self._numbers(Rpc.GET_FIRMWARE, 3))
        model = with_maker("Leica", name)
        if options.accept_uncorrected:
            model += ", readings without full correction are accepted"
        simulated = says_simulated(name)
        return Identity(DEVICE, model, serial, address, simulated, "tracker", "Leica", firmware)

    def _set_up(self) -> None:
        options, set_to = self._options, self._set_checked
        # With fewer places an angle is good to 0.1 mm in a metre only.
        set_to("decimal places", Rpc.SET_PRECISION, Rpc.GET_PRECISION, geocom.PLACES)
        wet_c = options.temperature_c if options.wet_bulb_c is None else options.wet_bulb_c
        wavelength, *_ = self._numbers(Rpc.GET_ATMOSPHERE, 4)
        air = (wavelength, options.pressure_mbar, options.temperature_c, wet_c)
        set_to("atmosphere", Rpc.SET_ATMOSPHERE, Rpc.GET_ATMOSPHERE, *air)
        prism_m = options.prism_constant_mm / geocom.MM_PER_M
        set_to("prism constant", Rpc.SET_PRISM_CONSTANT, Rpc.GET_PRISM_CONSTANT, prism_m)
        set_to("distance mode", Rpc.SET_EDM_MODE, Rpc.GET_EDM_MODE, options.edm_mode)
        read = Rpc.GET_ANGLE_CORRECTIONS
        if self._exchange(read, (), self.REPLY_S).code != Code.NOT_IMPLEMENTED:
            set_to("angle corrections", Rpc.SET_ANGLE_CORRECTIONS, read, *CORRECTED)
        set_to("compensator", Rpc.SET_TILT_SWITCH, Rpc.GET_TILT_SWITCH, 1)
        set_to("target recognition", Rpc.SET_ATR, Rpc.GET_ATR, 1)
        self._ask(Rpc.DO_MEASURE, Program.CLEAR, geocom.AUTOMATIC_TILT)

    def _set_checked(self, what: str, write: Rpc, read: Rpc, *wanted: float) -> None:
        """Write a setting where it reads differently, and believe it only when it reads back.

        Newer instruments take the prism at their keyboard only: one that is right is left alone.
        """
        found = self._numbers(read, len(wanted))
        refusal = ""
        if not _same(found, wanted):
            try:
                self._ask(write, *wanted)
            except DeviceError as error:
                if self._lines is None:
                    raise
                refusal = f", {error.found}"
            found = self._numbers(read, len(wanted))
        if not _same(found, wanted):
            raise refused(
                "HC-T06",
                f"set {what}",
                f"reads back as {found}{refusal}",
                wanted=f"{wanted}",
                act="set it at the instrument, or correct tracker.options; then resume",
                setting=what,
                read=found,
                written=wanted,
            )
        self._kept[what] = read, wanted

    def _prove(self) -> None:
        """Read all settings again: somebody may have changed one at the keyboard."""
        for what, (read, kept) in self._kept.items():
            reply = self._ask(read)
            if not reply.is_empty and _same(self._decoded(reply, len(kept)), kept):
                continue
            found = self._numbers(read, len(kept))  # a character may have been lost
            if not _same(found, kept):
                raise DeviceError(
                    "HC-T06",
                    DEVICE,
                    f"read {what} again",
                    f"now reads {found}",
                    wanted=f"{kept}",
                    act="changed at the instrument? resume sets it again, or correct the cell file",
                    fields={"setting": what},
                )

    # -- measuring ----------------------------------------------------------------------------

    def _single(self, near_mm: Array) -> Array:
        """Return one position (3,): aimed at its reflector, measured from no distance."""
        options = self._options
        window_rad = 2.0 * options.find_radius_mm / max(float(np.linalg.norm(near_mm)), 1.0)
        self._ask(Rpc.FINE_ADJUST, window_rad, window_rad, 0, limit_s=self.MOVE_S)
        before_mm = NOWHERE_MM
        for _ in range(TRIES):
            reply = self._measured()
            values = self._decoded(reply, 3)
            if reply.is_whole:
                break
            at_mm = geocom.position_mm(*values) if geocom.possible(values) else NOWHERE_MM
            if float(np.linalg.norm(at_mm - before_mm)) <= options.max_std_mm:
                break  # no two lose the same character: both have lost zeros alone
            before_mm = at_mm
        else:
            found = f"the result {','.join(reply.values)[:80]} has lost characters"
            wanted = f"{geocom.PLACES} decimal places, or two that agree"
            raise no_reading("HC-T14", clean(found), wanted=wanted, act="check the line")
        if not geocom.possible(values):
            raise no_reading("HC-T14", f"the result {values} is no position", values=values)
        xyz_mm = geocom.position_mm(*values)
        off_mm = float(np.linalg.norm(xyz_mm - near_mm))
        if not off_mm <= options.find_radius_mm:
            raise misplaced(off_mm, options.find_radius_mm)
        return xyz_mm

    def _measured(self) -> Reply:
        """Return angles and a new distance, which reading it makes an old one."""
        options = self._options
        for program in (Program.CLEAR, Program.DISTANCE):
            self._ask(Rpc.DO_MEASURE, program, geocom.AUTOMATIC_TILT)
        wait_ms = DISTANCE_MS + round(1000 * options.reading_s)
        reply = self._ask(
            Rpc.GET_MEASUREMENT,
            wait_ms,
            geocom.AUTOMATIC_TILT,
            limit_s=wait_ms / 1000.0 + self.REPLY_S,
            accepted=options.accept_uncorrected,
        )
        if reply.is_empty:
            raise no_reading("HC-T13", "the answer has no values", act=geocom.ACT)
        return reply

    # -- lines --------------------------------------------------------------------------------

    def _numbers(self, rpc: Rpc, size: int) -> tuple[float, ...]:
        """Ask for numbers."""
        return self._decoded(self._stated(rpc), size)

    def _stated(self, rpc: Rpc) -> Reply:
        """Ask for values until two answers in a row are the same; the line has no check sum."""
        patience = Patience(self.REPLY_S, self.REPLY_S)
        before = self._ask(rpc)
        while (reply := self._ask(rpc)).is_empty or reply.values != before.values:
            if patience.over():
                raise self._lost("answers without values, or each another one", rpc.spoken)
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
        patience = Patience(limit_s, limit_s)
        while (reply := self._exchange(rpc, parameters, limit_s)).code in geocom.BUSY:
            if patience.over():
                break
            self._clock.wait(BUSY_PAUSE_S)
        uncorrected = reply.code in (Code.UNCORRECTED, Code.INACCURATE)
        if reply.communication or (reply.code != Code.OK and not (accepted and uncorrected)):
            raise rpc.failed(reply.communication or reply.code)
        return reply

    def _exchange(self, rpc: Rpc, parameters: tuple[float, ...], limit_s: float) -> Reply:
        transaction = self._send(rpc, *parameters)
        patience = Patience(limit_s)
        while (line := self._line(patience)) is not None:
            reply = self._parsed(line)
            if reply.transaction == transaction:
                return reply
            if reply.transaction not in self._given_up:
                found = f"an answer to request {reply.transaction} came, not to {transaction}"
                raise self._lost(f"{found}; does another program use this line?", rpc.spoken)
        self._given_up.add(transaction)
        if not rpc.measures:
            raise self._lost("no answer in time", rpc.spoken)
        self._exchange(Rpc.NULL, (), self.REPLY_S)  # it lives, or the line is lost
        raise no_reading("HC-T13", f"no answer to {rpc.spoken} in {limit_s:.1f} s", act=geocom.ACT)

    def _send(self, rpc: Rpc, *parameters: float) -> int:
        transaction = 1 + next(self._transactions) % (geocom.TRANSACTIONS - 1)
        self._given_up.discard(transaction)
        self._wire().send(geocom.request(rpc, transaction, *parameters), rpc.spoken)
        return transaction

    def _line(self, patience: Patience) -> str | None:
        """Return the next line, None when ``patience`` is over; a line that failed is closed."""
        try:
            line = self._wire().receive(patience)
        except DeviceError:
            self.close()
            raise
        self._clock.check()  # the answer to a stop is none to a request
        return line

    def _parsed(self, line: str) -> Reply:
        """Return a reply; the line is lost where it is none, or tells that the wire failed."""
        self._arrived_s = self._clock.pc_s()
        try:
            reply = geocom.parse(line)
        except geocom.GeocomError as error:
            raise self._lost(str(error), "receive") from error
        if reply.communication not in (0, *geocom.REFUSED_UNREAD):
            found = f"communication {geocom.status_text(reply.communication)}"
            raise self._lost(found, "receive")
        return reply

    def _decoded(self, reply: Reply, size: int) -> tuple[float, ...]:
        try:
            return geocom.numbers(reply.values, size)
        except geocom.GeocomError as error:
            raise self._lost(str(error), "decode") from error

    def _lost(self, found: str, operation: str) -> DeviceError:
        """Return the error after which the line cannot be trusted; the wire is closed."""
        error = self._wire().link.broken(operation, found)
        self.close()
        return error

    def _wire(self) -> TextLines:
        if self._lines is None:
            raise DeviceError("HC-T34", DEVICE, "use", "not connected", act="connect first")
        return self._lines


def _same(found: tuple[float, ...], wanted: tuple[float, ...]) -> bool:
    close = np.isclose(found, wanted, rtol=SETTING_SHARE, atol=SETTING_SHARE)
    return bool(np.all(close & np.isfinite(found)))
