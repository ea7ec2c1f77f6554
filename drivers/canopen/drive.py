"""The sequencer of a CiA 402 drive: power, homing, profile position; everything by PDO and SYNC.

canopen's BaseNode402 is not used: it drops the drive to "no mode" by its empty RPDO buffer,
re-enables it behind a fault reset, and takes bits left by the last motion for this one's. A planned
duration counts on the cell's clock (`drivers.supervision`), because a simulated cell may run faster
than real time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from drivers.canopen import cia
from drivers.canopen.cia import Bit, Control, Mode, Object, State
from drivers.canopen.drive_units import DriveUnits
from drivers.canopen.motion_guard import OVERSPEED, Limits, MotionGuard
from drivers.canopen.nodes import Homing
from drivers.canopen.process_image import NO_MODE, SYNCS, ProcessImage, Snapshot
from drivers.canopen.sdo import Aborted, SdoChannel, Unsupported
from drivers.device_errors import RAIL, Device
from drivers.slide import SlideMonitor, Standstill
from drivers.supervision import MotionLimits, Watchdog, polls
from hilcell.ports import Array, Clock, DeviceError


@dataclass(slots=True)
class Jog:
    """A small motion while scales, signs and units are not proved: its bound and its polls.

    Distances are mm by the options' scales. Whichever of drive and strip is further counts, and the
    fastest of their changes and 606Ch. So the quick stop goes out while the slide can still stop
    within the bound, also where one of the scales or the unit of speed is wrong.
    """

    LATE_S = 0.06  # from the sampling of a poll to the drive's quick stop

    distance_mm: float
    bound_mm: float
    speed_mm_s: float
    stop_after_mm: float | None
    limits: Limits
    polls: list[tuple[float, float, float, float]]  # time; drive, strip and its speed in mm

    def add(self, now: Snapshot, now_s: float) -> None:
        limits = self.limits
        self.polls.append(
            (
                now_s,
                now.position / limits.counts_per_mm,
                now.strip / limits.strip_counts_per_mm,
                now.velocity / limits.counts_per_mm,
            )
        )

    def stops_by(self) -> Literal["", "bound", "stop"]:
        """Return why the slide must stop now; "" where it may go on."""
        at = np.array([self.polls[0], *self.polls[-2:]], dtype=float)  # a jog has thousands
        gone_mm = np.abs(at[-1, 1:3] - at[0, 1:3])
        if self.stop_after_mm is not None and gone_mm[0] >= self.stop_after_mm:
            return "stop"
        passed_s = at[-1, 0] - at[-2, 0]
        steps_mm = np.abs(at[-1, 1:3] - at[-2, 1:3]) if passed_s > 0 else np.zeros(2)
        speed_mm_s = max(abs(at[-1, 3]), *(steps_mm / passed_s if passed_s > 0 else steps_mm))
        ramp_mm_s2 = self.limits.acceleration / self.limits.counts_per_mm
        braking_mm = speed_mm_s * self.LATE_S + speed_mm_s**2 / (2 * ramp_mm_s2)
        own_mm = min(braking_mm, max(0.0, abs(self.distance_mm) - float(gone_mm.max())))
        reach_mm = gone_mm.max() + (braking_mm if self._astray(gone_mm) else own_mm)
        return "" if reach_mm <= self.bound_mm else "bound"

    def _astray(self, gone_mm: Array) -> bool:
        """Whether drive and strip no longer confirm each other, so that the target is no limit."""
        apart_mm, slack_mm = abs(gone_mm[0] - gone_mm[1]), 0.5  # backlash, and the strip's delay
        return bool(not apart_mm <= slack_mm + 0.2 * gone_mm.max())


class Drive:
    """Drives one axis; used by one thread."""

    POLL_S = 0.02
    JOG_POLL_S = 0.005
    SLOWEST = 200.0  # a jog may take so many times as long as planned: its unit may be wrong
    STALL_S = 3.0  # wire deadline, beside the dwell: neither the expected state nor progress
    FULL_SPEED = 100.0  # percent: the drive has no override
    AT_SWITCH_MM = 25.0  # from the end of the travel with its slack: a limit there is that switch
    LEAVE_MM = 20.0  # a switch is left by then

    def __init__(
        self,
        image: ProcessImage,
        sdo: SdoChannel,
        clock: Clock,
        limits: Limits,
        watch: Callable[[str], None],
        watchdog: Watchdog,
        homing: Homing,
        alarm_text: Callable[[int], str] = cia.alarm_text,
    ) -> None:
        """``alarm_text`` is the strip's."""
        self._image, self._sdo, self._clock = image, sdo, clock
        self._limits, self._watch = limits, watch
        self._watchdog, self._homing, self._alarm_text = watchdog, homing, alarm_text
        self.slide = SlideMonitor(
            self._poll,
            clock,
            limits.windows,
            units_per_mm=limits.counts_per_mm,
            strip_counts_per_mm=limits.strip_counts_per_mm,
            alarm_text=alarm_text,
        )
        self._guards: MotionGuard  # of the motion that was prepared last
        self._old_error = False  # of the homing before: it is reset when the drive obeys
        self._left_limit: int | None = None  # position on a limit switch
        self._mode, self._unanswered = NO_MODE, 0  # by SDO, and questions in a row without answer

    @property
    def units(self) -> DriveUnits:
        return self._image.units

    def _poll(self, operation: str) -> Snapshot:
        """Return a snapshot; raises `DeviceError` for a fault, an alarm or a lost node."""

        def look() -> None:
            self._clock.check()
            self._watchdog.check()
            self._watch(operation)

        look()
        now = self._image.refresh(look)
        if not self._image.shows_mode:
            now = replace(now, mode=self._mode_by_sdo())
        self._watchdog.feed()
        look()
        if now.state in (State.FAULT, State.FAULT_REACTION, State.UNKNOWN):
            self._image.control(Control.QUICK_STOP)  # before the drive is asked why
            raise self._fault(operation, f"drive in {now.state.value}", now.state)
        return now

    def _mode_by_sdo(self) -> int:
        """6061h; as with a PDO, only several lost answers in a row end a motion."""
        try:
            self._mode, self._unanswered = self._sdo.read(Object.MODE_DISPLAY, tries=1), 0
        except Aborted:
            raise
        except DeviceError:
            self._unanswered += 1
            if self._unanswered >= SYNCS:
                raise
        return self._mode

    def _fault(self, operation: str, found: str, state: State) -> DeviceError:
        """Return the error of a drive in fault, also of one that names no error."""
        try:
            code = self._sdo.read(Object.ERROR_CODE, tries=1)
        except DeviceError as silent:
            code, text = 0, f"its error (603Fh) is unknown: {silent.found}"
        else:
            text = f"error {cia.error_text(code)}"
        return RAIL.failed(
            cia.error_alarm(code),
            operation,
            f"{found}, {text}",
            act="put the cause right, then resume",
            state=state.value,
            error_code=code,
        )

    def reset_fault(self) -> None:
        """Reset a fault and stop at SWITCH ON DISABLED; nothing is enabled."""
        operation = "reset fault"
        if self._image.refresh(self._clock.check).state is not State.FAULT:
            return
        self._image.control(Control.DISABLE_VOLTAGE)
        self._image.control(Control.FAULT_RESET)  # the rising edge resets
        for last in polls(self.STALL_S):
            if self._image.refresh(self._clock.check).state is not State.FAULT:
                break
            if last:
                raise self._fault(operation, "drive stays in fault", State.FAULT)
            self._clock.wait(self.POLL_S)
        self._image.control(Control.DISABLE_VOLTAGE)

    def disable(self, operation: str = "hold") -> None:
        """Take the power away; the brake closes. A moving slide is stopped on its ramp first."""
        if not self.slide.poll(operation).powered:
            return
        now = self.slide.confirm(operation)
        if now.powered and self.slide.rest is None:
            self._image.control(Control.QUICK_STOP)  # a stop would be for good
            ramp_s = self._limits.ramp_s
            now = self._until(operation, "standstill", lambda _: True, ramp_s, at_rest=True)
        if not now.powered:
            return
        quick = now.state is State.QUICK_STOP_ACTIVE
        self._image.control(Control.DISABLE_VOLTAGE if quick else Control.SHUTDOWN)
        self._until(operation, "drive without power", lambda s: not s.powered)

    def home(self, tolerance: int) -> None:
        """Home by a motion, by the method set in 6098h; raises `DeviceError`."""
        self._check_homed(self._run_homing(), self._homing.counts, tolerance)

    def set_reference(self, counts: int, tolerance: int) -> None:
        """Let the position be ``counts`` where the slide is, without a motion; raises
        `DeviceError`.

        Makers differ in the sign of 607Ch: the position of the reference, or what is added to it to
        find the zero (CiA 402-2). The position that follows decides.
        """
        here = self._image.units.position(counts)
        for offset in (here, -here):
            self._sdo.require(self._homing.offset, 0, offset, "the position is the strip's")
            now = self._run_homing(moves=False)
            if abs(now.position - counts) <= tolerance:
                return
        self._check_homed(now, counts, tolerance)

    def _run_homing(self, *, moves: bool = True) -> Snapshot:
        """Return the poll at its end. Without a motion bit 12 cannot show when it has begun."""
        operation = "home"
        before = self._prepare(operation, Mode.HOMING)
        self._old_error = before.has(Bit.MODE_ERROR)
        until = partial(self._until, operation, moving=True)
        self.slide.standstill.forget()
        with self._watchdog.motion():
            self._image.control(Control.START)
            if moves:
                until("homing started", lambda now: self._homes(before, now))
            expected, attained = (
                "homing attained at standstill",
                Bit.ACKNOWLEDGED | Bit.TARGET_REACHED,
            )
            now = until(expected, lambda s: s.has(attained), self._limits.homing_s, at_rest=True)
        self._image.control(Control.ENABLE_OPERATION)
        return now

    def _check_homed(self, now: Snapshot, counts: int, tolerance: int) -> None:
        if not abs(now.position - counts) <= tolerance:
            raise RAIL.failed(
                "HC-R35",
                "home",
                f"the drive stands at {self._limits.mm(now.position)}",
                expected=f"{self._limits.mm(counts)} +-{self._limits.mm(tolerance)}",
                position_mm=now.position / self._limits.counts_per_mm,
                tolerance_mm=tolerance / self._limits.counts_per_mm,
            )

    def move(self, target: int) -> None:
        """Go to ``target`` counts in profile position; return at standstill, still enabled."""
        operation = f"move to {self._limits.mm(target)}"
        before = self._prepare(operation, Mode.PROFILE_POSITION)
        self._check_limit(operation, before, target)
        until = partial(self._until, operation, moving=True)
        self._image.control(Control.ENABLE_OPERATION, target)
        until("last set-point released", lambda s: not s.has(Bit.ACKNOWLEDGED))
        self.slide.standstill.forget()
        with self._watchdog.motion():
            self._image.control(Control.START, target)
            until("set-point acknowledged", lambda s: s.has(Bit.ACKNOWLEDGED))
            self._image.control(Control.ENABLE_OPERATION, target)
            expected = f"target reached at {self._limits.mm(target)}, at standstill"
            planned_s = self._limits.travel_s(target - before.position)
            until(expected, lambda now: self._arrived(now, target), planned_s, at_rest=True)

    def jog(self, jog: Jog) -> Literal["", "bound", "stop"]:
        """Make a small motion; return at rest without power, and what has stopped it.

        Only positions show rest and progress: the unit of 606Ch may be wrong. Raises `DeviceError`.
        """
        limits, units = self._limits, self._image.units
        distance = round(jog.distance_mm * limits.counts_per_mm)
        operation = f"jog by {jog.distance_mm:+.3f} mm"
        self.slide.check_strip(operation, self.slide.confirm(operation))
        usual = units.of_speed(limits.speed)
        slow = min(usual, units.of_speed(jog.speed_mm_s * limits.counts_per_mm))
        self._sdo.write(Object.PROFILE_VELOCITY, 0, slow)
        before = self._prepare(operation, Mode.PROFILE_POSITION)
        self._check_limit(operation, before, before.position + distance)
        with self._watchdog.motion():
            stopped_by = self._run_jog(operation, jog, before.position + distance)
        word = Control.DISABLE_VOLTAGE if stopped_by else Control.SHUTDOWN
        self._image.control(word)
        self._until(operation, "drive without power", lambda s: not s.powered)
        self._sdo.write(Object.PROFILE_VELOCITY, 0, usual)
        return stopped_by

    def _run_jog(self, operation: str, jog: Jog, target: int) -> Literal["", "bound", "stop"]:
        limits = self._limits
        stopped_by: Literal["", "bound", "stop"] = ""
        self._image.control(Control.ENABLE_OPERATION, target)
        self._until(operation, "last set-point released", lambda s: not s.has(Bit.ACKNOWLEDGED))
        planned_s = self.SLOWEST * abs(jog.distance_mm) / jog.speed_mm_s
        bounds = MotionLimits(planned_s, self.STALL_S + limits.windows.dwell_s, limits.window)
        at_rest = Standstill(replace(limits.windows, speed=math.inf))
        acknowledged = arrived = False
        now = self.slide.poll(operation)
        jog.add(now, self.slide.now_s)
        self._image.control(Control.START, target)
        while True:
            self._clock.wait(self.POLL_S if arrived else self.JOG_POLL_S)
            now = self.slide.poll(operation)
            jog.add(now, self.slide.now_s)
            at_rest.add(now, self.slide.now_s)
            if not stopped_by:
                self._check_jog(operation, now)
                stopped_by = jog.stops_by()
            if stopped_by and now.state is State.ENABLED:
                self._image.control(Control.QUICK_STOP)
            elif not acknowledged and now.has(Bit.ACKNOWLEDGED):
                acknowledged = True
                self._image.control(Control.ENABLE_OPERATION, target)
            arrived = acknowledged and self._arrived(now, target)
            if at_rest.rest is not None and (arrived or now.state is not State.ENABLED):
                return stopped_by
            stalled = bounds.stalled(np.array([now.position], dtype=float))
            if stalled or bounds.overdue(self.slide.now_s, self.FULL_SPEED):
                raise self._at(now).failed(
                    "HC-R31" if stalled else "HC-R28",
                    operation,
                    f"not done after {bounds.spent_s:.0f} s at {self._state_text(now)}",
                    expected=f"{limits.mm(target)}, at rest",
                    spent_s=bounds.spent_s,
                )

    def _check_jog(self, operation: str, now: Snapshot) -> None:
        where, code, found = self._limits.mm(now.position), "", ""
        if now.alarms:
            code, found = "HC-S01", f"strip sensor: {self._alarm_text(now.alarms)} at {where}"
        elif now.state is not State.ENABLED:
            code, found = "HC-R30", f"drive left operation enabled: {now.state.value}"
        elif now.has(Bit.MODE_ERROR):
            code, found = "HC-R26", f"following error at {where}"
        elif self._at_switch(now):
            code, found = "HC-R32", f"limit active at {where}"
        if found:
            raise self._at(now).failed(code, operation, found)

    def _homes(self, before: Snapshot, now: Snapshot) -> bool:
        """Whether homing has begun, or has ended already within one poll. Bit 12 "homing attained"
        may still be set from an earlier homing: it must be reset, or the position must change.
        """
        stale = before.has(Bit.ACKNOWLEDGED) and now.has(Bit.ACKNOWLEDGED)
        return not stale or abs(now.position - before.position) > self._limits.window

    def _arrived(self, now: Snapshot, target: int) -> bool:
        """Whether the slide is at the target; bit 10 may be of the last motion, or wrong."""
        reached = now.has(Bit.TARGET_REACHED) and not now.has(Bit.ACKNOWLEDGED)
        return reached and abs(now.position - target) <= self._limits.window

    # -- steps --------------------------------------------------------------------------------

    def _prepare(self, operation: str, mode: Mode) -> Snapshot:
        """Set the mode and go up to OPERATION ENABLED, one acknowledged transition at a time."""
        self._image.check_not_stopped()
        now = self.slide.poll(operation)
        if now.mode != mode:
            self._set_mode(mode)
        while (now := self.slide.poll(operation)).state is not State.ENABLED:
            word = cia.next_control(now.state)
            if word is not None:
                self._image.control(word, now.position)
            self._until(operation, f"drive to leave {now.state.value!r}", _left(now.state))
        now = self._until(operation, f"mode {mode}", lambda s: s.mode == mode)
        self._guards = MotionGuard(self._limits, now, self.slide.now_s)
        self._left_limit = None
        return now

    def _set_mode(self, mode: Mode) -> None:
        """Ask for a mode; 6061h shows whether the drive has it, for 6060h may be write only."""
        try:
            self._sdo.command(Object.MODES_OF_OPERATION, 0, mode)
        except Aborted as refusal:
            name = mode.name.lower().replace("_", " ")
            raise Unsupported(refusal, f"6060h = {mode} ({name})") from refusal

    def _until(
        self,
        operation: str,
        expected: str,
        done: Callable[[Snapshot], bool],
        planned_s: float = 0.0,
        *,
        moving: bool = False,
        at_rest: bool = False,
    ) -> Snapshot:
        """Poll by SYNC until ``done``; raises where neither that nor progress comes in time.
        ``planned_s``, in cell time, bounds a motion that makes progress.
        """
        stall_s = self.STALL_S + self._limits.windows.dwell_s * at_rest
        limits = MotionLimits(planned_s, stall_s, self._limits.window)
        while True:
            now = self.slide.poll(operation)
            if moving:
                self._check_motion(operation, now)
            stands = self.slide.rest is not None or not at_rest
            if stands and done(now):
                return now
            if limits.stalled(np.array([now.position], dtype=float)):
                if done(now):
                    raise self._restless(operation, stall_s)
                if moving and self._old_error:
                    self._old_error = False
                    self._check_motion(operation, now)
                cause, act = _cause(now, moving=moving)
                found = f"no progress for {stall_s:.0f} s at {self._state_text(now)}{cause}"
                raise self._at(now).failed(
                    "HC-R31", operation, found, expected=expected, act=act, waited_s=stall_s
                )
            if limits.overdue(self.slide.now_s, self.FULL_SPEED):
                raise self._at(now).failed(
                    "HC-R28",
                    operation,
                    f"not done after {limits.spent_s:.0f} s at {self._state_text(now)}",
                    expected=f"{expected} within {limits.limit_s:.0f} s",
                    spent_s=limits.spent_s,
                    limit_s=limits.limit_s,
                )
            if moving and not done(now):
                self._clock.wait(self.POLL_S)  # also at its start, while it seems still
            else:
                self.slide.pause()

    def _restless(self, operation: str, waited_s: float) -> DeviceError:
        limits, windows = self._limits, self._limits.windows
        speed, spread, strip_spread = self.slide.standstill.spreads
        return RAIL.failed(
            "HC-R43",
            operation,
            f"the slide does not come to rest: speed {limits.mm(speed)}/s, "
            f"drive within {limits.mm(spread)}, strip within {strip_spread} counts",
            expected=f"<= {limits.mm(windows.speed)}/s, {limits.mm(windows.spread)} and "
            f"{windows.strip_spread} counts for {windows.dwell_s:.2f} s, within {waited_s:.0f} s",
            act="check the slide for creep and the servo for hunting; where both are well, widen "
            "rail.options standstill_speed_mm_s or standstill_window_mm; then resume",
            speed_mm_s=speed / limits.counts_per_mm,
            spread_mm=spread / limits.counts_per_mm,
            strip_spread_counts=strip_spread,
            waited_s=waited_s,
        )

    def _check_motion(self, operation: str, now: Snapshot) -> None:
        limits, code, found = self._limits, "", ""
        self._guards.add(now, self.slide.now_s)
        self._old_error = self._old_error and now.has(Bit.MODE_ERROR)
        where = limits.mm(now.position)
        if now.state is not State.ENABLED:
            code, found = "HC-R30", f"drive left operation enabled: {now.state.value}"
        elif now.mode == Mode.HOMING and now.has(Bit.MODE_ERROR) and not self._old_error:
            code, found = "HC-R35", f"homing error of method {self._homing.method} (6098h)"
        elif now.mode != Mode.HOMING and now.has(Bit.MODE_ERROR):
            code, found = "HC-R26", f"following error at {where}"
        elif now.mode != Mode.HOMING and self._at_switch(now):
            code, found = "HC-R32", f"limit active at {where}"
        elif not abs(now.velocity) <= OVERSPEED * limits.speed:
            allowed = limits.mm(OVERSPEED * limits.speed)
            code, found = "HC-R33", f"speed {limits.mm(now.velocity)}/s, allowed {allowed}/s"
        elif now.mode != Mode.HOMING and not limits.lowest <= now.position <= limits.highest:
            beyond = f"{limits.mm(limits.lowest)} .. {limits.mm(limits.highest)}"
            code, found = "HC-R34", f"{where} is beyond {beyond}"
        if code in ("", "HC-R33"):
            self._guards.check_unit(operation, now)
        if found:
            raise self._at(now).failed(code, operation, found)
        self._guards.check(operation, now)

    def _check_limit(self, operation: str, before: Snapshot, target: int) -> None:
        """Refuse a motion towards the limit switch on which the slide is.

        Homing to a switch ends on it. Status bit 11 does not distinguish the switches: 60FDh does,
        and without it the end of the travel at which the slide is.
        """
        if not before.has(Bit.INTERNAL_LIMIT):
            return
        gap = target - before.position
        if abs(gap) > self._limits.window and not gap * self._side(before) < 0:
            found = f"limit active at {self._limits.mm(before.position)}"
            expected = "a motion away from the limit switch"
            raise self._at(before).failed("HC-R32", operation, found, expected=expected)
        self._left_limit = before.position

    def _side(self, now: Snapshot) -> int:
        """Return the limit switch on which the slide is: -1, 1, or 0 where that is unknown."""
        inputs = self._sdo.read_if_present(Object.DIGITAL_INPUTS) or 0
        side = self._image.units.sense * {1: -1, 2: 1}.get(inputs & cia.LIMIT_SWITCHES, 0)
        near, limits = self.AT_SWITCH_MM * self._limits.counts_per_mm, self._limits
        if now.position <= limits.lowest + near:
            return side or -1
        return side or int(now.position >= limits.highest - near)

    def _at_switch(self, now: Snapshot) -> bool:
        """Whether the slide is at a limit switch other than the one that it leaves. Status bit 11
        may also be a limit of current or speed: 60FDh shows whether it is a switch.
        """
        if not now.has(Bit.INTERNAL_LIMIT):
            return False
        left = self._left_limit
        if (
            left is not None
            and abs(now.position - left) <= self.LEAVE_MM * self._limits.counts_per_mm
        ):
            return False
        inputs = self._sdo.read_if_present(Object.DIGITAL_INPUTS, tries=1)
        return inputs is None or inputs & cia.LIMIT_SWITCHES != 0

    def _at(self, now: Snapshot) -> Device:
        scale = self._limits.counts_per_mm
        return RAIL.at(
            position_mm=now.position / scale,
            speed_mm_s=now.velocity / scale,
            state=now.state.value,
            statusword=now.statusword,
            mode=now.mode,
        )

    def _state_text(self, now: Snapshot) -> str:
        return (
            f"{self._limits.mm(now.position)}, {self._limits.mm(now.velocity)}/s, "
            f"{now.state.value}, statusword 0x{now.statusword:04X}, mode {now.mode}"
        )


def _cause(now: Snapshot, *, moving: bool) -> tuple[str, str]:
    """Why a drive does not move on, by its status word, and what to do."""
    if moving:
        return "", "check the slide for an obstacle and the drive, then resume"
    if not now.has(Bit.VOLTAGE_ENABLED):
        return (
            "; its power stage has no voltage (status bit 4)",
            "switch the mains on, release the safe torque off, then resume",
        )
    if not now.has(Bit.REMOTE):
        return (
            "; it does not obey the bus (status bit 9)",
            "end the drive's local mode, at its panel or in its own program, then resume",
        )
    return "", "check the drive, and the bus for lost frames, then resume"


def _left(state: State) -> Callable[[Snapshot], bool]:
    return lambda snapshot: snapshot.state is not state
