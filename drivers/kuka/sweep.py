"""One axis of a KUKA robot turned slowly, with its joints read meanwhile.

Speed is HC_VEL (1 to 100 % of an axis) times $OV_PRO, which a sweep lowers: so an axis turns at
1/10000 of its speed, too. $OV_PRO stays lowered when the PC dies. So the controller remembers its
old value (HC_OV_OLD) and the lowered one (HC_OV_SET); every way out of a sweep and every connect
give it back, at rest only, and only where nobody has changed it meanwhile.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from itertools import cycle
from typing import Protocol, Self

import numpy as np

from drivers.kuka.controller import PROGRESS, Access, Controller, integer
from drivers.kuka.health import AXES, HEALTH, LOST, STOPPED
from drivers.motion_limits import MotionLimits, planned_s
from drivers.robot_errors import DEVICE
from drivers.supervision import Patience
from hilcell.ports import (
    Array,
    Clock,
    DeviceError,
    HilcellError,
    JointSample,
    RobotReading,
    Stopped,
)

OVERRIDE, PERCENT = "$OV_PRO", 100
STALL_S = 5.0
PROGRESS_DEG = 0.002
REST_S = 3.0  # wire deadline: from a brake to standstill
DWELL_S = 0.05  # between two reads that prove standstill
STILL_DEG = 0.0005
POLL_S = 0.05  # while the end is waited for


class SweepingRobot(Protocol):
    """The robot, as its sweep uses it."""

    def wire(self) -> Controller:
        """Return the controller."""

    def check(self, *names: str) -> None:
        """Refuse to go on with a wrong state."""

    def stands_at(self) -> Array:
        """Return the joints (6,) in deg where the robot was last sent, or was found."""

    def command(self, target_deg: Array, speed_percent: int) -> int:
        """Start a motion; return its number."""

    def acknowledged(self, number: int) -> bool:
        """Whether a motion has ended; raises the program's error."""

    def check_round(self, names: tuple[str, ...], limits: MotionLimits, number: int) -> None:
        """Look whether all is well with a motion, by these variables."""

    def rest(self, target_deg: Array) -> RobotReading:
        """Wait until the robot stands at its target."""

    def unwatch(self) -> None:
        """Look at no motion any longer: it has ended, or is braked."""

    def take_back(self) -> None:
        """Take back a brake of our own."""


class KukaSweep:
    """Satisfies `hilcell.ports.Sweep`."""

    def __init__(
        self,
        robot: SweepingRobot,
        clock: Clock,
        axis: int,
        end_deg: float,
        speed_deg_s: float,
        full_deg_s: Array,
    ) -> None:
        """``full_deg_s`` (6,) are the axes' speeds at HC_VEL 100 and $OV_PRO 100."""
        if not (0 <= axis < len(AXES) and np.isfinite(end_deg)):
            raise DeviceError(
                "HC-B28",
                DEVICE,
                "sweep",
                f"axis {axis + 1} to {end_deg} deg",
                wanted="an axis of 1 to 6, a finite angle",
            )
        full = float(full_deg_s[axis])
        if not full / PERCENT**2 <= speed_deg_s <= full:
            raise DeviceError(
                "HC-B28",
                DEVICE,
                "sweep",
                f"{speed_deg_s} deg/s",
                wanted=f"{full / PERCENT**2:.4f} to {full:g} deg/s",
                fields={"speed_deg_s": speed_deg_s},
            )
        self.speed_rad_s, self.ended = float(np.radians(speed_deg_s)), False
        self._robot, self._clock = robot, clock
        self._axis, self._end_deg = axis, end_deg
        self._speed_deg_s, self._full_deg_s = speed_deg_s, full
        self._target_deg = np.zeros(6)
        self._velocity = self._override = PERCENT
        self._variable, self._number, self._under_way = PROGRESS, 0, False
        self._round: Iterator[tuple[str, ...]] = iter(())
        self._limits = MotionLimits(0.0, STALL_S, PROGRESS_DEG)

    def __enter__(self) -> Self:
        """Set the speed; nothing moves."""
        robot, controller = self._robot, self._robot.wire()
        controller.look()
        robot.check(*HEALTH, OVERRIDE)
        self._variable, self._round = controller.measured, cycle(controller.rounds)
        found = integer(controller, OVERRIDE)
        share = self._speed_deg_s / self._full_deg_s
        self._velocity, self._override = split_speed(share, found)
        self.speed_rad_s = float(
            np.radians(self._full_deg_s) * self._velocity * self._override / PERCENT**2
        )
        self._target_deg = robot.stands_at().copy()
        distance_deg = np.zeros(6)
        distance_deg[self._axis] = self._end_deg - self._target_deg[self._axis]
        self._target_deg[self._axis] = self._end_deg
        planned = planned_s(distance_deg, np.full(6, self._full_deg_s), self._velocity)
        self._limits = MotionLimits(planned, STALL_S, PROGRESS_DEG)
        if self._override != found:
            try:
                controller.lower_override(found, self._override)
            except BaseException as error:
                self._give_back(error)
                raise
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Brake a motion under way and give the override back."""
        self._give_back(error)

    def kickoff(self) -> None:
        """Start the motion."""
        self._under_way = True
        self._number = self._robot.command(self._target_deg, self._velocity)

    def collect(self) -> JointSample:
        """Ask for the joints once, and look whether all is well and the motion has ended."""
        controller, before_s = self._robot.wire(), self._clock.now_s()
        controller.look()
        joints_deg = controller.numbers(self._variable, AXES)
        after_s = self._clock.now_s()
        self._look()
        return JointSample(np.radians(joints_deg), before_s, after_s)

    def complete(self) -> RobotReading:
        """Wait for the end of the motion; return the reading at rest."""
        while not self.ended:
            self._clock.wait(POLL_S)
            self._look()
        reading = self._robot.rest(self._target_deg)
        self._under_way = False
        return reading

    def _look(self) -> None:
        if self.ended:
            return
        if self._robot.acknowledged(self._number):
            self.ended = True
            return
        names = next(self._round)
        self._robot.check_round(names, self._limits, self._number)
        if OVERRIDE not in names:
            return
        if (found := integer(self._robot.wire(), OVERRIDE)) != self._override:
            raise DeviceError(
                "HC-B40",
                DEVICE,
                "sweep",
                f"$OV_PRO is {found}",
                wanted=f"{self._override}",
                act="the override was changed at the panel during the sweep; sweep again",
                fields={"override": found, "wanted_override": self._override},
            )

    def _give_back(self, error: BaseException | None) -> None:
        """Leave the robot at rest with its override as it was."""
        self._robot.unwatch()
        try:
            with self._robot.wire().undisturbed() as access:
                if self._under_way:
                    access.brake()
                    await_rest(access)
                access.give_back_override()
            if self._under_way and not isinstance(error, Stopped):
                self._robot.take_back()
        except HilcellError as failure:  # a stop, too, would hide the error
            if error is None:
                raise
            error.add_note(f"not all was taken back: {failure}; the next connect does it")


def split_speed(share: float, override: int) -> tuple[int, int]:
    """Return HC_VEL and $OV_PRO whose product comes nearest to a share of full speed from below.

    The operator's ``override`` is never raised; of equal ones the highest is taken.
    """
    wanted = share * PERCENT**2 * (1.0 + 1e-9)
    pairs = [
        (velocity * lowered, lowered, velocity)
        for velocity in range(1, PERCENT + 1)
        if (lowered := min(override, int(wanted / velocity))) >= 1
    ]
    _, lowered, velocity = max(pairs)
    return velocity, lowered


def give_back_left_behind(access: Access) -> None:
    """Give back an override that a dead engine left lowered; its sweep is braked first."""
    if not access.lowered_override():
        return
    if integer(access, "HC_SEQ") != integer(access, "HC_ACK"):
        access.brake()
        await_rest(access)
    access.give_back_override()


def leave_at_rest(access: Access, joints: str, names: Sequence[str]) -> None:
    """Brake until all axes stand, by two looks; also while a stop is on.

    The stop is written again at each look: the one that waited for no answer may be lost.
    """
    patience, over = Patience(REST_S), False
    before, pause = np.full(len(names), np.inf), threading.Event()
    while not over:
        over = patience.over()
        access.brake()
        access.look()
        now = np.array(access.numbers(joints, tuple(names)))
        if bool(np.all(np.abs(now - before) <= STILL_DEG)):
            return
        before = now
        pause.wait(DWELL_S)
    raise _restless("close")


def await_rest(access: Access) -> None:
    """Wait until the program has taken the stop and no axis moves; also while a stop is on."""
    patience, over = Patience(REST_S), False
    before_deg, pause = np.full(6, np.inf), threading.Event()
    while not over:
        over = patience.over()
        access.look()
        now_deg = np.array(access.numbers(PROGRESS, AXES))
        stands = bool(np.all(np.abs(now_deg - before_deg) <= STILL_DEG))
        if stands and integer(access, "HC_ERR") in (STOPPED, LOST):
            return
        before_deg = now_deg
        pause.wait(DWELL_S)
    raise _restless("sweep")


def _restless(operation: str) -> DeviceError:
    return DeviceError(
        "HC-B41",
        DEVICE,
        operation,
        f"not at rest {REST_S:.0f} s after the brake",
        act="see the panel, resume",
        fields={"waited_s": REST_S},
    )
