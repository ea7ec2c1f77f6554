"""Corrected poses of a robot that was measured elsewhere, with a 95 % bound of each.

The controller is assumed to use the nominal arm. Its tool is a reflector as identified; its base is
where nominal kinematics with that tool fit the training poses best: an identified base may be
millimetres off where the poses do not determine it, and all corrections would compensate for that.

Targets are a program, or a list: of poses of the tool point in the robot's root frame, under the
header of `compensate`, or of joints under ``name,j1_deg,...``, as `Robot.joint_columns` has them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from hilcell.calibration.file import written_now
from hilcell.calibration.influence import Bounds, combined_bounds
from hilcell.cell.settings import SettingsError, read_file
from hilcell.compensation.model import Prediction
from hilcell.compensation.model_choice import NOMINAL
from hilcell.compensation.programs import Program, load_program
from hilcell.compensation.targets import HEADER, Stamp, read_named_rows, target_rows
from hilcell.fit.measurements import Measurements
from hilcell.fit.methods import Method, RobotFit
from hilcell.fit.placement import FitError
from hilcell.fit.robot_file import Robot
from hilcell.geometry.frames import (
    FrameError,
    apply,
    apply_each,
    inverse,
    poses_from_zyx,
    rigid_fit,
    zyx_from_pose,
)
from hilcell.geometry.inverse import ReachError, refined, status_of
from hilcell.geometry.kinematics import Arm, Array, Bools, forward
from hilcell.ports import HilcellError
from hilcell.programs.corrected import Corrected
from hilcell.programs.target_jobs import POSTURE_BITS, TargetFiles, check_posture
from hilcell.sanitize import counted


@dataclass(frozen=True, eq=False)
class CorrectedPoses:
    """N poses of a tool point in the robot's root frame, and the commands that reach them.

    ``nominal`` and ``command`` (N, 4, 4) in mm, with equal orientations; ``joints_rad`` (N, n): the
    nominal arm's at ``nominal``; ``bounds``: of the position that the command reaches.
    """

    names: list[str]
    nominal: Array
    command: Array
    joints_rad: Array
    bounds: Bounds
    reach: Reach

    @property
    def bound95_mm(self) -> Array:
        """95 % bounds (N,) of the 3-D errors."""
        return self.bounds.radii_mm

    @property
    def covariance_mm2(self) -> Array:
        """Covariances (N, 3, 3) of the positions, in the robot's root frame."""
        return self.bounds.covariance_mm2

    def command_rad(self) -> Array:
        """The nominal arm's joints (N, n) at ``command``. Raises `HilcellError` where a joint moves
        by more than 5 deg, or leaves its limits.
        """
        return self.reach.near(self.command, self.joints_rad, self.names)


@dataclass(frozen=True, eq=False)
class PoseCorrection:
    """Corrects poses of a reflector, the tool point, by the chosen method of a fit.

    Examples:
        >>> fit = fit_robot(read_robot("irb120.toml"), read_measurements("train.csv"))
        >>> corrected = PoseCorrection.of(fit, "SMR1").of_joints(fit.train.joints_rad[:4])
        >>> corrected.command.shape, corrected.bound95_mm.shape
        ((4, 4, 4), (4,))
    """

    method: Method
    controller: Controller
    reach: Reach
    limit_mm: float

    @classmethod
    def of(cls, fit: RobotFit, tool: str) -> Self:
        """Correction for the reflector ``tool``; raises `FitError` where nominal kinematics were
        chosen.
        """
        most_known = 500  # measured poses that are searched from
        if fit.chosen == NOMINAL:
            raise FitError(f"no target is corrected: {fit.result['reason']}")
        method, robot, train = fit.methods[fit.chosen], fit.robot, fit.train
        controller = Controller.of(robot, method, train, tool)
        with_tool = replace(robot, tool=shifted(robot.tool, controller.tool_mm))
        known = np.unique(train.joints_rad, axis=0)
        known = known[:: len(known) // most_known + 1]
        return cls(method, controller, Reach(with_tool, known), fit.result["undetermined_mm"])

    def of_poses(self, poses: ArrayLike, names: Sequence[str] = ()) -> CorrectedPoses:
        """Corrected poses (N, 4, 4) of the tool point in the robot's root frame.

        Raises `HilcellError` naming poses that are out of reach, or that the training rows do not
        determine; without ``names`` they are numbered from 1.
        """
        nominal = np.array(poses, dtype=float)
        labels = _labels(names, nominal)
        return self.corrected(labels, nominal, self.reach.joints(nominal, labels))

    def of_joints(self, joints_rad: ArrayLike, names: Sequence[str] = ()) -> CorrectedPoses:
        """Corrected poses of the nominal arm at joints (N, n), as `of_poses`."""
        joints = np.array(joints_rad, dtype=float)
        return self.corrected(_labels(names, joints), self.reach.poses(joints), joints)

    def corrected(self, names: list[str], poses: Array, joints_rad: Array) -> CorrectedPoses:
        """Corrected poses (N, 4, 4) with known nominal joints (N, n)."""
        errors = self.controller.errors(self.method, joints_rad)
        command = poses.copy()
        command[:, :3, 3] -= errors.error_mm
        bounds = combined_bounds(errors.covariance_mm2, [], np.eye(4), poses)
        refuse(
            ~(bounds.radii_mm <= self.limit_mm),
            names,
            f"targets have 95 % bounds over {self.limit_mm:.3g} mm",
            "the training rows do not determine them; measure poses near them",
        )
        return CorrectedPoses(names, poses, command, joints_rad, bounds, self.reach)


def _labels(names: Sequence[str], values: Array) -> list[str]:
    return list(names) or [str(number) for number in range(1, len(values) + 1)]


@dataclass(frozen=True, eq=False)
class Reach:
    """Poses and joints of a nominal robot whose tool is the tool point.

    ``known_rad`` (M, n): measured joints: a pose takes the posture of the nearest.
    """

    robot: Robot
    known_rad: Array

    STARTS = 8  # measured poses from which one is searched

    @cached_property
    def arm(self) -> Arm:
        return replace(self.robot.arm, tool=self.robot.tool)

    def poses(self, joints_rad: Array) -> Array:
        return self.robot.poses(joints_rad)

    def joints(self, poses: Array, names: Sequence[str]) -> Array:
        """Joints (N, n) for poses in the root, in the one posture that was measured."""
        if len(self.arm) != 6:
            raise HilcellError(
                f"a pose does not say the {counted(len(self.arm), 'joint')} of {self.robot.name}, "
                "only six joints follow from it; give joints",
                code="HC-C10",
            )
        if not self._one_posture:
            raise HilcellError(
                "the measured poses have several postures (elbow, wrist), and a pose does not say "
                "which the robot takes there; give joints",
                code="HC-C10",
            )
        joints, lost = np.empty((len(poses), len(self.arm))), np.zeros(len(poses), dtype=bool)
        at_once = 512  # poses of one search
        for first in range(0, len(poses), at_once):
            part = slice(first, first + at_once)
            joints[part], found, _ = self._searched(poses[part], enough=1)
            lost[part] = ~found
        refuse(
            lost, names, "poses are not reached in the posture of measured ones",
            "check frame, tool and units, or give joints",
        )  # fmt: skip
        return joints

    def near(self, poses: Array, joints_rad: Array, names: Sequence[str]) -> Array:
        """Joints (N, n) for poses a correction away; refuses large motions, and other limits."""
        found, arrived = refined(self.arm, inverse(self.robot.base) @ poses, joints_rad)
        refuse(
            ~arrived, names, "corrected targets are not reached",
            "the arm is singular there, or has too few joints; move them",
        )  # fmt: skip
        # of a joint by a correction: beyond, the wrist is singular there
        most_rotation_rad = np.radians(5.0)
        near = np.abs(found - joints_rad).max(axis=1) <= most_rotation_rad
        refuse(
            ~near, names,
            f"corrections turn a joint by more than {np.degrees(most_rotation_rad):g} deg",
            "arm or wrist are singular there; move them, or give poses",
        )  # fmt: skip
        low, high = self.robot.limits_rad
        inside = (found >= low) & (found <= high)
        refuse(
            ~inside.all(axis=1), names, "corrected targets leave the joints' limits",
            "move them away from the limits",
        )  # fmt: skip
        return found

    @cached_property
    def _one_posture(self) -> bool:
        """Whether the measured poses are reached in no other measured posture."""
        return not self._searched(self.poses(self.known_rad), enough=self.STARTS)[2].any()

    def _searched(self, poses: Array, enough: int) -> tuple[Array, Bools, Bools]:
        """Joints (N, n), which converged, which in several postures, each (N,). Searched from
        measured poses nearby until ``enough`` lead there.
        """
        in_base = inverse(self.robot.base) @ poses
        joints = np.zeros((len(poses), len(self.arm)))
        count = np.zeros(len(poses), dtype=int)
        several = np.zeros(len(poses), dtype=bool)
        same_posture_rad = np.pi / 2  # of a joint: another posture turns one further
        other_rad = 0.01  # of a joint: two postures, not two roundings of one
        for start in np.swapaxes(self._nearest(poses), 0, 1):
            left = np.flatnonzero(count < enough)
            found, arrived = refined(self.arm, in_base[left], start[left])
            good = arrived & (np.abs(found - start[left]).max(axis=1) <= same_posture_rad)
            at, found = left[good], found[good]
            apart_rad = np.abs(np.pi - np.mod(np.pi - (found - joints[at]), 2.0 * np.pi))
            several[at] |= (apart_rad.max(axis=1) > other_rad) & (count[at] > 0)
            joints[at] = np.where(count[at, None] > 0, joints[at], found)
            count[at] += 1
        return joints, count > 0, several

    def _nearest(self, poses: Array) -> Array:
        known = self.poses(self.known_rad)
        shift = poses[:, None, :3, 3] - known[:, :3, 3]
        # |A - B| of rotations is 2 sqrt 2 times the sine of half the angle between them.
        turn_mm = 300.0  # what a radian counts in the search of the nearest measured pose
        turn = (poses[:, None, :3, :3] - known[:, :3, :3]) * turn_mm / np.sqrt(2.0)
        distance = np.sum(shift**2, axis=-1) + np.sum(turn**2, axis=(-2, -1))
        return self.known_rad[np.argsort(distance, axis=1)[:, : self.STARTS]]


def refuse(bad: Bools, names: Sequence[str], what: str, act: str) -> None:
    if (count := int(np.count_nonzero(bad))) > 0:
        most = 5
        named = ", ".join(names[n] for n in np.flatnonzero(bad)[:most])
        more = ", ..." if count > most else ""
        raise HilcellError(f"{count} of {len(bad)} {what}: {named}{more}; {act}", code="HC-C10")


def shifted(tool: Array, point_mm: Array) -> Array:
    """A tool frame (4, 4), shifted to a point (3,) in it."""
    moved = tool.copy()
    moved[:3, 3] += tool[:3, :3] @ point_mm
    return moved


@dataclass(frozen=True, eq=False)
class Controller:
    """A robot's nominal arm, its ``base`` (4, 4) in the tracker's frame, and a reflector ``target``
    at ``smr_mm`` (3,) on the flange.
    """

    robot: Robot
    base: Array
    target: str
    smr_mm: Array

    @classmethod
    def of(cls, robot: Robot, method: Method, train: Measurements, target: str) -> Self:
        """Return the controller that a method's predictions at the training rows fit best."""
        smr_mm = np.array([method.smr_mm[each] for each in train.target])
        nominal_mm = apply_each(forward(robot.arm, train.joints_rad), smr_mm)
        try:
            base = rigid_fit(nominal_mm, method.predict(train)[0]).T
        except FrameError:  # on one line: its turn about the line is the method's
            base = method.base
        return cls(robot, base, target, method.smr_mm[target])

    @property
    def root(self) -> Array:
        """The robot's root frame in the tracker's (4, 4)."""
        return self.base @ inverse(self.robot.base)

    @property
    def tool_mm(self) -> Array:
        """Return the reflector (3,) in the robot's tool frame."""
        return np.asarray(apply(inverse(self.robot.tool), self.smr_mm[None])[0])

    def errors(self, method: Method, joints_rad: Array) -> Prediction:
        """Errors e = actual - nominal of the reflector in the root frame at joints (N, n)."""
        rows = Measurements.unmeasured(joints_rad, self.target)
        seen_mm, covariance_mm2 = method.predict(rows)
        nominal_mm = apply_each(forward(self.robot.arm, joints_rad), self.smr_mm)
        R = inverse(self.root)[:3, :3]
        error_mm = (seen_mm - apply(self.base, nominal_mm)) @ R.T
        return Prediction(error_mm, R @ covariance_mm2 @ R.T)


ROOT = "the robot's root frame"  # that poses are in


@dataclass(frozen=True, eq=False)
class ArmTargets(TargetFiles):
    """Targets of a tool point, corrected by a fit; ``remark`` names joints far beyond."""

    controller: Controller
    remark: str

    @classmethod
    def plan(
        cls,
        fit: RobotFit,
        source: Path,
        *,
        tool: str,
        say: Callable[[str], object],
    ) -> Self:
        """Targets of the reflector ``tool``, corrected by the chosen method."""
        correction, train = PoseCorrection.of(fit, tool), fit.train
        reach = correction.reach
        program = load_program(source)
        as_joints = False
        if program is None:
            names, poses, joints_rad, as_joints = read_list(source, reach)
        else:
            names, poses = program.names, poses_from_zyx(program.values())
            joints_rad = reach.joints(poses, names)
        found = correction.corrected(names, poses, joints_rad)
        sent = zyx_from_pose(found.command)
        header, rows = HEADER, list(target_rows(names, sent))
        if as_joints:
            header = joint_header(fit.robot)
            rows = list(joint_rows(fit.robot, names, found.command_rad()))
        if program is not None:
            cls._check_program(program, reach, joints_rad, sent, source, say)
        stamp = Stamp(f"fit of {Path(train.source).name}", written_now())
        corrected = Corrected(names, zyx_from_pose(poses), sent, found.bounds, stamp)
        return cls(
            source, program, corrected, ROOT, sent[:, :3], header, rows, correction.controller,
            cls._beyond(names, joints_rad, train),
        )  # fmt: skip

    @property
    def summary(self) -> dict[str, object]:
        bounds_mm = np.array(self.targets.bounds95_mm)
        return {
            "targets": len(self.targets.names),
            "tool": self.controller.target,
            "tool_mm": self.controller.tool_mm.tolist(),
            "root_in_tracker": self.controller.root.tolist(),
            "bound95_median_mm": float(np.median(bounds_mm)),
            "bound95_max_mm": float(bounds_mm.max()),
        }

    def write(self, out: Path, bounds: Path | None, inputs: Iterable[Path]) -> list[str]:
        """Write all files; return messages. Raises `NotWritten`."""
        written, notes = self.write_files(out, bounds, inputs)
        where = " ".join(f"{each:.4f}" for each in self.controller.tool_mm)
        count, tool = len(self.targets.names), f"{self.controller.target} (tool point {where} mm)"
        return [
            *notes,
            f"{counted(count, 'target')} of {tool} corrected into {written}",
            self.targets.summary,
            "keep the stamp in the file: corrected targets are known by it alone",
            *filter(None, [self.remark]),
        ]

    @staticmethod
    def _check_program(
        program: Program,
        reach: Reach,
        joints_rad: Array,
        command: Array,
        source: Path,
        say: Callable[[str], object],
    ) -> None:
        problems = [
            f"{each.where}: strokes are corrected by `compensate` alone" for each in program.strokes
        ]
        if program.base is not None and any(program.base.values):
            problems.append(f"{program.base.where}: the base set there is not {ROOT}")
        if problems:
            raise SettingsError(str(source), problems)
        if program.statuses(0, reach.arm):
            try:
                status, *others = np.unique(status_of(reach.arm, joints_rad)).tolist()
            except ReachError as error:
                say(f"{source.name}: the postures of its targets were not checked: {error}")
            else:
                stated = program.statuses(status, reach.arm)
                check_posture(
                    status, [each for each in stated if each[1] & POSTURE_BITS not in others]
                )
        if program.needs_arm:
            try:
                notes = program.check_joints(reach.arm, reach.robot.base, command)
            except ReachError as error:
                notes = [f"{program.needs_arm} were not checked: {error}"]
            for note in notes:
                say(f"{source.name}: {note}")

    @staticmethod
    def _beyond(names: list[str], joints_rad: Array, train: Measurements) -> str:
        """Joints beyond those measured, where nothing was learnt, or ""."""
        margin_rad = np.radians(5.0)  # beyond the measured joints that still counts as within
        low, high = (
            train.joints_rad.min(axis=0) - margin_rad,
            train.joints_rad.max(axis=0) + margin_rad,
        )
        beyond = ~((joints_rad >= low) & (joints_rad <= high))
        if not beyond.any():
            return ""
        axes = ", ".join(f"A{axis + 1}" for axis in np.flatnonzero(beyond.any(axis=0)))
        rows = np.flatnonzero(beyond.any(axis=1)).tolist()
        return (
            f"{counted(len(rows), 'target')} beyond the joints measured ({axes}), {names[rows[0]]} "
            "the first; errors there are extrapolated: measure poses there, or move the targets"
        )


def read_list(path: Path, reach: Reach) -> tuple[list[str], Array, Array, bool]:
    """N names, the tool's poses (N, 4, 4) in the root, nominal joints (N, n), whether these are
    listed. Raises `SettingsError`, `HilcellError`.
    """
    robot = reach.robot
    rows = read_named_rows(path, read_file(path), [HEADER, joint_header(robot)], "targets")
    if rows.header == HEADER:
        poses = poses_from_zyx(np.array(rows.values))
        return rows.names, poses, reach.joints(poses, rows.names), False
    joints_rad = np.array(rows.values) * robot.column_units
    return rows.names, reach.poses(joints_rad), joints_rad, True


def joint_header(robot: Robot) -> list[str]:
    return ["name", *robot.joint_columns]


def joint_rows(robot: Robot, names: Iterable[str], joints_rad: Array) -> Iterator[list[str]]:
    """Yield the rows of joints (N, n) under `joint_header`."""
    for name, row in zip(names, joints_rad / robot.column_units, strict=True):
        yield [name, *(f"{each:.6f}" for each in row)]
