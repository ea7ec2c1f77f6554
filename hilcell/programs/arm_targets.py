"""Targets of a robot that was measured elsewhere: a list of poses or joints, or a program.

Poses are those of the tool point in the robot's root frame, under the header of `compensate`;
joints stand under ``name,j1_deg,...,j6_deg``. Both are corrected as
`hilcell.programs.pose_correction` does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from hilcell.calibration.form import written_now
from hilcell.cell.settings import SettingsError, read_file
from hilcell.compensation.programs import Program, load_program
from hilcell.compensation.provenance import Stamp
from hilcell.compensation.targets import HEADER, read_named_rows, target_rows
from hilcell.fit.methods import RobotFit
from hilcell.fit.robot_file import Measurements
from hilcell.geometry.frames import poses_from_zyx, zyx_from_pose
from hilcell.geometry.inverse import ReachError, status_of
from hilcell.geometry.kinematics import Array
from hilcell.programs.corrected import Corrected
from hilcell.programs.pose_correction import Controller, PoseCorrection, Reach
from hilcell.programs.target_jobs import POSTURE_BITS, TargetFiles, check_posture
from hilcell.sanitize import counted

ROOT = "the robot's root frame"  # that poses are in
JOINT_HEADER = ["name", *(f"j{n}_deg" for n in range(1, 7))]


@dataclass(frozen=True, eq=False)
class ArmTargets(TargetFiles):
    """Targets of a tool point, corrected by what was fitted; ``remark`` names joints far beyond."""

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
        """Return targets of the reflector ``tool``, corrected by the chosen method."""
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
            header, rows = JOINT_HEADER, list(joint_rows(names, found.command_rad()))
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
        """Return the targets' frames, and how well they are known."""
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
        """Write all files; return in words what was done. Raises `NotWritten`."""
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
        """Refuse what only a calibration can judge, other postures, and other whole turns."""
        problems = [
            f"{each.where}: strokes are corrected by `compensate` alone" for each in program.strokes
        ]
        if program.base is not None and any(program.base.values):
            problems.append(f"{program.base.where}: the base set there is not {ROOT}")
        if problems:
            raise SettingsError(str(source), problems)
        if program.statuses(0):
            try:
                status, *others = np.unique(status_of(reach.arm, joints_rad)).tolist()
            except ReachError as error:
                say(f"{source.name}: the postures of its targets were not checked: {error}")
            else:
                stated = program.statuses(status)
                check_posture(
                    status, [each for each in stated if each[1] & POSTURE_BITS not in others]
                )
        if program.needs_arm:
            try:
                program.check_joints(reach.arm, reach.base, command)
            except ReachError as error:
                say(f"{source.name}: {program.needs_arm} were not checked: {error}")

    @staticmethod
    def _beyond(names: list[str], joints_rad: Array, train: Measurements) -> str:
        """Return which joints go beyond those measured, or "": nothing was learnt there."""
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
    """Return N names, the tool's poses (N, 4, 4) in the root, nominal joints (N, 6) for them, and
    whether these are what is listed; raises `SettingsError`, `HilcellError`.
    """
    rows = read_named_rows(path, read_file(path), [HEADER, JOINT_HEADER], "targets")
    if rows.header == HEADER:
        poses = poses_from_zyx(np.array(rows.values))
        return rows.names, poses, reach.joints(poses, rows.names), False
    joints_rad = np.radians(rows.values)
    return rows.names, reach.poses(joints_rad), joints_rad, True


def joint_rows(names: Iterable[str], joints_rad: Array) -> Iterator[list[str]]:
    """Yield the rows of joints (N, 6) under `JOINT_HEADER`."""
    for name, row in zip(names, np.degrees(joints_rad), strict=True):
        yield [name, *(f"{each:.6f}" for each in row)]
