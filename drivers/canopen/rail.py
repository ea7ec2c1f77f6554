"""The rail: a CiA 402 drive and a CiA 406 magnetic-strip sensor on one CANopen bus.

Moves and readings by PDO and SYNC, settings by SDO. The drive knows the position at its encoder
only; the strip, read at rest, decides where the slide is, in the closed loop above this driver.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from drivers.canopen import bus_scan, cia, requirements
from drivers.canopen.can_link import CanLink, heartbeat_period_s, open_bus
from drivers.canopen.cia import Control, NodeCommand, NodeState, Object, State
from drivers.canopen.controller_side import drive_and_strip
from drivers.canopen.drive import Drive, Jog
from drivers.canopen.drive_units import PER_MINUTE, DriveUnits, Stated, Unit, unit_problems
from drivers.canopen.motion_guard import Limits
from drivers.canopen.nodes import (
    HOMING_SLOW_MM_S,
    PC_HEARTBEAT_LIMIT_MS,
    Expected,
    Homing,
    Node,
    homing_s,
    set_up_drive,
    start_nodes,
)
from drivers.canopen.process_image import ProcessImage, ReadStrip, Snapshot
from drivers.canopen.requirements import object_name
from drivers.canopen.sdo import SdoChannel, open_channel
from drivers.canopen.slcan_bus import Interface, bus_problems
from drivers.canopen.vendor_profiles import make_of
from drivers.device_errors import RAIL
from drivers.slide import READINGS, Rest, Standstill, Windows, check_travel, strip_spread
from drivers.strips import (
    U32,
    CountsPerMm,
    NodeNumber,
    Positive,
    StripNode,
    StripOptions,
    StripReader,
    strip_of,
)
from drivers.supervision import Deadline, Watchdog, ignore_stop, on_failure
from hilcell.cell.settings import refuse
from hilcell.ports import (
    Ability,
    AfterLoss,
    Candidate,
    Clock,
    ControllerSide,
    DeviceError,
    Identity,
    LinkStatistics,
    RailReading,
    RailTrace,
)

LOST = frozenset({"HC-R01", "HC-R02", "HC-R05", "HC-R06", "HC-R07"})  # of a link that is lost
SLACK_MM = 5.0  # the slide may read so far beyond its travel before that is a runaway


class CanopenRail:
    """Satisfies `hilcell.ports.Rail`, `Jogs`, `StopsItself`, `Inspects` and `Discovers`."""

    LATE_S = 0.8  # below the consumer time of the drive (1016h)
    WINDOW_MM = 0.05
    own_stop_s = PC_HEARTBEAT_LIMIT_MS / 1000

    class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
        """The bus, the two nodes, their scales and units, and how the drive gets its reference.

        ``counts_per_mm`` is negative where a drive counts down while the slide moves up.
        ``speed_unit`` "": that of 60A9h, else of the make, else counts/s. ``acceleration_unit`` "":
        that of 60AAh, else that of speed per second. ``counts_per_turn`` 0: as the drive states.
        """

        channel: str
        travel_min_mm: float
        travel_max_mm: float
        speed_mm_s: Positive
        acceleration_mm_s2: Positive
        interface: Interface = "slcan"
        bitrate: int = 500_000
        drive_node: NodeNumber = 5
        strip_node: NodeNumber = 6
        heartbeat_node: NodeNumber = 127
        counts_per_mm: float = 1000.0
        speed_unit: str = ""
        acceleration_unit: str = ""
        counts_per_turn: Annotated[float, Meta(ge=0)] = 0.0  # of the motor, as 6064h counts
        strip_counts_per_mm: CountsPerMm = 100.0
        strip_zero_mm: float = 0.0
        drive_vendor: U32 = 0x484
        drive_product: U32 = 0x402
        drive_serial: U32 = 0
        strip_vendor: U32 = 0x484
        strip_product: U32 = 0x406
        strip_serial: U32 = 0
        standstill_speed_mm_s: Annotated[float, Meta(ge=0.01, le=5)] = 0.5
        standstill_window_mm: Annotated[float, Meta(ge=0.001, le=0.1)] = 0.01
        standstill_dwell_s: Annotated[float, Meta(ge=0.05, le=5)] = 0.4
        homing: Literal[17, 18, 33, 34, 35, 37, "absolute"] = 17  # 6098h
        home_mm: float = 0.0  # of the slide, where homing by a motion ends
        homing_mm_s: Positive = 100.0
        slip_limit_mm: Positive = 2.0
        strip: StripOptions | None = None  # one that is not on the bus

        def __post_init__(self) -> None:
            refuse(bus_problems(self.interface, self.channel, self.bitrate))
            if len({self.drive_node, self.strip_node, self.heartbeat_node}) < 3:
                raise ValueError("drive_node, strip_node and heartbeat_node must differ")
            if self.strip is not None and self.strip.channel == self.channel:
                raise ValueError("strip.channel: a strip on the drive's bus needs no table")
            if self.strip is not None and self.strip_serial:
                raise ValueError("strip_serial: the strip has a table; state strip.serial")
            if self.strip is not None and self.strip_zero_mm:
                raise ValueError("strip_zero_mm: the strip has a table; state strip.zero_mm")
            if not self.travel_min_mm < self.travel_max_mm:
                raise ValueError("travel_min_mm must be below travel_max_mm")
            reach_mm = max(abs(self.travel_min_mm), abs(self.travel_max_mm)) + SLACK_MM
            if not 0 < reach_mm * abs(self.counts_per_mm) < 2**31 - 1:
                raise ValueError("travel times counts_per_mm is 0 or does not fit 32 bits")
            refuse(unit_problems(self.speed_unit, self.acceleration_unit))
            if self.home_mm and self.homing in ("absolute", *Homing.HERE):
                raise ValueError(f"home_mm: homing {self.homing} takes the place of the slide")

    def __init__(self, options: Options, clock: Clock) -> None:
        self._options, self._clock = options, clock
        self._link: CanLink | None = None
        self._statistics = LinkStatistics()
        self._image: ProcessImage | None = None
        self._drive: Drive | None = None
        self._ended_s: float | None = None  # when the end of the last motion was detected
        self._held_by_sdo = 0
        self._lost_s: float | None = None  # since when a moving slide is without a link
        self._after_loss: AfterLoss | None = None
        self._nodes: tuple[Node, ...] = ()
        self._feed: StripReader | None = None  # of a strip that is not on the bus
        if options.strip is not None:
            self._feed = StripReader(strip_of(options.strip, clock))
        self._strip = options.strip or StripOptions(
            driver="canopen",
            channel=options.channel,
            counts_per_mm=options.strip_counts_per_mm,
            zero_mm=options.strip_zero_mm,
            serial=options.strip_serial,
            interface=options.interface,
            bitrate=options.bitrate,
            node=options.strip_node,
            vendor=options.strip_vendor,
            product=options.strip_product,
        )
        scale, of_strip = abs(options.counts_per_mm), self._strip.scale
        method = None if options.homing == "absolute" else options.homing
        self._homing = Homing(method, options.homing_mm_s, round(options.home_mm * scale))
        self._limits = Limits(
            counts_per_mm=scale,
            strip_counts_per_mm=of_strip,
            strip_at_sync=options.strip is None,
            lowest=round((options.travel_min_mm - SLACK_MM) * scale),
            highest=round((options.travel_max_mm + SLACK_MM) * scale),
            speed=options.speed_mm_s * scale,
            acceleration=options.acceleration_mm_s2 * scale,
            homing_s=homing_s(
                travel_mm=options.travel_max_mm - options.travel_min_mm,
                speed_mm_s=min(options.speed_mm_s, options.homing_mm_s),
            ),
            window=max(1, round(self.WINDOW_MM * scale)),
            windows=Windows(
                speed=max(1.0, options.standstill_speed_mm_s * scale),
                spread=max(2, round(options.standstill_window_mm * scale)),
                strip_spread=strip_spread(of_strip),
                dwell_s=options.standstill_dwell_s,
            ),
        )

    # -- the port -----------------------------------------------------------------------------

    def connect(self) -> list[Identity]:
        self._close_link()
        options = self._options
        bus = open_bus(options.interface, options.channel, options.bitrate)
        self._link = CanLink(bus, self._clock)
        with on_failure(self._close_link):
            return self._set_up(self._link)

    def home(self) -> None:
        """Let the drive have its reference. By a motion it then reads ``home_mm``, or the end of
        its ramp behind the edge; else the strip's reading, without a motion.
        """
        options, drive, scale = self._options, self._used(), self._limits.counts_per_mm
        past_mm = HOMING_SLOW_MM_S**2 / options.acceleration_mm_s2  # twice the ramp
        if self._homing.moves:
            self._move(lambda: drive.home(round((self.WINDOW_MM + past_mm) * scale)))
            return
        reading = self.settle()
        if self._homing.method is not None:
            counts, window = round(reading.strip_mm * scale), self._limits.window
            self._move(lambda: drive.set_reference(counts, window))
        elif not abs(reading.position_mm - reading.strip_mm) <= options.slip_limit_mm:
            raise RAIL.failed(
                "HC-R53",
                "home",
                f"absolute drive {reading.position_mm:.2f} mm and strip {reading.strip_mm:.2f} mm "
                "differ",
                expected=f"<= {options.slip_limit_mm:.2f} mm apart",
                drive_mm=reading.position_mm,
                strip_mm=reading.strip_mm,
                limit_mm=options.slip_limit_mm,
            )
        else:
            self._ended_s = reading.taken_s

    def move_to(self, position_mm: float) -> None:
        options, drive = self._options, self._used()
        check_travel(position_mm, options.travel_min_mm, options.travel_max_mm)
        self._move(lambda: drive.move(round(position_mm * self._limits.counts_per_mm)))

    def settle(self) -> RailReading:
        """Return a reading at rest: medians of five in a row within the windows, over the dwell."""
        self._reconnect_strip()
        return self._used().slide.settle(self._ended_s)

    def read(self) -> RailReading:
        self._reconnect_strip()
        return self._used().slide.read(self._ended_s)

    def hold(self) -> None:
        self._used().disable()

    def jog(
        self,
        distance_mm: float,
        *,
        bound_mm: float,
        speed_mm_s: float,
        stop_after_mm: float | None = None,
    ) -> RailTrace:
        """As `hilcell.ports.Jogs`; times are of the cell's clock.

        Raises `ValueError` where the bound leaves no room behind the distance.
        """
        jog = self._begun(distance_mm, bound_mm, speed_mm_s, stop_after_mm)
        with on_failure(self._stop_after_failure):
            return self._jog(jog)

    def jog_until_lost(
        self, distance_mm: float, *, bound_mm: float, speed_mm_s: float
    ) -> RailTrace:
        """As `hilcell.ports.StopsItself`."""
        jog = self._begun(distance_mm, bound_mm, speed_mm_s)
        with on_failure(self._stop_after_failure):
            try:
                return self._jog(jog)
            except DeviceError as error:
                if error.code not in LOST or not jog.polls:
                    raise
            self._lost_s, self._after_loss = time.monotonic(), None
            self._close_link()  # with it the heartbeat ends, and no stop is sent
            return _trace(jog, "lost")

    def regain(self) -> AfterLoss:
        """As `hilcell.ports.StopsItself`; the drive is read by SDO alone."""
        o, check, spare_s = self._options, self._clock.check, 1.0
        silent_s = math.inf if self._lost_s is None else time.monotonic() - self._lost_s
        if not silent_s > self.own_stop_s + spare_s:
            found = f"the PC is silent for {silent_s:.1f} s"
            raise RAIL.failed("HC-R01", "regain", found, expected=f"{self.own_stop_s + spare_s} s")
        link = CanLink(open_bus(o.interface, o.channel, o.bitrate), self._clock)
        try:
            drive = open_channel(link, o.drive_node, "drive.eds", check)
            # A connect that fails half-way has reset the drive's error: the first reading counts.
            self._after_loss = self._after_loss or state_after_loss(
                drive, self._clock, self._limits
            )
        finally:
            link.close()
        self.connect()
        return self._after_loss

    def rescaled(self, drive: float, strip: float, speed: float) -> dict[str, object]:
        """As `hilcell.ports.Jogs`. A unit of speed that is no power of ten of counts/s becomes rpm
        of a motor with as many counts a turn.
        """
        o, small = self._options, 0.03
        found: dict[str, object] = {"counts_per_mm": o.counts_per_mm / drive}
        if o.strip is None:
            found["strip_counts_per_mm"] = o.strip_counts_per_mm / strip
            found["strip_zero_mm"] = o.strip_zero_mm * strip
        else:
            of_strip: dict[str, object] = msgspec.to_builtins(o.strip)
            scale, zero_mm = o.strip.counts_per_mm / strip, o.strip.zero_mm * strip
            found["strip"] = of_strip | {"counts_per_mm": scale, "zero_mm": zero_mm}
        if not abs(speed / drive - 1) <= small:  # the unit follows the counts
            counts_s = self._used().units.speed * abs(speed / drive)
            power = round(math.log10(counts_s))
            if abs(counts_s / 10.0**power - 1) <= small:
                factor = "" if not power else f"{10.0**power:g} "
                found |= {"speed_unit": f"{factor}counts/s", "acceleration_unit": ""}
            else:
                per_turn = round(PER_MINUTE * counts_s)
                found |= {
                    "speed_unit": "rpm", "acceleration_unit": "", "counts_per_turn": per_turn
                }  # fmt: skip
        return found

    def statistics(self) -> LinkStatistics:
        link, feed = self._link, self._feed
        of_drive = link.statistics() if link is not None else self._statistics
        return of_drive if feed is None else of_drive + feed.statistics()

    def stop(self) -> None:
        if (image := self._image) is not None:  # another thread may be closing
            image.quick_stop()

    def close(self) -> None:
        """Leave the slide held and the wire closed, also after a stop or a failure."""
        if self._lost_s is not None:
            raise RAIL.failed(
                "HC-R37",
                "close",
                "the link was lost while the slide moved, and not regained",
                expected="a slide that is confirmed as held",
                act="keep away from the slide; press the E-stop, or switch the drive off",
            )
        try:
            if self._image is not None and self._link is not None:
                self._release(self._link, self._image)
        finally:
            self._close_link()

    @classmethod
    def discover(cls, known: Mapping[str, object]) -> list[Candidate]:
        """As `hilcell.ports.Discovers`: by listening, and by an upload of 1000h from each node."""
        return bus_scan.discover(known)

    def inspect(self) -> list[Ability]:
        """As `hilcell.ports.Inspects`, by SDO alone; of a strip on the drive's bus, too."""
        o, check = self._options, self._clock.check
        link = CanLink(open_bus(o.interface, o.channel, o.bitrate), self._clock)
        try:
            drive = open_channel(link, o.drive_node, "drive.eds", check)
            off = requirements.is_off(drive)
            found = [*requirements.inspect(drive, "Drive", make_of(drive).objects(), off=off)]
            if o.strip is None:
                strip = open_channel(link, o.strip_node, "strip.eds", check)
                found += requirements.inspect(strip, "Strip", requirements.STRIP, off=off)
            return found
        finally:
            link.close()

    # -- connecting ---------------------------------------------------------------------------

    @classmethod
    def controller_side(cls, options: Mapping[str, object]) -> ControllerSide:
        return drive_and_strip(options)

    def _set_up(self, link: CanLink) -> list[Identity]:
        o, check, feed = self._options, self._clock.check, self._feed
        expected = Expected(
            "drive",
            o.drive_node,
            cia.DRIVE_PROFILE,
            o.drive_vendor,
            o.drive_product,
            o.drive_serial,
        )
        self._nodes = (Node(link, expected, check),)
        read_strip: ReadStrip
        if feed is None:
            strip = StripNode(link, self._strip, check)
            self._nodes, pdo = (*self._nodes, strip), strip.pdo
            read_strip = lambda values, _: strip.values(values)  # noqa: E731
            self._check_not_exchanged()
        else:
            pdo, read_strip = None, lambda _, check: feed.poll(check)
        watchdog = Watchdog(RAIL, "HC-R39", self._clock, self.LATE_S)
        identities = [node.identify(o.channel) for node in self._nodes]
        units = self._units()
        image = ProcessImage(link, o.drive_node, read_strip, pdo, units=units)
        if feed is not None:
            identities.append(feed.connect())
        try:
            self._configure(link, image, watchdog)
        except DeviceError:
            self._check_nodes("connect")  # one that was reset meanwhile is the cause
            raise
        sdo, text = self._nodes[0].sdo, cia.alarm_text if feed is None else feed.alarm_text
        drive = Drive(
            image,
            sdo,
            self._clock,
            self._limits,
            self._check_nodes,
            watchdog,
            homing=self._homing,
            alarm_text=text,
        )
        drive.reset_fault()
        for node in self._nodes:
            node.arm()
        drive.disable("connect")
        self._image, self._drive, self._held_by_sdo, self._lost_s = image, drive, 0, None
        return identities

    def _configure(self, link: CanLink, image: ProcessImage, watchdog: Watchdog) -> None:
        """Set the nodes up and start them; raises `DeviceError`."""
        options, drive = self._options, self._nodes[0]
        strips = [node for node in self._nodes if isinstance(node, StripNode)]
        for node in self._nodes:
            node.begin_set_up()
        period_s = heartbeat_period_s(options.bitrate)
        link.start_heartbeat(options.heartbeat_node, watchdog.is_fed, period_s)
        drive.set_heartbeat(options.bitrate)
        set_up_drive(drive.sdo, self._limits, image.units, options.heartbeat_node, self._homing)
        for strip in strips:
            strip.set_heartbeat(options.bitrate)
        image.configure(drive.sdo)
        for strip in strips:
            strip.map(image.inbox)
        start_nodes(link, self._nodes, self._clock.check)
        self._check_nodes("connect")

    def _check_not_exchanged(self) -> None:
        """Refuse a strip where the drive is expected, and the other way round."""
        o = self._options
        if [node.profile() for node in self._nodes] == [cia.ENCODER_PROFILE, cia.DRIVE_PROFILE]:
            raise RAIL.refused(
                "HC-R08",
                "connect",
                f"node {o.drive_node} is an encoder (CiA 406), node {o.strip_node} a drive (CiA "
                "402): the node numbers are exchanged",
                expected=f"a drive at {o.drive_node}, the strip's sensor at {o.strip_node}",
                act=f"set drive_node = {o.strip_node} and strip_node = {o.drive_node} in "
                "[rail.options]",
                drive_node=o.drive_node,
                strip_node=o.strip_node,
            )

    def _units(self) -> DriveUnits:
        """Return the units by the options and by what the drive states; raises `DeviceRefused`."""
        o, sdo = self._options, self._nodes[0].sdo
        make = make_of(sdo)
        self._homing = replace(self._homing, offset=make.home_offset)
        stated = Stated.read(sdo.read_if_present, make.turn)
        given = Unit.of(o.speed_unit) if o.speed_unit else None
        given_ramp = Unit.of(o.acceleration_unit) if o.acceleration_unit else None
        for where, value, expected in stated.contradictions(
            given, given_ramp, o.counts_per_mm, o.counts_per_turn
        ):
            raise RAIL.refused(
                "HC-R54",
                "connect",
                f"the drive states {value} in {where}",
                expected=expected,
                act="correct the option in [rail.options], or the drive's units",
                object=where,
                stated=value,
            )
        speed, ramp = given or stated.speed, given_ramp or stated.acceleration
        if speed is None:
            speed, ramp = Unit.of(make.speed_unit), ramp or Unit.of(make.acceleration_unit)
        ramp = ramp or Unit.of(speed.per_second())
        per_turn = o.counts_per_turn or stated.turn_counts or 0.0
        if not per_turn and (speed.of_turns or ramp.of_turns):
            raise RAIL.refused(
                "HC-R54",
                "connect",
                f"units are {speed.text} and {ramp.text}, and the drive does not state the counts "
                f"of a turn ({object_name(*make.turn)})",
                expected="counts_per_turn in [rail.options]",
                object=object_name(*make.turn),
                stated="",
            )
        units = DriveUnits(
            1 if o.counts_per_mm > 0 else -1,
            speed.counts(o.counts_per_mm, per_turn),
            ramp.counts(o.counts_per_mm, per_turn),
        )
        windows = self._limits.windows
        still = max(units.speed, o.standstill_speed_mm_s * self._limits.counts_per_mm)
        self._limits = replace(self._limits, windows=replace(windows, speed=still))
        return units

    def _reconnect_strip(self) -> None:
        if self._feed is not None:
            self._feed.reconnect()

    # -- helpers ------------------------------------------------------------------------------

    def _check_nodes(self, operation: str) -> None:
        for node in self._nodes:
            node.check(operation)

    def _used(self) -> Drive:
        return RAIL.connected(self._drive)

    def _move(self, motion: Callable[[], None]) -> None:
        self._ended_s = None
        with on_failure(self._stop_after_failure):
            motion()
        self._ended_s = self._clock.pc_s()

    def _begun(
        self,
        distance_mm: float,
        bound_mm: float,
        speed_mm_s: float,
        stop_after_mm: float | None = None,
    ) -> Jog:
        if not abs(distance_mm) < bound_mm:
            raise ValueError(f"a jog by {distance_mm} mm exceeds its bound of {bound_mm} mm")
        self._reconnect_strip()
        self._ended_s = None
        return Jog(distance_mm, bound_mm, speed_mm_s, stop_after_mm, self._limits, [])

    def _jog(self, jog: Jog) -> RailTrace:
        stopped_by = self._used().jog(jog)
        self._ended_s = self._clock.pc_s()
        return _trace(jog, stopped_by)

    def _stop_after_failure(self) -> None:
        with suppress(DeviceError):  # the first failure, which is being raised, is to be reported
            self.stop()

    def _release(self, link: CanLink, image: ProcessImage) -> None:
        sdo = open_channel(link, self._options.drive_node, "drive.eds", ignore_stop)
        node, rest = self._nodes[0], self._used().slide.rest
        release = Release(link, image, sdo, self._limits, node=node, rest=rest)
        release.leave_held()
        self._held_by_sdo = int(release.by_sdo)
        # From here on there is no heartbeat; without this the drive would go to fault.
        if not image.stopped:
            sdo.write(Object.CONSUMER_HEARTBEAT, 1, 0)

    def _close_link(self) -> None:
        link, self._link = self._link, None
        self._image = self._drive = None
        self._nodes = ()
        if self._feed is not None:
            self._feed.close()
        if link is not None:
            self._statistics = replace(link.statistics(), held_by_sdo=self._held_by_sdo)
            link.close()


def _trace(jog: Jog, stopped_by: Literal["", "bound", "stop", "lost"]) -> RailTrace:
    taken_s, drive_mm, strip_mm, velocity_mm_s = np.array(jog.polls, dtype=float).T
    return RailTrace(taken_s, drive_mm, strip_mm, velocity_mm_s, stopped_by)


def state_after_loss(sdo: SdoChannel, clock: Clock, limits: Limits) -> AfterLoss:
    """Return how a drive stands that answers again, by SDO reads alone; raises `DeviceError`."""
    state = cia.state_of(sdo.read(Object.STATUSWORD))
    code = sdo.read_if_present(Object.ERROR_CODE) or 0
    before, dwell_s = sdo.read(Object.POSITION_ACTUAL), 0.5
    clock.wait(dwell_s)
    moved = abs(sdo.read(Object.POSITION_ACTUAL) - before)
    rests = moved <= limits.window
    words = "at rest" if rests else f"MOVED {limits.mm(moved)} within {dwell_s} s"
    error = f"error {cia.error_text(code)}" if cia.is_error(code) else "no error"
    return AfterLoss(
        stopped=rests and state is not State.ENABLED, text=f"drive {state.value}, {error}, {words}"
    )


class Release:
    """The end of a session: the drive without power, the slide at rest, and both confirmed.

    It polls without the run's clock, which no longer waits after a stop. No PDO is confirmed, so a
    drive that continues after a quick stop is stopped again at each poll, then by SDO and by the
    end of the PC's heartbeat, then by taking its power away. One without power may still roll: it
    counts as held only when its positions are at rest for a dwell, or where they were before.

    A drive that has missed the PC's heartbeat brakes by itself and leaves OPERATIONAL (CiA 301,
    1029h). It then ignores PDOs but answers SDO: the same values are read and the same control
    words are written by SDO.
    """

    RELEASE_S = 5.0  # wire deadline, beside two dwells
    SILENT_S = 1.0  # more than a poll takes that nothing answers
    POLL_S = 0.02
    OBEY_POLLS = 5  # polls within which a drive shows that it obeys
    NO_STRIP = -1  # alarms: SDO asks the drive alone

    def __init__(
        self,
        link: CanLink,
        image: ProcessImage,
        sdo: SdoChannel,
        limits: Limits,
        *,
        node: Node,
        rest: Rest | None,
    ) -> None:
        """``node`` is the drive; ``rest`` is where its slide is known to be at rest."""
        self._link, self._image, self._sdo = link, image, sdo
        self._limits, self._windows, self._node, self._rest = limits, limits.windows, node, rest
        self._standstill = Standstill(limits.windows)
        self._ignored = 0  # polls of a drive that continues, though it was asked to stop
        self.by_sdo = node.state != NodeState.OPERATIONAL  # no PDO comes, SDO is asked
        self._began_s, self._polls = time.monotonic(), 0  # of asking by this means

    def leave_held(self) -> None:
        """Return when the drive has no power and the slide is at rest; raises `DeviceError`."""
        limit_s = self.RELEASE_S + 2 * self._windows.dwell_s
        deadline, had_power = Deadline(limit_s, self.SILENT_S), True
        while True:
            now = self._answer(deadline)
            powered = now.powered or now.state is State.UNKNOWN
            if had_power and not powered:
                had_power = False
                deadline = Deadline(limit_s, self.SILENT_S)  # as long to come to rest
            if powered:
                self._take_power(now)
            elif self._standstill.rest is not None or self._stands_as_before(now):
                return
            if deadline.expired():
                found = "the drive keeps its power" if powered else "the slide does not rest"
                raise RAIL.failed(
                    "HC-R37",
                    "close",
                    f"{found}: {now.state.value}, speed {self._limits.mm(now.velocity)}/s",
                    expected=f"held within {limit_s:.0f} s",
                    act="keep away from the slide; press the E-stop, or switch the drive off",
                    state=now.state.value,
                    waited_s=self.RELEASE_S,
                )
            time.sleep(self.POLL_S)

    def _stands_as_before(self, now: Snapshot) -> bool:
        """Whether a slide that was known to be at rest has not moved since."""
        windows, rest = self._windows, self._rest
        return (
            rest is not None
            and abs(now.velocity) <= windows.speed
            and abs(now.position - rest.position) <= windows.spread
        )

    def _take_power(self, now: Snapshot) -> None:
        windows, passed_s = self._windows, time.monotonic() - self._began_s
        # A busy PC polls seldom: until it has polled as often as rest needs, time shows nothing.
        # These polls fit into the deadline, however slow: a slide that creeps is always braked.
        restless = passed_s > 2 * windows.dwell_s and self._polls >= READINGS
        if self._standstill.rest is not None:
            self._control(Control.DISABLE_VOLTAGE)
        elif now.state in cia.BRAKING:
            self._ignored = 0
        elif not abs(now.velocity) <= windows.speed or restless:
            self._ignored += 1
            last = self._ignored > 2 * self.OBEY_POLLS
            self._control(Control.DISABLE_VOLTAGE if last else Control.QUICK_STOP)
            if self._ignored > self.OBEY_POLLS:
                self._stop_by_all_means()

    def _control(self, controlword: int) -> None:
        if self.by_sdo:
            try:
                self._sdo.command(Object.CONTROLWORD, 0, controlword)
            except DeviceError:
                self._link.check()
                return  # the next poll shows that the drive still has power
        elif controlword == Control.QUICK_STOP:
            self._image.quick_stop()
        else:
            self._image.control(controlword)

    def _stop_by_all_means(self) -> None:
        """Stop a drive that does not answer, or does not obey."""
        self._link.end_heartbeat()
        if self._node.state == NodeState.STOPPED:  # it serves no SDO there
            self._node.command(NodeCommand.ENTER_PRE_OPERATIONAL)
        self._sdo.post(Object.CONTROLWORD, 0, Control.QUICK_STOP)

    def _answer(self, deadline: Deadline) -> Snapshot:
        """Return the next poll that is answered; only the last one without an answer raises."""
        silent: DeviceError | None = None
        while True:
            over = deadline.expired()
            try:
                now = self._read_by_sdo() if self.by_sdo else self._image.refresh(ignore_stop)
            except DeviceError as error:
                self._link.check()  # a link that is lost brings no answer
                silent = silent or error
                if self.by_sdo:
                    self._stop_by_all_means()
                    if over:
                        raise RAIL.at(**silent.fields).failed(
                            silent.code,
                            "close",
                            silent.found,
                            expected="a drive that is confirmed held",
                            act="keep away from the slide, it may move: press the E-stop; then "
                            "check the drive's power and the bus",
                        ) from error
                self._ask(by_sdo=not self.by_sdo)
            else:
                self._standstill.add(now, time.monotonic() - self._began_s)
                self._polls += 1
                return now

    def _ask(self, *, by_sdo: bool) -> None:
        """Ask by SDO or by PDO: earlier polls no longer count."""
        self.by_sdo = by_sdo
        self._standstill.forget()
        self._began_s, self._polls = time.monotonic(), 0

    def _read_by_sdo(self) -> Snapshot:
        statusword, velocity, position = (
            self._sdo.read(index, tries=1)
            for index in (Object.STATUSWORD, Object.VELOCITY_ACTUAL, Object.POSITION_ACTUAL)
        )
        units = self._image.units
        return Snapshot.of(
            statusword,
            units.position(position),
            units.velocity(velocity),
            strip=0,
            alarms=self.NO_STRIP,
            taken_s=self._link.clock.pc_s(),
        )
