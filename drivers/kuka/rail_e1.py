"""The rail whose drive is external axis E1 of its robot, with a strip on a wire of its own.

The robot's driver moves the slide; this driver adds readings of drive and strip together,
standstill over a dwell, and the travel. E1 is absolute, so ``home`` moves nothing: it requires that
the axis is mastered and that the strip agrees.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from drivers.device_errors import RAIL
from drivers.slide import (
    STRIP_SPREAD_MM,
    Poll,
    ScaleGuard,
    SlideMonitor,
    Windows,
    check_travel,
    strip_spread,
)
from drivers.strips import Positive, StripOptions, StripReader, strip_of
from drivers.supervision import on_failure
from hilcell.ports import (
    Clock,
    DeviceError,
    ExternalAxis,
    Identity,
    LinkStatistics,
    RailReading,
    RailTrace,
    StripLost,
)


class _Ended(Exception):
    """A jog is to be ended by a stop."""


class _Jog:
    """The rows of a jog, the first at its start."""

    def __init__(self, bound_mm: float, stop_after_mm: float) -> None:
        self._bound_mm, self._stop_after_mm = bound_mm, stop_after_mm
        self._rows: list[tuple[float, float, float, float]] = []
        self._stopped_by: Literal["", "bound", "stop"] = ""

    def add(self, taken_s: float, drive_mm: float, strip_mm: float, velocity_mm_s: float) -> None:
        self._rows.append((taken_s, drive_mm, strip_mm, velocity_mm_s))

    def judge(self) -> None:
        """Raise `_Ended` where drive or strip are beyond the bound, or far enough to stop."""
        (_, *start, _), (_, *now, _) = self._rows[0], self._rows[-1]
        moved_mm = [abs(b - a) for a, b in zip(start, now, strict=True)]
        if not max(moved_mm) <= self._bound_mm:
            self._stopped_by = "bound"
        elif moved_mm[0] >= self._stop_after_mm:
            self._stopped_by = "stop"
        if self._stopped_by:
            raise _Ended

    def trace(self) -> RailTrace:
        taken_s, drive_mm, strip_mm, velocity_mm_s = np.array(self._rows).T
        return RailTrace(taken_s, drive_mm, strip_mm, velocity_mm_s, self._stopped_by)


class KukaE1Rail:
    """Satisfies `hilcell.ports.Rail`, `hilcell.ports.RobotDrivenRail` and `hilcell.ports.Jogs`."""

    CYCLE_S = 0.012  # of the controller: within one the place does not change

    class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
        """The travel, the axis' speeds and the strip."""

        strip: StripOptions
        travel_min_mm: float
        travel_max_mm: float
        speed_mm_s: Positive
        full_mm_s: Positive = 1890.0  # of E1 at 100 %
        slip_limit_mm: Positive = 2.0
        standstill_speed_mm_s: Annotated[float, Meta(ge=0.01, le=5)] = 0.5
        standstill_window_mm: Annotated[float, Meta(ge=0.001, le=0.1)] = 0.01
        standstill_dwell_s: Annotated[float, Meta(ge=0.05, le=5)] = 0.4

        def __post_init__(self) -> None:
            if not self.travel_min_mm < self.travel_max_mm:
                raise ValueError("travel_min_mm must be below travel_max_mm")
            if not self.full_mm_s / 100.0 <= self.speed_mm_s <= self.full_mm_s:
                raise ValueError("speed_mm_s must be 1 to 100 % of full_mm_s")

    def __init__(self, options: Options, clock: Clock) -> None:
        self._options, self._clock = options, clock
        self._robot: ExternalAxis | None = None
        self._strip = StripReader(strip_of(options.strip, clock))
        per_mm = options.strip.scale
        windows = Windows(
            speed=options.standstill_speed_mm_s,
            spread=options.standstill_window_mm,
            strip_spread=strip_spread(per_mm),
            dwell_s=options.standstill_dwell_s,
        )
        self._slide = SlideMonitor(
            self._poll,
            clock,
            windows,
            units_per_mm=1.0,
            strip_counts_per_mm=per_mm,
            alarm_text=self._strip.alarm_text,
        )
        self._before: tuple[float, float] | None = None  # place, and the cell's time
        self._ended_s: float | None = None

    def attach_robot(self, robot: ExternalAxis) -> None:
        self._robot = robot

    # -- the port -----------------------------------------------------------------------------

    def connect(self) -> list[Identity]:
        """Verify the axis of the robot, which is connected, and open the strip; nothing moves."""
        self._forget()
        self._ended_s = None
        return [self._axis().verify_axis(), self._strip.connect()]

    def home(self) -> None:
        """Verify that the axis is mastered and that the strip agrees; nothing moves."""
        self._axis().verify_axis()
        reading, limit_mm = self.settle(), self._options.slip_limit_mm
        apart_mm = abs(reading.position_mm - reading.strip_mm)
        if not apart_mm <= limit_mm:
            raise RAIL.failed(
                "HC-R53",
                "home",
                f"E1 {reading.position_mm:.2f} mm and strip {reading.strip_mm:.2f} mm differ",
                expected=f"<= {limit_mm:.2f} mm apart",
                drive_mm=reading.position_mm,
                strip_mm=reading.strip_mm,
                limit_mm=limit_mm,
            )
        self._ended_s = reading.taken_s

    def move_to(self, position_mm: float) -> None:
        options, axis = self._options, self._axis()
        check_travel(position_mm, options.travel_min_mm, options.travel_max_mm)
        self._forget()
        self._ended_s = None
        guard = ScaleGuard(STRIP_SPREAD_MM, options.speed_mm_s, synchronous=False)

        def attend(drive_mm: float) -> None:
            strip, alarms = self._strip.poll(self._clock.check)
            if not alarms:
                guard.add(drive_mm, strip / options.strip.scale)
                guard.check("move to")

        with on_failure(self._stop_after_failure):
            axis.move_axis(position_mm, options.speed_mm_s, options.full_mm_s, attend)
        self._ended_s = self._clock.pc_s()

    def jog(
        self,
        distance_mm: float,
        *,
        bound_mm: float,
        speed_mm_s: float,
        stop_after_mm: float | None = None,
    ) -> RailTrace:
        """Jog E1, at whole percents of ``full_mm_s``: not slower than 1 %."""
        axis, full_mm_s = self._axis(), self._options.full_mm_s
        speed_mm_s = max(speed_mm_s, full_mm_s / 100.0)
        self._forget()
        self._ended_s = None
        self._strip.reconnect()
        trace = _Jog(bound_mm, np.inf if stop_after_mm is None else stop_after_mm)

        def attend(drive_mm: float, ordered_mm_s: float) -> None:
            now_s = self._clock.now_s()
            strip, alarms = self._strip.poll(self._clock.check)
            if alarms:  # the bound needs both
                found = f"strip sensor: {self._strip.alarm_text(alarms)}"
                raise StripLost("HC-S01", RAIL.name, "jog", found, fields={"alarms": alarms})
            trace.add(now_s, drive_mm, strip / self._options.strip.counts_per_mm, ordered_mm_s)

        def watch(drive_mm: float) -> None:
            attend(drive_mm, speed_mm_s)
            trace.judge()

        with on_failure(self._stop_after_failure):
            start_mm = axis.read_axis().position_mm
            attend(start_mm, 0.0)
            try:
                axis.move_axis(start_mm + distance_mm, speed_mm_s, full_mm_s, watch)
                attend(axis.read_axis().position_mm, 0.0)
            except _Ended:
                axis.brake_axis(lambda drive_mm: attend(drive_mm, 0.0))
            self.hold()
        self._ended_s = self._clock.pc_s()
        return trace.trace()

    def rescaled(self, drive: float, strip: float, speed: float) -> dict[str, object]:
        """Return the strip's scale and ``full_mm_s``; that of E1 is the controller's.

        Raises `DeviceRefused` where E1 itself does not move in mm of the strip.
        """
        if drive != 1.0:
            raise RAIL.refused(
                "HC-R53",
                "rescale",
                f"E1 counts {1.0 / drive:.4f} mm per mm",
                expected="1",
                act="correct scale and sign of E1 in the controller's machine data",
                factor=drive,
            )
        options = self._options
        head = msgspec.to_builtins(options.strip)
        head["counts_per_mm"] = options.strip.counts_per_mm / strip
        return {"strip": head, "full_mm_s": options.full_mm_s * speed}

    def settle(self) -> RailReading:
        """Return a reading at rest: medians of five in a row within the windows, over the dwell."""
        self._strip.reconnect()
        return self._slide.settle(self._ended_s)

    def read(self) -> RailReading:
        self._strip.reconnect()
        return self._slide.read(self._ended_s)

    def hold(self) -> None:
        """Have the controller refuse every motion of E1, verified by a reading."""
        self._axis().hold_axis()
        if not self._axis().read_axis().held:
            raise RAIL.failed(
                "HC-R37",
                "hold",
                "the controller does not hold E1: HC_HELD is FALSE",
                state="not held",
            )

    def statistics(self) -> LinkStatistics:
        """Return the counts of the strip's wire; the robot's has none."""
        return self._strip.statistics()

    def stop(self) -> None:
        if self._robot is not None:
            self._robot.stop()

    def close(self) -> None:
        """Close the strip's wire; the robot leaves the slide held."""
        self._strip.close()

    # -- inside -------------------------------------------------------------------------------

    def _axis(self) -> ExternalAxis:
        if self._robot is None:
            raise RAIL.failed("HC-R38", "use", "no robot to ride on")
        return self._robot

    def _forget(self) -> None:
        self._slide.standstill.forget()
        self._before = None

    def _poll(self, operation: str) -> Poll:
        """Poll axis and strip; the speed is that since the last poll."""
        self._clock.check()
        axis, now_s = self._axis().read_axis(), self._clock.now_s()
        strip, alarms = self._strip.poll(self._clock.check)
        before, self._before = self._before, (axis.position_mm, now_s)
        speed_mm_s = 0.0  # of the first poll; standstill needs several
        if before is not None:
            speed_mm_s = (axis.position_mm - before[0]) / max(now_s - before[1], self.CYCLE_S)
        return Poll(axis.position_mm, speed_mm_s, strip, alarms, not axis.held, axis.taken_s)

    def _stop_after_failure(self) -> None:
        with suppress(DeviceError):  # the first failure, which is being raised, is to be reported
            self.stop()
