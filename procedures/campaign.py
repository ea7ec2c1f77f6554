"""A campaign from a file: move to every pose, measure every reflector, then fit.

The file is a CSV of measured targets (`hilcell fit`): its joints are commanded, its positions are
the expected ones of the tracker.
"""

from __future__ import annotations

from itertools import groupby
from pathlib import Path

import numpy as np

from hilcell.cell.file import Cell, arm_from_joints
from hilcell.decoding import typed
from hilcell.fit.measurements import Measurements, read_measurements
from hilcell.fit.methods import FitResult, fit_robot, methods_table
from hilcell.fit.placement import ABSURD_MM, CHECK_ROBOT, FitError, place_roughly
from hilcell.fit.robot_file import Robot
from hilcell.geometry.frames import FrameError
from hilcell.journal.log import Log, positions_mm
from hilcell.model.plan import PlannedStep
from hilcell.model.point import PointId
from hilcell.ports import HilcellError
from hilcell.run.cell_session import CellSession
from hilcell.run.interlocks import check_joint_limits
from hilcell.run.procedure import Procedure, Result
from procedures.plan import flange_points, measure_s


class Campaign:
    """Moves to the poses in the file's order with the slide, if any, at rest.

    The slide's position is unknown to the plan, so paths are checked before each motion only.
    """

    name = "campaign"
    needs = "a file of poses (campaign.poses)"
    moves = "the robot"
    measures = "every reflector of every pose"
    yields = "measured targets and the fit of the robot's nominal kinematics to them"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Refuse poses of another robot or outside the joint limits, and reflectors by hand."""
        if cell.layout.by_hand:
            raise HilcellError(
                "reflectors are by_hand: those of a campaign must be mounted", code="HC-C16"
            )
        rows = self.poses(cell)
        self._check_robot(cell, rows)
        for pose, joints in zip(rows.pose, rows.joints_rad, strict=True):
            check_joint_limits(cell, joints, f"pose {pose}")
        first = [at[0] for _, at in self._visits(rows)]
        more = len(rows) - len(first)  # further reflectors of a pose
        seconds = flange_points(cell, rows.joints_rad[first]).duration_s
        return PlannedStep(
            self.name, len(rows), seconds + more * measure_s(cell, cell.tracker.samples)
        )

    @staticmethod
    def _check_robot(cell: Cell, rows: Measurements) -> None:
        """Raise `FitError` for poses that were measured on another robot."""
        try:
            miss_mm = place_roughly(Campaign._robot(cell).arm, rows).miss_mm(rows)
            half_mm = float(np.median(miss_mm))
            why = f"nominal kinematics miss half of them by {half_mm:.4g} mm or more, expected <= "
            why += f"{ABSURD_MM:g} mm"
        except (FitError, FrameError) as error:
            half_mm, why = np.inf, str(error)
        if not half_mm <= ABSURD_MM:
            assert cell.campaign is not None  # noqa: S101 - it names the rows
            raise FitError(
                f"campaign.poses {cell.campaign.poses}: expected rows measured on robot "
                f"{cell.robot.name!r} of cell {cell.name}: {why}; {CHECK_ROBOT} "
                f"(hilcell explain {FitError.code})"
            )

    def perform(self, session: CellSession) -> None:
        session.reach("connect")
        rows = self.poses(session.cell)
        for pose, at in self._visits(rows):
            ids = [PointId("campaign", pose=pose, target=rows.target[n]) for n in at]
            targets = list(zip(ids, rows.xyz_mm[at], strict=True))
            session.pose_points(rows.joints_rad[at[0]], targets)

    def result(self, log: Log) -> Result:
        return {"campaign": fit_robot(self._robot(log.cell), self._measured(log)).result}

    @staticmethod
    def poses(cell: Cell) -> Measurements:
        """Return the file's poses; raises `HilcellError` where the cell names none."""
        if cell.campaign is None:
            raise HilcellError(
                "campaign.poses is missing: give a CSV with --set campaign.poses=FILE",
                code="HC-C13",
            )
        return read_measurements(Path(cell.campaign.poses))

    @staticmethod
    def _visits(rows: Measurements) -> list[tuple[str, list[int]]]:
        visits = groupby(range(len(rows)), key=lambda row: rows.pose[row])
        return [(pose, list(numbers)) for pose, numbers in visits]

    @staticmethod
    def _robot(cell: Cell) -> Robot:
        """Return the cell's nominal robot; the fit identifies its reflectors."""
        return Robot(cell.robot.name, arm_from_joints(cell.robot.joint, np.eye(4)))

    @staticmethod
    def _measured(log: Log) -> Measurements:
        points = [*log.measured("campaign")]
        joints_deg = np.array([point.commanded_deg for point in points])
        return Measurements(
            [point.id.pose for point in points],
            [point.id.target for point in points],
            np.radians(joints_deg),
            positions_mm(points),
        )


CAMPAIGN = Procedure(
    "campaign",
    "drive and measure the poses of a file, then fit",
    (Campaign(),),
    lambda result: methods_table(typed(result["campaign"], FitResult)["methods"]),
)
