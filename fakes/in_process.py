"""A simulated cell inside the engine's own process: devices without wires, in event time.

Physics, noise, seed and the values of each device (counts of encoder and strip, joints) are those
of the simulated cell behind wires. The effects of wires are left out: late and split answers,
dither of the counts, faults, the controller's rounding of angles.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise

import numpy as np

from fakes.faults import Faults
from fakes.time import CellTime, CountedTime
from fakes.truth.cell_truth import CellTruth
from fakes.truth.machine import controller_arm
from fakes.truth.rail_truth import RailTruth
from fakes.truth.robot_motion import RobotMotion, RobotState
from fakes.truth.tracker_truth import Followed
from hilcell.cell.devices import load_entry
from hilcell.cell.file import Cell
from hilcell.ports import (
    Array,
    Clock,
    Identity,
    JointSample,
    LinkStatistics,
    NoReading,
    Rail,
    RailReading,
    Robot,
    RobotReading,
    StreamBlock,
    Tracker,
    TrackerReading,
)

ADDRESS = "in process"


class InProcessCell:
    """Devices and clock of one simulated cell, of the seeds of machine and run."""

    def __init__(self, cell: Cell, seed: int, run_seed: int | None = None) -> None:
        """Raises `SettingsError` for an impossible machine."""
        passing = CellTime()
        truth = CellTruth(cell, seed, passing, Faults(), run_seed)
        self.clock: Clock = EventClock(passing)
        self.rail: Rail = load_entry("rails", "none")(None, self.clock)
        if isinstance(truth.rail, RailTruth):
            self.rail = DirectRail(truth.rail, passing, self.clock, cell)
        self.robot: Robot = DirectRobot(truth.robot, passing, self.clock, cell)
        tracker = DirectTracker(truth, self.clock, cell)
        self.tracker: Tracker = tracker
        self._truth, self._tracker = truth, tracker

    def true_places(self, taken_s: Sequence[float]) -> tuple[Array, Array]:
        """Return true places (N, 3) at readings, and of the floor nests (M, 3), in {W}."""
        places = self._truth.places_in_world()
        nests_mm = [places[nest.name] for nest in self._truth.cell.layout.floor]
        return np.array([self._tracker.true_mm[at_s] for at_s in taken_s]), np.array(nests_mm)


class EventClock:
    """Satisfies `hilcell.ports.Clock`: waits return at once."""

    def __init__(self, passing: CellTime) -> None:
        self._time = passing
        self.pc_s = CountedTime().now_s

    def now_s(self) -> float:
        return self._time.now_s()

    def wait(self, duration_s: float) -> None:
        self._time.wait(duration_s)

    def check(self) -> None:
        """Do nothing: a study's run stops only with its process."""


class DirectRail:
    """Satisfies `hilcell.ports.Rail`."""

    COUNTS_PER_MM, STRIP_COUNTS_PER_MM = 1000.0, 100.0

    def __init__(self, truth: RailTruth, passing: CellTime, clock: Clock, cell: Cell) -> None:
        self._truth, self._time, self._clock = truth, passing, clock
        self._ramp = cell.rail.speed_mm_s, cell.rail.acceleration_mm_s2
        self._powered = False
        self._ended_s: float | None = None

    def connect(self) -> list[Identity]:
        kinds = (("Rail", "drive"), ("Strip", "strip"))
        return [Identity(name, "direct", "1", ADDRESS, True, kind) for name, kind in kinds]

    def home(self) -> None:
        self._power(on=True)
        homing_mm_s = 100.0
        self._truth.home(homing_mm_s)
        self._rest()

    def move_to(self, position_mm: float) -> None:
        self._power(on=True)
        self._truth.move(_counted(position_mm, self.COUNTS_PER_MM), *self._ramp)
        self._rest()

    def settle(self) -> RailReading:
        """Return the reading: the slide is at rest after each motion."""
        return self.read()

    def read(self) -> RailReading:
        state = self._truth.poll()
        return RailReading(
            _counted(state.encoder_mm, self.COUNTS_PER_MM),
            _counted(state.strip_mm, self.STRIP_COUNTS_PER_MM),
            state.velocity_mm_s,
            not state.moving,
            self._powered,
            self._clock.pc_s(),
            self._ended_s,
        )

    def hold(self) -> None:
        self._power(on=False)

    def statistics(self) -> LinkStatistics:
        return LinkStatistics()

    def stop(self) -> None:
        """Do nothing: nothing moves between two calls."""

    def close(self) -> None:
        self.hold()

    def _power(self, *, on: bool) -> None:
        self._powered = on
        self._truth.brake(closed=not on)

    def _rest(self) -> None:
        self._time.advance(max(0.0, self._truth.motion_ends_s - self._time.now_s()))
        self._truth.poll()
        self._ended_s = self._clock.pc_s()


class DirectRobot:
    """Satisfies `hilcell.ports.Robot` and `Sweeps`."""

    def __init__(self, motion: RobotMotion, passing: CellTime, clock: Clock, cell: Cell) -> None:
        self.motion, self.time, self._clock = motion, passing, clock
        self._arm = controller_arm(cell)
        self._full_rad_s = np.radians([joint.speed_deg_s for joint in cell.robot.joint])
        self._ended_s: float | None = None
        self._stated: tuple[RobotState | None, Array] = None, np.eye(4)  # the pose at rest

    def connect(self) -> list[Identity]:
        self.motion.brake()  # it stands
        return [Identity("Robot", self._arm.model, str(self._arm.serial), ADDRESS, True)]

    def move_to(self, joints_rad: Array, speed_percent: float) -> RobotReading:
        self.motion.move(joints_rad, speed_percent / 100.0)
        return self.rest()

    def rest(self) -> RobotReading:
        """Let the motion end; return the reading."""
        self.time.advance(max(0.0, self.motion.motion_ends_s - self.time.now_s()))
        self._ended_s = self._clock.pc_s()
        return self.read()

    def read(self) -> RobotReading:
        state = self.motion.state()
        if state is not self._stated[0]:
            self._stated = state, self._arm.chain.pose(state.joints_rad)
        pose = self._stated[1].copy()
        return RobotReading(
            state.joints_rad.copy(), pose, not state.moving, self._clock.pc_s(), self._ended_s
        )

    @contextmanager
    def sweep(self, axis: int, end_rad: float, speed_rad_s: float) -> Iterator[DirectSweep]:
        target_rad = self.motion.state().joints_rad.copy()
        target_rad[axis] = end_rad
        share = speed_rad_s / float(self._full_rad_s[axis])
        yield DirectSweep(self, target_rad, share, speed_rad_s)

    def stop(self) -> None:
        """Do nothing: nothing moves between two calls."""

    def close(self) -> None:
        """Do nothing."""


class DirectSweep:
    """Satisfies `hilcell.ports.Sweep`."""

    def __init__(
        self, robot: DirectRobot, target_rad: Array, share: float, speed_rad_s: float
    ) -> None:
        self._robot, self._target_rad, self._share = robot, target_rad, share
        self.speed_rad_s, self.ended = speed_rad_s, False

    def kickoff(self) -> None:
        self._robot.motion.move(self._target_rad, self._share)

    def collect(self) -> JointSample:
        state, now_s = self._robot.motion.state(), self._robot.time.now_s()
        self.ended = not state.moving
        return JointSample(state.joints_rad.copy(), now_s, now_s)

    def complete(self) -> RobotReading:
        return self._robot.rest()


class DirectTracker:
    """Satisfies `hilcell.ports.Tracker`, `Streams` and `TwoFaces`."""

    def __init__(self, truth: CellTruth, clock: Clock, cell: Cell) -> None:
        self._truth, self._clock, self._radius_mm = truth, clock, cell.tracker.find_radius_mm
        self.true_mm: dict[float, Array] = {}  # (3,) in {W} of the reflector, by the reading's time

    def connect(self) -> list[Identity]:
        return [Identity("Tracker", "direct", "1", ADDRESS, True)]

    def measure_back(self, near_mm: Array, reflector: str, samples: int) -> TrackerReading:
        """Measure in the second face; raises `NoReading` where there is none."""
        return self.measure(near_mm, reflector, samples, back=True)

    def measure(
        self, near_mm: Array, reflector: str, samples: int, *, back: bool = False
    ) -> TrackerReading:
        """Measure the reflector nearest to (3,); raises `NoReading` where there is none."""
        name = self._found(near_mm)
        found = self._truth.tracker.measurements(name, samples, back=back)
        if found is None:
            raise NoReading("HC-T10", "Tracker", "measure", "the beam broke")
        measure_s = 2.5
        for _ in range(samples):
            self._truth.time.advance(measure_s)
        xyz_mm, std_mm = found.xyz_mm[0], found.std_mm[0]
        if samples > 1:
            points_mm = found.xyz_mm
            # mean and sample deviation (3,) of readings (N, 3); numpy's take twice as long
            mean_mm = points_mm.sum(axis=0) / len(points_mm)
            off_mm = points_mm - mean_mm
            xyz_mm, std_mm = mean_mm, np.sqrt((off_mm * off_mm).sum(axis=0) / (len(points_mm) - 1))
        air, taken_s = self._truth.tracker.air(), self._clock.pc_s()
        self.true_mm[taken_s] = self._truth.reflectors_in_world()[name]
        return TrackerReading(xyz_mm, std_mm, samples, reflector, air, taken_s)

    @contextmanager
    def stream(self, near_mm: Array, reflector: str, rate_hz: float) -> Iterator[DirectStream]:
        followed = self._truth.streams.follow(self._found(near_mm))
        try:
            yield DirectStream(self._truth, followed, rate_hz)
        finally:
            followed.end()

    def stop(self) -> None:
        """Do nothing: nothing is measured between two calls."""

    def close(self) -> None:
        """Do nothing."""

    def _found(self, near_mm: Array) -> str:
        name = self._truth.tracker.find(np.asarray(near_mm, dtype=float), self._radius_mm)
        if name is None:
            raise NoReading("HC-T11", "Tracker", "find", "no reflector near its expected place")
        return name


class DirectStream:
    """Satisfies `hilcell.ports.Stream`. Samples are computed at the end, for the polls."""

    def __init__(self, truth: CellTruth, followed: Followed, rate_hz: float) -> None:
        self.rate_hz = rate_hz
        self._truth, self._followed = truth, followed
        self._looked_s: list[float] = []

    def kickoff(self) -> None:
        self._looked_s.append(self._truth.time.now_s())

    def collect(self) -> list[StreamBlock]:
        self._looked_s.append(self._truth.time.now_s())
        return []

    def complete(self) -> list[StreamBlock]:
        """Return all samples, in blocks by poll; raises `NoReading` at a broken beam."""
        self.collect()
        streams, step_s = self._truth.streams, 1.0 / self.rate_hz
        start_s = streams.device_s(self._looked_s[0])
        counts = [int((streams.device_s(at_s) - start_s) / step_s) for at_s in self._looked_s]
        device_s: Array = start_s + step_s * np.arange(1.0, counts[-1] + 1.0)
        xyz_mm = self._followed.read(device_s)
        if len(xyz_mm) < len(device_s):
            raise NoReading("HC-T10", "Tracker", "stream", "the beam broke")
        return [
            StreamBlock(device_s[first:last], xyz_mm[first:last], *window_s)
            for (first, last), window_s in zip(
                pairwise(counts), pairwise(self._looked_s), strict=True
            )
            if last > first
        ]


def _counted(value_mm: float, counts_per_mm: float) -> float:
    return round(value_mm * counts_per_mm) / counts_per_mm
