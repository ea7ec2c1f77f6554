"""Targets of a robot that was measured elsewhere: a list of poses or joints, or a program."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from hilcell.calibration.form import written_now
from hilcell.calibration.influence import bounds_of
from hilcell.calibration.programs import POSTURE_BITS, check_posture
from hilcell.cell.settings import SettingsError
from hilcell.compensation.choice import NOMINAL
from hilcell.compensation.programs import Program, load_program, statuses_of
from hilcell.compensation.stamp import Stamp
from hilcell.compensation.targets import HEADER, target_rows
from hilcell.fit.methods import UNDETERMINED_MM, Fitted
from hilcell.fit.placement import FitError
from hilcell.fit.robot_file import Measurements, Robot
from hilcell.fit.robot_targets import (
    JOINT_HEADER,
    MOST_KNOWN,
    Reach,
    joint_rows,
    read_robot_targets,
    refuse,
    targets_of,
    with_tool_point,
)
from hilcell.fit.tool_errors import Controller, controller_of
from hilcell.geometry.closed_form import ReachError, status_of
from hilcell.geometry.frames import zyx_from_pose
from hilcell.ports import Array
from hilcell.programs.corrected import Corrected
from hilcell.programs.target_jobs import TargetFiles

ROOT = "the robot's root frame"  # that poses are in
MARGIN_RAD = np.radians(5.0)  # beyond the measured joints that still counts as within


@dataclass(frozen=True, eq=False)
class ArmTargets(TargetFiles):
    """Targets of a tool point that ``controller`` knows, corrected by what was fitted.

    ``remark`` says which joints go beyond those that were measured.
    """

    controller: Controller
    remark: str

    @classmethod
    def plan(
        cls,
        robot: Robot,
        fit: Fitted,
        train: Measurements,
        source: Path,
        *,
        tool: str,
        say: Callable[[str], object],
    ) -> Self:
        """Return targets of the reflector ``tool``, corrected by the method that was chosen.

        ``train`` are the rows that were learnt from; ``say`` takes what could not be checked.
        Raises `HilcellError` where a target must not be corrected.
        """
        chosen = fit.result["chosen"]
        if chosen == NOMINAL:
            raise FitError(f"no target is corrected: {fit.result['reason']}")
        method = fit.methods[chosen]
        controller = controller_of(robot, method, train, tool)
        arm = with_tool_point(replace(robot.arm(), tool=robot.tool), controller.tool_mm)
        known = np.unique(train.joints_rad, axis=0)
        known = known[:: len(known) // MOST_KNOWN + 1]
        reach = Reach(arm, robot.base, known, robot.limits_rad)
        program = load_program(source)
        if program is None:
            targets, as_joints = read_robot_targets(source, reach)
        else:
            targets, as_joints = targets_of(program.names, program.values(), reach), False
        names, joints_rad = targets.names, targets.joints_rad
        errors = controller.errors(method, joints_rad)
        command = targets.corrected(errors.error_mm)
        bounds = bounds_of(errors.covariance_mm2, [], np.eye(4), targets.poses)
        refuse(
            ~(bounds.radii_mm <= UNDETERMINED_MM),
            names,
            f"targets have 95 % bounds over {UNDETERMINED_MM:g} mm",
            "the training rows do not determine them; measure poses near them",
        )
        sent = zyx_from_pose(command)
        header, rows = HEADER, list(target_rows(names, sent))
        if as_joints:
            sent_rad = reach.near(command, joints_rad, names)
            header, rows = JOINT_HEADER, list(joint_rows(names, sent_rad))
        if program is not None:
            _check_program(program, reach, joints_rad, sent, source, say)
        stamp = Stamp(f"fit of {Path(train.source).name}", written_now())
        corrected = Corrected(names, zyx_from_pose(targets.poses), sent, bounds, stamp)
        return cls(
            source, program, corrected, ROOT, sent[:, :3], header, rows, controller,
            _beyond(names, joints_rad, train),
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
            f"{count} targets of {tool} corrected into {written}",
            self.targets.summary,
            "keep the stamp in the file: corrected targets are known by it alone",
            *filter(None, [self.remark]),
        ]


def _check_program(
    program: Program,
    reach: Reach,
    joints_rad: Array,
    command: Array,
    source: Path,
    say: Callable[[str], object],
) -> None:
    """Refuse what only a calibration can judge, other postures, and whole turns that would change.

    ``joints_rad`` (N, 6) were found for the targets, ``command`` (N, 6) is what is sent.
    """
    problems = [
        f"{each.where}: strokes are corrected by `compensate` alone" for each in program.strokes
    ]
    if program.base is not None and any(program.base.values):
        problems.append(f"{program.base.where}: the base set there is not {ROOT}")
    if problems:
        raise SettingsError(str(source), problems)
    if statuses_of(program, 0):
        try:
            status, *others = np.unique(status_of(reach.arm, joints_rad)).tolist()
        except ReachError as error:
            say(f"{source.name}: the postures of its targets were not checked: {error}")
        else:
            stated = statuses_of(program, status)
            check_posture(status, [each for each in stated if each[1] & POSTURE_BITS not in others])
    if program.needs_arm:
        try:
            program.check_joints(reach.arm, reach.base, command)
        except ReachError as error:
            say(f"{source.name}: {program.needs_arm} were not checked: {error}")


def _beyond(names: list[str], joints_rad: Array, train: Measurements) -> str:
    """Return which joints go beyond those that were measured, or "": nothing was learnt there."""
    low, high = train.joints_rad.min(axis=0) - MARGIN_RAD, train.joints_rad.max(axis=0) + MARGIN_RAD
    beyond = ~((joints_rad >= low) & (joints_rad <= high))
    if not beyond.any():
        return ""
    axes = ", ".join(f"A{axis + 1}" for axis in np.flatnonzero(beyond.any(axis=0)))
    count = int(np.count_nonzero(beyond.any(axis=1)))
    first = names[int(np.flatnonzero(beyond.any(axis=1))[0])]
    return (
        f"{count} targets, {first} the first, are beyond the joints that were measured ({axes}); "
        "errors there are extrapolated"
    )
