"""One axis of a Universal Robots arm turned slowly, with its joints read meanwhile.

The script takes the speed as it is wanted, times the speed slider at the panel: a slider that is
moved meanwhile ends the sweep.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Protocol, Self

import numpy as np

from drivers.motion_limits import MotionLimits
from drivers.robot_errors import DEVICE
from drivers.supervision import Patience
from drivers.universal_robots.health import LOST, STOPPED, Runtime
from drivers.universal_robots.link import UrLink
from drivers.universal_robots.state import UrState
from hilcell.ports import Array, Clock, DeviceError, JointSample, RobotReading, Stopped

SLOWEST_RAD_S = 1e-4
STALL_S = 5.0
PROGRESS_DEG = 0.002
REST_S = 3.0  # wire deadline: from a brake to standstill
STILL_RAD_S = 2e-3
POLL_S = 0.05  # while the end is waited for
SAME_SPEED = 1e-3


class SweepingRobot(Protocol):
    """The robot, as its sweep uses it."""

    def link(self) -> UrLink:
        """Return the connection by RTDE."""

    def look(self, states: Sequence[UrState]) -> None:
        """Raise an error where a state forbids to go on."""

    def stands_at(self) -> Array:
        """Return the joints (6,) in rad where the robot was last sent, or was found."""

    def command(self, target_rad: Array, speed_rad_s: float) -> int:
        """Start a motion; return its number."""

    def live(self) -> None:
        """Give a sign of life."""

    def acknowledged(self, number: int) -> bool:
        """Whether a motion has ended; raises the script's error."""

    def check_progress(self, limits: MotionLimits, number: int, state: UrState) -> None:
        """Raise an error where the motion gets nowhere."""

    def rest(self, target_rad: Array) -> RobotReading:
        """Wait until the robot stands at its target."""

    def unwatch(self) -> None:
        """Look at no motion any longer: it has ended, or is braked."""

    def brake(self, *, wanted: bool) -> None:
        """Brake, or take the brake back."""

    def braked(self, state: UrState) -> None:
        """Take note that a motion was braked, and where."""


class UrSweep:
    """Satisfies `hilcell.ports.Sweep`."""

    def __init__(
        self,
        robot: SweepingRobot,
        clock: Clock,
        axis: int,
        end_rad: float,
        speed_rad_s: float,
        full_rad_s: float,
    ) -> None:
        """``full_rad_s`` is the axis's speed at 100 %; NaN for an axis that there is not."""
        if not (np.isfinite(end_rad) and SLOWEST_RAD_S <= speed_rad_s <= full_rad_s):
            raise DeviceError(
                "HC-B28",
                DEVICE,
                "sweep",
                f"axis {axis + 1} to {end_rad} rad at {speed_rad_s} rad/s",
                wanted=f"{SLOWEST_RAD_S} to {full_rad_s:.3f} rad/s",
            )
        self.speed_rad_s, self.ended = speed_rad_s, False
        self._robot, self._clock = robot, clock
        self._axis, self._end_rad, self._wanted_rad_s = axis, end_rad, speed_rad_s
        self._target_rad = np.zeros(6)
        self._fraction = 1.0
        self._number, self._under_way = 0, False
        self._limits = MotionLimits(0.0, STALL_S, PROGRESS_DEG)

    def __enter__(self) -> Self:
        """Set the speed; nothing moves."""
        robot = self._robot
        state = robot.link().fresh()
        robot.look([state])
        self._fraction = state.speed_fraction
        self.speed_rad_s = self._wanted_rad_s * self._fraction
        self._target_rad = robot.stands_at().copy()
        planned_s = abs(self._end_rad - self._target_rad[self._axis]) / self._wanted_rad_s
        self._target_rad[self._axis] = self._end_rad
        self._limits = MotionLimits(float(planned_s), STALL_S, PROGRESS_DEG)
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Brake a motion under way."""
        self._robot.unwatch()
        if not self._under_way:
            return
        try:
            self._brake()
        except DeviceError as failure:
            if error is None:
                raise
            if not isinstance(error, Stopped):
                error.add_note(f"the brake was not confirmed: {failure}")

    def kickoff(self) -> None:
        """Start the motion; return when the controller has the order."""
        self._number = self._robot.command(self._target_rad, self._wanted_rad_s)
        self._under_way = True
        self._robot.link().fresh()

    def collect(self) -> JointSample:
        """Return the joints as they left the controller after this call began."""
        before_s = self._clock.now_s()
        self._robot.live()
        state = self._robot.link().fresh()
        after_s = self._clock.now_s()
        self._look(state)
        return JointSample(state.joints_rad, before_s, after_s, state.timestamp_s)

    def complete(self) -> RobotReading:
        """Wait for the end of the motion; return the reading at rest."""
        while not self.ended:
            self._clock.wait(POLL_S)
            self._robot.live()
            self._look(self._robot.link().fresh())
        reading = self._robot.rest(self._target_rad)
        self._under_way = False
        return reading

    def _look(self, state: UrState) -> None:
        if self.ended:
            return
        if self._robot.acknowledged(self._number):
            self.ended = True
            return
        self._robot.check_progress(self._limits, self._number, state)
        if not abs(state.speed_fraction - self._fraction) <= SAME_SPEED:
            raise DeviceError(
                "HC-B70",
                DEVICE,
                "sweep",
                f"target_speed_fraction is {state.speed_fraction:g}",
                wanted=f"{self._fraction:g}",
                act="the speed slider was moved during the sweep; sweep again",
                fields={"fraction": state.speed_fraction, "wanted_fraction": self._fraction},
            )

    def _brake(self) -> None:
        """Brake, and return at standstill; also while a stop is on."""
        robot, link = self._robot, self._robot.link()
        robot.brake(wanted=True)
        patience, over, begun_s = Patience(REST_S), False, time.monotonic()
        while True:
            state = link.fresh(patiently=True)
            done = state.acknowledged == self._number and state.error in (STOPPED, LOST)
            ended = state.runtime_state != Runtime.PLAYING or done
            if ended and bool(np.all(np.abs(state.speeds_rad_s) <= STILL_RAD_S)):
                break
            if over:
                raise DeviceError(
                    "HC-B71",
                    DEVICE,
                    "sweep",
                    f"not at rest {time.monotonic() - begun_s:.1f} s after the brake",
                    wanted=f"at rest within {REST_S:g} s",
                    act="see the panel, resume",
                )
            over = patience.over()
            robot.live()
        robot.brake(wanted=False)
        robot.braked(state)
