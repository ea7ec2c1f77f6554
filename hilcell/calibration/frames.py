"""The calibration as a chain of frames, read from a run's log.

{L} tracker, {W} world, {B} robot base, {S} slide: ``T_W_L`` comes from the floor nests, ``T_W_B``
at the grid's station from circles of axes 1 and 6, ``T_W_S`` at every station from slide nests.
The robot stands rigidly on the slide, so eq 17 gives every station's base frame.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hilcell.cell.file import Cell, Six, Station
from hilcell.cell.plan import coarsest_pitch_mm
from hilcell.compensation.grid import Grid, MeasuredGrid
from hilcell.compensation.measured import Measured, MeasuredArm, StaticPoses
from hilcell.compensation.outliers import outlying
from hilcell.compensation.similarity import Pairs, similarity_pairs
from hilcell.geometry.circles import Circle, base_frame, fit_circle
from hilcell.geometry.frames import apply, inverse, matrix, three_point_frame
from hilcell.geometry.kinematics import forward
from hilcell.identification.readings import Readings
from hilcell.journal.curve_record import curve_of
from hilcell.journal.log import Log, commanded_rad, covariances_mm2, positions_mm
from hilcell.journal.set_ups import world_key
from hilcell.model.frame import TouchedBase
from hilcell.model.point import Point, PointId
from hilcell.ports import Array

ORIENTED = "oriented"  # kind of a grid's vertex in another orientation than the grid's


def base_at(T_W_S1: Array, T_W_Si: Array, T_W_B1: Array) -> Array:
    """Return {B} in {W} (4, 4) at station i from {B} at station 1: the slide is rigid, it rides.

    Eqs 11-13 and 17 in their corrected form; the constant frame of {B} in {S} cancels. Nominal
    targets ride along as measured data do: data alone would lose the rail's offset, as if it were
    an error of the robot.
    """
    return T_W_Si @ inverse(T_W_S1) @ T_W_B1


class Frames:
    """Frames of a cell: measured where the log has them, nominal before."""

    def __init__(self, cell: Cell, log: Log) -> None:
        self.cell, self._log = cell, log

    def tracker_in_world(self, set_up: int | None = None) -> Array:
        """Return T_W_L (4, 4) at a set-up, or at the present one."""
        number = self._log.set_ups.number if set_up is None else set_up
        for key in (world_key(number), "world"):
            if key in self._log.frames:
                return self._log.matrix(key)
        return self.cell.tracker.pose.matrix()

    def based(self) -> bool:
        """Whether the base frame was measured."""
        return "base" in self._log.frames

    def base_in_world(self, station: Station) -> Array:
        """Return T_W_B (4, 4) at ``station``, by eq 17 where the stations are framed."""
        reference = self.cell.station_named(self.cell.grid.station)
        if not self.based():
            return self.cell.layout.nominal_base(station.rail_mm)
        base = self._log.matrix("base")
        if station.name == reference.name:
            return base
        if f"station.{station.name}" not in self._log.frames:
            shift = np.eye(4)
            travel_mm = station.strip_mm - reference.strip_mm
            shift[:3, 3] = travel_mm * np.array(self.cell.layout.rail_direction)
            return shift @ base
        return self._carried("station", station)

    def touched(self, station: Station) -> bool:
        """Whether the base was touched at ``station`` since the slide last moved."""
        frame = self._log.frames.get(f"touch.{station.name}")
        return isinstance(frame, TouchedBase) and frame.visit == self._log.visit

    def base_on_visit(self, station: Station) -> Array:
        """Return T_W_B (4, 4) as touched on this visit, else `base_in_world`.

        Commands are made with it; a target's place in {W} is never.
        """
        if self.touched(station):
            return self._log.matrix(f"touch.{station.name}")
        return self.base_in_world(station)

    def on_visit_mm(self, station: Station, targets_mm: Array) -> Array:
        """Return what the arm has to reach in {B} for targets (N, 3) of `base_in_world`'s {B}.

        In the base of this visit, by an arm that has grown since the grid was measured.
        """
        at_mm = apply(
            inverse(self.base_on_visit(station)) @ self.base_in_world(station), targets_mm
        )
        if not self.touched(station):
            return at_mm
        growth = self._log.frame(TouchedBase, f"touch.{station.name}").growth
        centre_mm = self.cell.grid.centre.matrix()[:3, 3]
        return centre_mm + (at_mm - centre_mm) / (1.0 + growth)

    def base_by_three_points(self, station: Station) -> Array:
        """Return T_W_B (4, 4) as the paper has it: {S} from three points alone."""
        return self._carried("three_points", station)

    def _carried(self, kind: str, station: Station) -> Array:
        T_W_S1 = self._log.matrix(f"{kind}.{self.cell.grid.station}")
        T_W_Si = self._log.matrix(f"{kind}.{station.name}")
        return base_at(T_W_S1, T_W_Si, self._log.matrix("base"))

    def world_from_tracker(self, xyz_mm: Array) -> Array:
        """Carry raw positions (N, 3) into {W}."""
        return apply(self.tracker_in_world(), np.atleast_2d(xyz_mm))

    def tracker_from_world(self, xyz_mm: Array) -> Array:
        """Carry positions (N, 3) in {W} into the tracker's frame."""
        T_W_L = self.tracker_in_world()
        return (np.atleast_2d(xyz_mm) - T_W_L[:3, 3]) @ T_W_L[:3, :3]


def world_from_tracker(cell: Cell, measured_mm: Array) -> Array:
    """Return T_W_L (4, 4): the three first of the floor nests (N, 3) span {W} after eqs 14-16."""
    nominal_mm = np.array([nest.xyz_mm for nest in cell.layout.floor])
    return three_point_frame(*nominal_mm[:3]) @ inverse(three_point_frame(*measured_mm[:3]))


def grid_of(cell: Cell) -> Grid:
    """Return the cell's grid in {B}; a quick plan's is as coarse as it can be."""
    size_mm, pitch_mm = np.array(cell.grid.size_mm), cell.grid.pitch_mm
    if cell.plan.quick:
        pitch_mm = coarsest_pitch_mm(cell.grid.cells, pitch_mm)
    shape = np.round(size_mm / pitch_mm).astype(int) + 1
    origin_mm = cell.grid.centre.matrix()[:3, 3] - size_mm / 2
    return Grid(origin_mm, pitch_mm, (int(shape[0]), int(shape[1]), int(shape[2])))


def grid_errors_mm(log: Log) -> Array:
    """Return the errors e = actual - nominal at the vertices, (nx, ny, nz, 3), in {B}.

    Carried with {B} they are the transferred data of eq 17 at every station.
    """
    return measured_grid(log).errors_mm


def measured_grid(log: Log) -> MeasuredGrid:
    """Return the grid's errors in {B} with the covariance of each vertex's averaged reading."""
    points, grid = log.select("grid"), grid_of(log.cell)
    i, j, k = np.array([point.id.vertex for point in points], dtype=int).reshape(-1, 3).T
    errors_mm: Array = np.full((*grid.shape, 3), np.nan)
    covariance_mm2: Array = np.full((*grid.shape, 3, 3), np.nan)
    nominal_mm, actual_mm, covariance_mm2[i, j, k] = _static(log, points)
    errors_mm[i, j, k] = actual_mm - nominal_mm
    return MeasuredGrid(grid, errors_mm, covariance_mm2)


def _static(log: Log, points: list[Point]) -> tuple[Array, Array, Array]:
    """Return nominal and actual positions (N, 3) in {B}, and the readings' covariances."""
    T_B_W = inverse(log.matrix("base"))
    T_B_L = T_B_W @ log.matrix("world")
    nominal_mm: Array = np.array([p.nominal_mm for p in points], dtype=float).reshape(-1, 3)
    actual_mm = apply(T_B_L, positions_mm(points))
    return apply(T_B_W, nominal_mm), actual_mm, covariances_mm2(points, T_B_L[:3, :3])


def measured_of(log: Log) -> Measured:
    """Return everything that the models learn from: poses as commanded, grid and free ones."""
    points = [*log.select("grid"), *log.select(ORIENTED), *log.select("pose")]
    robot, joints_rad = log.cell.robot.nominal(), commanded_rad(points)
    nominal_mm, actual_mm, covariance_mm2 = _static(log, points)
    nominal = matrix(forward(robot.arm, joints_rad)[:, :3, :3], nominal_mm)
    poses = StaticPoses.of(joints_rad, nominal, actual_mm - nominal_mm, covariance_mm2)
    curves = tuple(curve_of(record) for record in log.curves.values() if record.holds)
    seats_mm = log.cell.robot.seats_mm
    xyz_mm: Array = np.full((len(points), len(seats_mm), 3), np.nan)
    own_mm2: Array = np.full((*xyz_mm.shape, 3), np.nan)
    xyz_mm[:, 0], own_mm2[:, 0] = actual_mm, covariance_mm2
    T_B_L = inverse(log.matrix("base")) @ log.matrix("world")
    for row, point in enumerate(points):
        for n in range(1, len(seats_mm)):
            seen = log.find(point.id.at_seat(n + 1))
            if seen is not None:
                xyz_mm[row, n] = apply(T_B_L, positions_mm([seen]))[0]
                own_mm2[row, n] = covariances_mm2([seen], T_B_L[:3, :3])[0]
    readings = Readings(joints_rad, xyz_mm, np.nan_to_num(own_mm2))
    return Measured(poses, measured_grid(log), MeasuredArm(robot, readings, seats_mm, curves))


def vertex_ids(grid: Grid) -> list[PointId]:
    """Return the identities of the vertices' points in the order of visit."""
    return [PointId("grid", vertex=(int(i), int(j), int(k))) for i, j, k in grid.serpentine()]


def outlying_vertices(log: Log) -> list[PointId]:
    """Return the vertices whose error stands out from their neighbours'.

    By less than the standard deviation that a reading may have none does.
    """
    cell = log.cell
    found = outlying(grid_errors_mm(log), least_mm=cell.tracker.max_std_mm)
    return [id for id in vertex_ids(grid_of(cell)) if found[id.vertex]]


def grid_pairs(log: Log) -> Pairs:
    """Return all pairs of measured vertices: joint and Cartesian distance, error difference."""
    points = log.select("grid")
    i, j, k = np.array([point.id.vertex for point in points]).T
    nominal_mm: Array = np.array([point.nominal_mm for point in points], dtype=float)
    return similarity_pairs(commanded_rad(points), nominal_mm, grid_errors_mm(log)[i, j, k])


def frame_of_sweeps(
    cell: Cell, log: Log, swept_1: list[Point], swept_6: list[Point]
) -> tuple[Array, Circle, Circle]:
    """Return T_W_B (4, 4) and the circles of axes 1 and 6 from the points of both sweeps."""
    axis_1, axis_6 = circle_of(cell, log, 1, swept_1), circle_of(cell, log, 6, swept_6)
    return base_frame(axis_1, axis_6, axis_6_height_mm(cell)), axis_1, axis_6


def circle_of(cell: Cell, log: Log, axis: int, points: list[Point]) -> Circle:
    """Return the circle in {W} through the points of one sweep, or of a part of it."""
    begin_deg, end_deg = sweep_of(cell, axis)[1]
    turn = cell.robot.joint[axis - 1].sign * (end_deg - begin_deg)
    return fit_circle(apply(log.matrix("world"), positions_mm(points)), turn=turn)


def sweep_of(cell: Cell, axis: int) -> tuple[Six, tuple[float, float]]:
    """Return the fixed joints and the ends of axis 1's or 6's sweep, in deg."""
    table = cell.base_frame
    return {
        1: (table.axis_1_deg, table.axis_1_sweep_deg),
        6: (table.axis_6_deg, table.axis_6_sweep_deg),
    }[axis]


def axis_6_height_mm(cell: Cell) -> float:
    """Return the nominal height in {B} of the centre of axis 6's circle: a point on the axis."""
    arm = cell.robot.arm()
    on_axis = arm.tool.copy()
    on_axis[:2, 3] = 0.0
    pose = forward(replace(arm, tool=on_axis), np.radians(cell.base_frame.axis_6_deg))
    return float(pose[2, 3])
