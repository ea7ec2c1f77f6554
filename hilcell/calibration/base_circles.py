"""The circles of axes 1 and 6 that define {B}, from a run's log."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hilcell.cell.file import Cell, Six
from hilcell.geometry.circles import Circle, base_frame, fit_circle
from hilcell.geometry.frames import apply
from hilcell.geometry.kinematics import forward
from hilcell.journal.log import Log, positions_mm
from hilcell.model.point import Point
from hilcell.ports import Array


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
