"""{B} from circles: the reflector is swept by axis 1 and by axis 6 (section 4.2, Fig 6)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hilcell.calibration.changes import risen_nest, since_before
from hilcell.calibration.diagnosis import misplaced_base
from hilcell.calibration.frames import axis_6_height_mm, axis_circle, frame_of_sweeps, sweep_of
from hilcell.calibration.known_arm import slipped_mount
from hilcell.cell.devices import abilities
from hilcell.cell.file import Cell, Station
from hilcell.geometry.frames import base_frame_covariance
from hilcell.journal.log import Log
from hilcell.model.frame import Matrix, MeasuredBase
from hilcell.model.plan import PlannedStep, Span
from hilcell.model.point import PointId
from hilcell.model.results import StepResult
from hilcell.ports import Array
from hilcell.run.cell_session import CellSession
from hilcell.run.collision import check_poses
from hilcell.run.procedure import Result
from procedures.plan import closing, flange_points

FEWEST_ON_ARC = 5


class Arc(StepResult, frozen=True, kw_only=True):
    """The uncertainties (k = 1) of an axis's circle by the middle of its sweep."""

    axis: int
    arc_deg: float
    points: int
    centre_u_mm: float
    axis_u_mrad: float


class FramedBase(StepResult, frozen=True, kw_only=True):
    """The base in {W}, its uncertainties (k = 1), and those of shorter arcs."""

    T_W_B: Matrix
    origin_u_mm: list[float]
    angle_u_mrad: list[float]
    circle_rms_mm: list[float]
    radius_mm: list[float]
    arcs: list[Arc]


class BaseFrame:
    """z is axis 1, x is axis 6 made orthogonal to it; the height is that of axis 6's circle."""

    name = "base-frame"
    needs = "the world frame, the grid's station held"
    moves = "axis 1, then axis 6, each alone"
    measures = "the flange reflector on two circles"
    yields = "the robot base in {W}"

    def announced(self, cell: Cell) -> str:
        table = cell.base_frame
        first, sixth = (
            "from {:g} to {:g} deg".format(*sweep_deg)
            for sweep_deg in (table.axis_1_sweep_deg, table.axis_6_sweep_deg)
        )
        return f"the robot to the start of each circle, axis 1 {first}, axis 6 {sixth}, each alone"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Refuse sweeps that leave the joint limits or come too near to a volume."""
        check_circles(cell, cell.reference)
        return PlannedStep.of_spans(
            self.name, 2 * points_on_arc(cell), [sweeps(cell), *closing(cell)]
        )

    def perform(self, session: CellSession) -> None:
        if "base" not in session.log.frames:
            self._construct(session)
            suspicion = misplaced_base(session.log) or risen_nest(session.log)
            if suspicion is not None:
                session.pause(
                    f"suspected: {suspicion.text}; correct the nest or its reflector and start a "
                    "new run, or correct the cell file, or revoke that run's calibration"
                )
            elif (slipped := slipped_mount(session.log)) is not None:
                session.pause(
                    f"suspected: {slipped.text}; seat the reflector and start a new run; if the "
                    "mount or the zero of axis 6 is another one, run calibrate without --from"
                )
            elif (since := since_before(session.log)) is not None:
                session.pause(
                    f"suspected: {since.text}; which one is right? Correct the change, "
                    "or continue and then revoke the wrong calibration"
                )
        session.reach("frame_base")

    def _construct(self, session: CellSession) -> None:
        station = session.cell.reference
        poses_rad = {axis: sweep(session.cell, axis) for axis in (1, 6)}
        session.expect(station, np.vstack([*poses_rad.values()]))
        swept = [
            [
                session.flange_point(PointId("base", axis=axis, number=n), station, joints)
                for n, joints in enumerate(joints_rad)
            ]
            for axis, joints_rad in poses_rad.items()
        ]
        session.close_step()
        T_W_B, axis_1, axis_6 = frame_of_sweeps(session.cell, session.log, *swept)
        covariance = base_frame_covariance(axis_1, axis_6, axis_6_height_mm(session.cell))
        base = MeasuredBase(
            matrix=T_W_B.tolist(),
            points=[point.key for point in (*swept[0], *swept[1])],
            covariance=covariance.tolist(),
            circle_rms_mm=[axis_1.rms_mm, axis_6.rms_mm],
            radius_mm=[axis_1.radius_mm, axis_6.radius_mm],
        )
        session.frame("base", base)

    def result(self, log: Log) -> Result:
        frame = log.frame(MeasuredBase, "base")
        u = np.sqrt(np.diag(frame.C))
        found = FramedBase(
            T_W_B=frame.matrix,
            origin_u_mm=u[:3].tolist(),
            angle_u_mrad=(u[3:] * 1e3).tolist(),
            circle_rms_mm=frame.circle_rms_mm,
            radius_mm=frame.radius_mm,
            arcs=[each for axis in (1, 6) for each in self._shorter_arcs(log, axis)],
        )
        return {"base": found}

    @staticmethod
    def _shorter_arcs(log: Log, axis: int) -> Iterator[Arc]:
        """Yield the circle's uncertainties by arc, the shortest first."""
        points = log.select("base", axis=axis)
        begin_deg, end_deg = sweep_of(log.cell, axis)[1]
        for arc in BaseFrame.arcs(len(points)):
            circle = axis_circle(log.cell, log, axis, [points[n] for n in arc])
            u = np.sqrt(np.diag(circle.covariance))
            yield Arc(
                axis=axis,
                arc_deg=abs(end_deg - begin_deg) * (len(arc) - 1) / (len(points) - 1),
                points=len(arc),
                centre_u_mm=float(np.linalg.norm(u[:3])),
                axis_u_mrad=float(np.linalg.norm(u[3:]) * 1e3),
            )

    @staticmethod
    def arcs(points: int) -> list[range]:
        """Return the points of growing arcs around the middle of a sweep, up to the whole."""
        shares = (0.25, 0.5, 0.75, 1.0)
        counts = [min(points, max(FEWEST_ON_ARC, round(share * points))) for share in shares]
        return [range((points - count) // 2, (points + count) // 2) for count in counts]


def points_on_arc(cell: Cell) -> int:
    """Number of points of each arc. Targets, grid and correction are all in the measured {B}: its
    error does not reach the tool.
    """
    points = cell.base_frame.points
    if not cell.plan.quick:
        return points
    noisy = 12  # for a total station, an order coarser than a tracker that streams
    return min(points, FEWEST_ON_ARC if abilities(cell)["tracker_streams"] else noisy)


def sweep(cell: Cell, axis: int) -> Array:
    """Return the joints (N, 6), rad, of one axis's sweep."""
    fixed, ends = sweep_of(cell, axis)
    joints_deg: Array = np.tile(fixed, (points_on_arc(cell), 1))
    joints_deg[:, axis - 1] = np.linspace(ends[0], ends[1], points_on_arc(cell))
    return np.radians(joints_deg)


def check_circles(cell: Cell, station: Station) -> None:
    """Raise `Blocked` for circles that cannot be measured at ``station``."""
    for axis in (1, 6):
        check_poses(cell, station, sweep(cell, axis), f"axis {axis} sweep")


def sweeps(cell: Cell) -> Span:
    return flange_points(cell, np.vstack([sweep(cell, 1), sweep(cell, 6)]))
