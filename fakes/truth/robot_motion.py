"""Motion in cell time: one axis along trapezoidal profiles, a robot with all its axes (PTP).

One axis has piecewise constant acceleration; a trapezoid that is too short for its speed is a
triangle. A robot moves from standstill to standstill: the controller's joints follow one trapezoid,
limited by the slowest axis. Each motion has joint errors: the side from which each joint arrives
and its repeatability error.
"""

from __future__ import annotations

import math
import threading
from bisect import bisect_right
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from fakes.time import CellTime
from fakes.truth.motion_record import MotionRecord, Travel
from fakes.truth.transforms import Array
from hilcell.cell.file import Cell


class Segment(NamedTuple):
    """Constant acceleration from ``start_s`` on; the last segment of a path is at rest."""

    start_s: float
    position: float
    velocity: float
    acceleration: float


class Path:
    """Segments one after another; the unit of length is the caller's."""

    def __init__(self, start_s: float, position: float, velocity: float = 0.0) -> None:
        self._segments = [Segment(start_s, position, velocity, 0.0)]
        self._starts_s = [start_s]

    @property
    def start_s(self) -> float:
        return self._starts_s[0]

    @property
    def end_s(self) -> float:
        return self._starts_s[-1]

    @property
    def end(self) -> float:
        return self._segments[-1].position

    @property
    def fastest(self) -> float:
        """Return the largest speed of all segments."""
        return max(abs(segment.velocity) for segment in self._segments)

    def brake(self, deceleration: float) -> Path:
        """Append braking to standstill."""
        velocity = self._segments[-1].velocity
        if velocity:
            sign = math.copysign(deceleration, -velocity)
            self._append(abs(velocity) / deceleration, sign, end_velocity=0.0)
        return self

    def travel(self, target: float, speed: float, acceleration: float) -> Path:
        """Append a trapezoid from standstill to ``target``."""
        distance = abs(target - self.end)
        if distance:
            sign = math.copysign(1.0, target - self.end)
            # Two roots: the product of a tiny distance and a small acceleration may be 0.
            peak = min(speed, math.sqrt(distance) * math.sqrt(acceleration))
            cruise_s = max(0.0, distance / peak - peak / acceleration)
            self._append(peak / acceleration, sign * acceleration, end_velocity=sign * peak)
            self._append(cruise_s, 0.0, end_velocity=sign * peak)
            self._append(peak / acceleration, -sign * acceleration, end_velocity=0.0)
            last = self._segments[-1]
            self._segments[-1] = Segment(last.start_s, target, 0.0, 0.0)
        return self

    def _append(self, duration_s: float, acceleration: float, end_velocity: float) -> None:
        last = self._segments[-1]
        self._segments[-1] = Segment(last.start_s, last.position, last.velocity, acceleration)
        end_s = last.start_s + duration_s
        end = last.position + (last.velocity + 0.5 * acceleration * duration_s) * duration_s
        self._segments.append(Segment(end_s, end, end_velocity, 0.0))
        self._starts_s.append(end_s)

    def at(self, now_s: float) -> tuple[float, float]:
        """Return position and velocity at ``now_s``; those of the start before it."""
        segment = self._segments[max(0, bisect_right(self._starts_s, now_s) - 1)]
        passed_s = max(0.0, now_s - segment.start_s)
        velocity = segment.velocity + segment.acceleration * passed_s
        return segment.position + 0.5 * (segment.velocity + velocity) * passed_s, velocity

    def positions(self, times_s: Array) -> Array:
        """Return the positions at times (N,)."""
        segments = np.array(self._segments)
        taken = np.searchsorted(self._starts_s, times_s, side="right").clip(1) - 1
        start_s, position, velocity, acceleration = segments[taken].T
        passed_s = np.maximum(0.0, times_s - start_s)
        then = velocity + acceleration * passed_s
        positions: Array = position + 0.5 * (velocity + then) * passed_s
        return positions

    def corners(self, after_s: float, until_s: float) -> list[float]:
        """Return the positions where segments began in ``after_s < t <= until_s``."""
        low = bisect_right(self._starts_s, after_s)
        high = bisect_right(self._starts_s, until_s)
        return [segment.position for segment in self._segments[low:high]]


Draw = Callable[[], Array]


class RobotState(NamedTuple):
    """The controller's joints (6,), the side of their last motion, their repeatability error."""

    joints_rad: Array
    side: Array
    landing: Draw  # lazy: drawn once, at the first use
    moving: bool

    @property
    def landing_rad(self) -> Array:
        """Repeatability error (6,)."""
        return self.landing()


class _Leg(NamedTuple):
    """Motion until the next leg begins."""

    start_s: float
    from_rad: Array
    to_rad: Array
    side: Array
    landing: Draw
    path: Path


class RobotMotion:
    """The motion of one robot; safe to use from several threads."""

    BRAKE_S = 0.15  # from full speed to standstill on a stop

    def __init__(self, cell: Cell, time: CellTime, landings: Callable[[str], Draw]) -> None:
        """``landings``: event -> function that draws the repeatability error (6,) in rad."""
        self._lock = threading.RLock()
        self._time, self._landings = time, landings
        self._speed_rad_s = np.radians([joint.speed_deg_s for joint in cell.robot.joint])
        self._from = self._to = np.radians(cell.robot.home_deg)
        self._side = np.ones(6)
        self._landing: Draw = cache(landings("power-on"))
        self._share = 1.0
        self._rate = 1.0  # shares a second at full speed
        self._override = 1.0
        self._path = Path(time.now_s(), 0.0)
        self._rest_state: RobotState | None = None
        self._legs: list[_Leg] = []
        self._recorders = 0
        self._record, self._recorded_s = MotionRecord(self._from), self._path.start_s
        self._add_leg()

    def move(self, target_rad: Array, speed_share: float) -> None:
        """Start for joints (6,) at a share 0..1 of full speed, from wherever the robot is."""
        not_moved_rad = 1e-9
        with self._lock:
            self._from = self._follow()
            self._to = np.array(target_rad, dtype=float)
            distance = self._to - self._from
            distance_rad = np.abs(distance)
            moved, sides = distance_rad > not_moved_rad, np.sign(distance)
            all_moved = all(moved.tolist())
            self._side = sides if all_moved else np.where(moved, sides, self._side)
            key = ",".join([f"{joint:.6f}" for joint in self._to.tolist()])
            draw, before = self._landings(key), self._landing
            self._landing = cache(draw)
            if not all_moved:  # joints that have not moved keep their error
                landing_rad = np.where(moved, draw(), before())
                self._landing = lambda: landing_rad
            duration_s = max((distance_rad / self._speed_rad_s).tolist())
            self._rate = 1.0 / max(duration_s, 1e-6)
            self._share = speed_share
            self._path = Path(self._time.now_s(), 0.0)
            self._continue()
            self._add_leg()

    def override(self, share: float) -> None:
        """Change the speed of this and all later motions; 0 stops them."""
        with self._lock:
            self._follow()
            self._override = share
            if self.moving:
                self._path = self._fresh_path().brake(self._rate / self.BRAKE_S)
                self._continue()
                self._add_leg()

    def brake(self) -> None:
        """Stop on the path and discard the target."""
        with self._lock:
            self._follow()
            self._path = self._fresh_path().brake(self._rate / self.BRAKE_S)
            self._share = 0.0
            self._add_leg()

    def poll(self) -> RobotState:
        """Return the state now; in stepped time each poll advances a motion by a third."""
        with self._lock:
            self._time.poll(self._path.start_s, self._path.end_s)
            return self.state()

    def record(self, on: bool) -> None:
        """Begin or end to record completed motions for `past`; calls are counted."""
        with self._lock:
            self._recorders += 1 if on else -1

    def travel(self) -> Travel:
        """Return the travel (6,) of the joints, in rad, since the last call; no time passes."""
        with self._lock:
            return self._record.take(self._follow())

    def past(self, times_s: Array) -> tuple[Array, Array, Array]:
        """Return joints, sides and repeatability errors, (N, 6) each, at times (N,) up to now.

        Exact since the start of the motion in which `record` began.
        """
        with self._lock:
            legs = list(self._legs)
        starts_s = [leg.start_s for leg in legs]
        taken = np.searchsorted(starts_s, times_s, side="right").clip(1) - 1
        shares = np.zeros((len(times_s), 1))
        for number in np.unique(taken):
            rows = taken == number
            shares[rows, 0] = legs[number].path.positions(times_s[rows]).clip(max=1.0)
        from_rad = np.array([leg.from_rad for leg in legs])[taken]
        to_rad = np.array([leg.to_rad for leg in legs])[taken]
        return (
            from_rad + shares * (to_rad - from_rad),
            np.array([leg.side for leg in legs])[taken],
            np.array([leg.landing() for leg in legs])[taken],
        )

    def state(self, at_s: float | None = None) -> RobotState:
        """Return the state now, or at a time just read; the same object at rest."""
        with self._lock:
            if self._rest_state is not None:
                return self._rest_state
            now_s = self._time.now_s() if at_s is None else at_s
            moving = self._moves(now_s)
            state = RobotState(self._joints(now_s), self._side, self._landing, moving)
            if not moving:
                self._rest_state = state
            return state

    def measured(self, cycle_s: float) -> tuple[Array, int]:
        """Return the joints (6,) at the last tick of a controller's cycle, and the tick's number.

        Ticks count from the motion's start, so a run does not depend on when it moves.
        """
        with self._lock:
            start_s = self._legs[-1].start_s
            # Times in steps of milliseconds meet the ticks; rounding must not choose between two.
            tick = int((self._time.now_s() - start_s) / cycle_s + 1e-6)
            return self.past(np.array([start_s + tick * cycle_s]))[0][0], tick

    @property
    def moving(self) -> bool:
        """Whether a motion is in progress, also while an override of 0 stops it."""
        return self._moves(self._time.now_s())

    @property
    def motion_ends_s(self) -> float:
        return self._path.end_s

    @property
    def axes_moving(self) -> bool:
        """Whether the joints really move."""
        return self._time.now_s() < self._path.end_s

    def _follow(self) -> Array:
        """Return the joints (6,) now, recorded; a path between two calls does not turn round."""
        now_s, path = self._time.now_s(), self._path
        joints_rad = self._joints(now_s)
        moving_s = min(now_s, path.end_s) - max(self._recorded_s, path.start_s)
        self._record.add(joints_rad, max(0.0, moving_s))
        self._recorded_s = now_s
        return joints_rad

    def _continue(self) -> None:
        speed = self._rate * self._share * self._override
        self._rest_state = None
        ramp_s = 0.4  # from standstill to full speed
        if speed > 0:
            self._path.travel(1.0, speed, self._rate / ramp_s)

    def _add_leg(self) -> None:
        leg = _Leg(self._time.now_s(), self._from, self._to, self._side, self._landing, self._path)
        if not self._recorders:
            self._legs.clear()
        self._legs.append(leg)
        self._record.begin(self._path.fastest * np.abs(self._to - self._from))

    def _moves(self, now_s: float) -> bool:
        overridden = self._share > 0 and self._path.end < 1.0
        return overridden or now_s < self._path.end_s

    def _fresh_path(self) -> Path:
        now_s = self._time.now_s()
        return Path(now_s, *self._path.at(now_s))

    def _joints(self, now_s: float) -> Array:
        if self._rest_state is not None:
            return self._rest_state.joints_rad
        share = self._path.at(now_s)[0]
        return self._from + share * (self._to - self._from) if share < 1 else self._to
