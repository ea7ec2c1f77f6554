"""Targets of a robot that `fit` corrects: poses of its tool, or joints, and what is commanded.

Poses are those of the tool point in the robot's root frame, under the header of `compensate`;
joints stand under ``name,j1_deg,...,j6_deg``. A controller is taken to know the nominal arm: joints
for a pose, and the pose of joints, are the nominal arm's.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from hilcell.compensation import targets
from hilcell.geometry.frames import inverse, poses_from_zyx
from hilcell.geometry.inverse import refined
from hilcell.geometry.kinematics import Arm, Array, Bools, forward
from hilcell.ports import HilcellError

JOINT_HEADER = ["name", *(f"j{n}_deg" for n in range(1, 7))]
MOST_KNOWN = 500  # measured poses that are searched from
STARTS = 8  # measured poses from which one is searched
NAMED = 5


class TargetError(HilcellError):
    """Targets that cannot be corrected."""

    code = "HC-C10"


@dataclass(frozen=True, eq=False)
class Found:
    """Joints (N, 6) for N poses, which of them were found (N,), and which in several postures."""

    joints_rad: Array
    found: Bools
    several: Bools


@dataclass(frozen=True, eq=False)
class Reach:
    """Poses and joints of a nominal arm with a tool: its base in the root, measured joints.

    ``known_rad`` (M, 6) are joints that were measured: a pose takes the posture of the nearest.
    ``limits_rad`` (2, 6).
    """

    arm: Arm
    base: Array
    known_rad: Array
    limits_rad: Array

    def poses(self, joints_rad: Array) -> Array:
        """Return the tool's frames in the root (N, 4, 4)."""
        return self.base @ forward(self.arm, joints_rad)

    def joints(self, poses: Array, names: Sequence[str]) -> Array:
        """Return nominal joints (N, 6) for poses in the root, in the posture that was measured.

        Raises `TargetError` where none is found, and where several postures were measured.
        """
        if not self._one_posture:
            raise TargetError(
                "the measured poses have several postures (elbow, wrist), and a pose does not say "
                "which the robot takes there; give joints"
            )
        joints, lost = np.empty((len(poses), 6)), np.zeros(len(poses), dtype=bool)
        at_once = 512  # poses of one search
        for first in range(0, len(poses), at_once):
            part = slice(first, first + at_once)
            found = self._searched(poses[part], enough=1)
            joints[part], lost[part] = found.joints_rad, ~found.found
        refuse(
            lost, names, "poses are not reached in the posture of measured ones",
            "check frame, tool and units, or give joints",
        )  # fmt: skip
        return joints

    def near(self, poses: Array, joints_rad: Array, names: Sequence[str]) -> Array:
        """Return nominal joints (N, 6) for poses a correction away from joints (N, 6).

        Raises `TargetError` where a joint turns far or leaves its limits.
        """
        found, arrived = refined(self.arm, inverse(self.base) @ poses, joints_rad)
        # of a joint by a correction: beyond, the wrist is singular there
        most_turn_rad = np.radians(5.0)
        near = arrived & (np.abs(found - joints_rad).max(axis=1) <= most_turn_rad)
        refuse(
            ~near, names,
            f"corrections turn a joint by more than {np.degrees(most_turn_rad):g} deg",
            "arm or wrist are singular there; give poses",
        )  # fmt: skip
        inside = (found >= self.limits_rad[0]) & (found <= self.limits_rad[1])
        refuse(
            ~inside.all(axis=1), names, "corrected targets leave the joints' limits",
            "move them away from the limits",
        )  # fmt: skip
        return found

    @cached_property
    def _one_posture(self) -> bool:
        """Return whether the measured poses are reached in no other measured posture."""
        return not self._searched(self.poses(self.known_rad), enough=STARTS).several.any()

    def _searched(self, poses: Array, enough: int) -> Found:
        """Search from the nearest measured poses in turn, until ``enough`` of them lead there."""
        wanted = inverse(self.base) @ poses
        joints, count = np.zeros((len(poses), 6)), np.zeros(len(poses), dtype=int)
        several = np.zeros(len(poses), dtype=bool)
        same_posture_rad = np.pi / 2  # of a joint: another posture turns one further
        other_rad = 0.01  # of a joint: two postures, not two roundings of one
        for start in np.swapaxes(self._nearest(poses), 0, 1):
            left = np.flatnonzero(count < enough)
            found, arrived = refined(self.arm, wanted[left], start[left])
            good = arrived & (np.abs(found - start[left]).max(axis=1) <= same_posture_rad)
            at, found = left[good], found[good]
            other = (
                np.abs(np.pi - np.mod(np.pi - (found - joints[at]), 2.0 * np.pi)).max(axis=1)
                > other_rad
            )
            several[at] |= other & (count[at] > 0)
            joints[at] = np.where(count[at, None] > 0, joints[at], found)
            count[at] += 1
        return Found(joints, count > 0, several)

    def _nearest(self, poses: Array) -> Array:
        """Return the joints (N, S, 6) of the `STARTS` measured poses that are nearest."""
        known = self.poses(self.known_rad)
        shift = poses[:, None, :3, 3] - known[:, :3, 3]
        # |A - B| of rotations is 2 sqrt 2 times the sine of half the angle between them.
        turn_mm = 300.0  # what a radian counts in the search of the nearest measured pose
        turn = (poses[:, None, :3, :3] - known[:, :3, :3]) * turn_mm / np.sqrt(2.0)
        distance = np.sum(shift**2, axis=-1) + np.sum(turn**2, axis=(-2, -1))
        return self.known_rad[np.argsort(distance, axis=1)[:, :STARTS]]


@dataclass(frozen=True, eq=False)
class RobotTargets:
    """N targets: poses (N, 4, 4) of the tool in the root, and nominal joints (N, 6) for them."""

    names: list[str]
    poses: Array
    joints_rad: Array

    def corrected(self, error_mm: Array) -> Array:
        """Return the poses (N, 4, 4) to command where errors (N, 3) are expected in the root."""
        command = self.poses.copy()
        command[:, :3, 3] -= error_mm
        return command


def targets_of(names: list[str], values: Array, reach: Reach) -> RobotTargets:
    """Return targets stated as x, y, z, a, b, c (N, 6); raises `TargetError`."""
    poses = poses_from_zyx(values)
    return RobotTargets(names, poses, reach.joints(poses, names))


def read_robot_targets(path: Path, reach: Reach) -> tuple[RobotTargets, bool]:
    """Read poses or joints; returns targets and whether they were joints.

    Raises `SettingsError` with every problem and its line, and `TargetError`.
    """
    rows = targets.read_named_rows(path, [targets.HEADER, JOINT_HEADER], "targets")
    values = np.array(rows.values)
    if rows.header == targets.HEADER:
        return targets_of(rows.names, values, reach), False
    joints = np.radians(values)
    return RobotTargets(rows.names, reach.poses(joints), joints), True


def joint_rows(names: Iterable[str], joints_rad: Array) -> Iterator[list[str]]:
    """Yield the rows of joints (N, 6) under `JOINT_HEADER`."""
    for name, row in zip(names, np.degrees(joints_rad), strict=True):
        yield [name, *(f"{each:.6f}" for each in row)]


def refuse(bad: Bools, names: Sequence[str], what: str, act: str) -> None:
    """Raise `TargetError` naming the first bad targets."""
    if not bad.any():
        return
    first = np.flatnonzero(bad)[:NAMED]
    count = int(np.count_nonzero(bad))
    more = ", ..." if count > NAMED else ""
    named = ", ".join(names[int(n)] for n in first)
    raise TargetError(f"{count} of {len(bad)} {what}: {named}{more}; {act}")


def with_tool_point(arm: Arm, point_mm: Array) -> Arm:
    """Return the arm whose tool frame is shifted to a point (3,) in it."""
    tool = arm.tool.copy()
    tool[:3, 3] += tool[:3, :3] @ point_mm
    return replace(arm, tool=tool)
