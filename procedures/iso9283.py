"""The pose test of ISO 9283:1998: accuracy and repeatability of poses and of a distance.

The cycle P5, P4, P3, P2, P1 begins at P1, and every pose is approached directly from the one before
it, as the robot works, not from one side as in a calibration; also after a stop.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from hilcell.calibration.iso9283 import CYCLE, Pose, PoseTest, commanded_mm, velocity_percent
from hilcell.calibration.lookup import calibration_in, calibration_named
from hilcell.cell.file import Cell
from hilcell.compensation.correction import corrected_poses
from hilcell.decoding import typed
from hilcell.geometry.frames import apply
from hilcell.journal.log import Log
from hilcell.model.plan import PlannedStep, Span
from hilcell.model.point import PointId
from hilcell.model.verdicts import ISO, RP_ANGLES
from hilcell.ports import Array, HilcellError
from hilcell.present.table import Column, Table
from hilcell.run.cell_session import CellSession
from hilcell.run.collision import check_planned_path
from hilcell.run.mover import StraightApproach
from hilcell.run.procedure import Procedure, Result
from procedures import plan
from procedures.base_frame import BaseFrame
from procedures.rail import HoldStation
from procedures.recheck import adopt_calibration
from procedures.world_frame import Home, WorldFrame


class BaseOfTest:
    """{B} by circles of axes 1 and 6, or that of the calibration which is tested."""

    name = "base-of-test"
    needs = "the world frame, the station held"
    moves = "axis 1, then axis 6, each alone; nothing where a calibration is tested"
    measures = "the flange reflector on two circles"
    yields = "the robot base in {W}, in which poses are commanded"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Refuse circles that cannot be driven."""
        if cell.iso9283.calibration:
            return PlannedStep(self.name, 0, 0.0, note="the base is the calibration's")
        return BaseFrame().plan(cell, seed)

    def perform(self, session: CellSession) -> None:
        if session.cell.iso9283.calibration:
            adopt_calibration(session, ISO)
        else:
            BaseFrame().perform(session)

    def result(self, log: Log) -> Result:
        return {} if log.cell.iso9283.calibration else BaseFrame().result(log)


class PoseCycle:
    """Goes round the cycle and measures every pose."""

    name = ISO
    needs = "the base frame, the station held"
    moves = "the robot from pose to pose of the cycle"
    measures = "the reflectors on the flange at five poses, cycle after cycle"
    yields = "AP, RP, AD and RD of ISO 9283, of positions and, with several reflectors, of angles"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Refuse poses out of reach, and paths of the cycle that are not clear."""
        load_kg, rated_kg = cell.iso9283.load_kg, cell.iso9283.rated_load_kg
        if load_kg is not None and rated_kg is not None and not load_kg <= rated_kg:
            raise HilcellError(
                f"iso9283.load_kg is {load_kg:g} kg, the robot is rated for {rated_kg:g} kg "
                "(iso9283.rated_load_kg): take load off, or correct the figure that is wrong",
                code="HC-C10",
            )
        joints_rad = self.commands_rad(cell, cell.iso9283.calibration != "")
        station = cell.reference
        before_rad = np.roll(joints_rad, 1, axis=0)
        check_planned_path(cell, station, before_rad, joints_rad, "path of the ISO 9283 cycle")
        percent = np.full(len(joints_rad), velocity_percent(cell))
        moves_s = plan.robot_moves_s(cell, before_rad, joints_rad, percent)
        seats = len(cell.robot.seats_mm)
        at_each_s = cell.settle.robot_s + seats * plan.measure_s(cell, cell.tracker.samples)
        cycles, points = cell.iso9283.cycles, cell.iso9283.cycles * len(CYCLE) * seats
        cycle_s = float(moves_s.sum()) + len(CYCLE) * at_each_s
        spans = [Span("cycle", points, cycles * cycle_s)]
        return PlannedStep.of_spans(
            self.name, points, [*spans, *plan.closing(cell, carried=True, points=points)]
        )

    def perform(self, session: CellSession) -> None:
        station = session.cell.reference
        joints_rad = self.commands_rad(session.cell, calibration_in(session.log) is not None)
        at_mm = np.array([commanded_mm(session.cell)[name] for name in CYCLE])
        T_W_B = session.frames.base_in_world(station)
        nominal_mm = apply(T_W_B, at_mm)
        nominal_deg = plan.angles_deg(T_W_B, plan.poses_at(session.cell, at_mm))
        percent = velocity_percent(session.cell)
        for cycle, (n, name) in product(range(session.cell.iso9283.cycles), enumerate(CYCLE)):
            session.flange_point(
                PointId(ISO, pose=name, number=cycle), station, joints_rad[n],
                nominal_mm=nominal_mm[n], nominal_deg=nominal_deg[n], seats=True,
                straight=StraightApproach(joints_rad[n - 1], percent),
            )  # fmt: skip
        session.close_step(carried=True)
        if (judged := PoseTest.of(session.log).judgement()) is not None:
            session.judge(ISO, judged)

    def result(self, log: Log) -> Result:
        return {ISO: PoseTest.of(log)}

    @staticmethod
    def words(result: Result) -> str:
        found = typed(result[ISO], PoseTest)
        worst, distance = found.worst, found.distance
        tested = (
            f"with the correction of {found.corrected_by}" if found.corrected_by else "as it is"
        )
        turns = ", ".join(
            f"{each.symbol} {'±' if each.of is RP_ANGLES else ''}{each.value:.4f}° "
            f"(U {each.U:.4f}, {each.where})"
            for each in found.figures()
            if each.of.unit == "deg"
        )
        angles = f" Worst of the angles: {turns}." if turns else ""
        return (
            f"The robot {tested}: AP_p {worst.ap_mm:.3f} mm at worst ({worst.ap_pose}), RP_l "
            f"{worst.rp_mm:.3f} mm ({worst.rp_pose}); distance {distance.start}-{distance.to}: AD "
            f"{distance.ad_mm:+z.4f} mm (U {distance.ad_u95_mm:.4f}), RD ±{distance.rd_mm:.4f} "
            f"mm.{angles} Departures from ISO 9283: {'; '.join(found.deviations)}."
        )

    @staticmethod
    def commands_rad(cell: Cell, calibrated: bool) -> Array:
        """Return the joints (5, 6) of the cycle's poses, corrected where a calibration is tested.

        Raises `HilcellError` for poses that cannot be reached.
        """
        poses = plan.poses_at(cell, np.array([commanded_mm(cell)[name] for name in CYCLE]))
        if calibrated:
            calibration = calibration_named(cell, ISO)
            poses = corrected_poses(calibration.grid(), poses, calibration.error_model())
        return plan.check_targets(cell, cell.reference, poses, "ISO 9283 pose")


COLUMNS: tuple[Column[tuple[str, Pose]], ...] = (
    Column("pose", lambda row: row[0]),
    Column("x", lambda row: row[1].commanded_mm[0], "mm", ".0f"),
    Column("y", lambda row: row[1].commanded_mm[1], "mm", ".0f"),
    Column("z", lambda row: row[1].commanded_mm[2], "mm", ".0f"),
    Column("AP_p", lambda row: row[1].ap_mm, "mm", ".4f"),
    Column("AP_x", lambda row: row[1].ap_x_mm, "mm", ".4f"),
    Column("AP_y", lambda row: row[1].ap_y_mm, "mm", ".4f"),
    Column("AP_z", lambda row: row[1].ap_z_mm, "mm", ".4f"),
    Column("U(AP)", lambda row: row[1].ap_u95_mm, "mm", ".4f"),
    Column("RP_l", lambda row: row[1].rp_mm, "mm", ".4f"),
    Column("U(RP)", lambda row: row[1].rp_u95_mm, "mm", ".4f"),
    Column("robot's", lambda row: row[1].rp_robot_mm, form=".4f"),
)


ISO9283 = Procedure(
    ISO,
    "the pose test of ISO 9283: accuracy and repeatability of poses and a distance",
    (Home(), WorldFrame(), HoldStation(), BaseOfTest(), PoseCycle()),
    lambda result: Table(COLUMNS, typed(result[ISO], PoseTest).poses.items()),
    words=PoseCycle.words,
    may_use=ISO,
)
