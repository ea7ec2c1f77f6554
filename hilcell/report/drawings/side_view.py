"""The cell from the side, to scale: looked along the rail, z up."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hilcell.cell.file import Cell
from hilcell.geometry.frames import apply
from hilcell.ports import Array
from hilcell.report.drawings.drawing import (
    AFTER,
    BAND,
    INK,
    MUTED,
    circle,
    path,
    rectangle,
    svg,
    text,
)
from hilcell.report.drawings.plan_view import along_of

WIDTH_MM, MARGIN_MM, MOST_HEIGHT_MM = 58.0, 4.0, 42.0
TRACKER_MM, HEIGHTS_MM = 9.0, 13.0  # on paper: half the word, and the words of the heights
FOOT_MM, SHOULDER_MM = 250.0, 700.0  # half the robot's foot, and its height, as drawn


def side_view(cell: Cell, tracker_mm: Array, simulated: bool) -> str:
    """Return the drawing; ``tracker_mm`` (3,) is where the tracker stands in {W}."""
    along = along_of(cell)
    across = np.array([along[1], -along[0], 0.0])
    station = cell.station_named(cell.grid.station)
    T = cell.layout.nominal_base(station.rail_mm)
    half, centre = np.array(cell.grid.size_mm) / 2, cell.grid.centre.matrix()[:3, 3]
    corners = [centre - half * (1, 0, 1), centre + half * (1, 0, 1)]
    seen = np.array([[across @ each, each[2]] for each in apply(T, corners)])
    volume = np.array([seen.min(axis=0), seen.max(axis=0)])
    robot = np.array([across @ T[:3, 3], T[2, 3]])
    tracker = np.array([across @ tracker_mm, tracker_mm[2]])
    floor = min((float(nest.xyz_mm[2]) for nest in cell.layout.floor), default=0.0)
    return _Side(volume, robot, tracker, floor).svg(simulated)


class _Side:
    def __init__(self, volume: Array, robot: Array, tracker: Array, floor: float) -> None:
        self._volume, self._robot, self._tracker, self._floor = volume, robot, tracker, floor
        reach = robot + np.array([[-FOOT_MM, 0.0], [FOOT_MM, SHOULDER_MM]])
        every = np.vstack([volume, reach, tracker[None], [[robot[0], floor]]])
        self._low, high = every.min(axis=0), every.max(axis=0)
        room = np.array([WIDTH_MM - 2 * MARGIN_MM, MOST_HEIGHT_MM - 3 * MARGIN_MM])
        self._scale = float((room / (high - self._low)).min())
        self._height = float((high - self._low)[1]) * self._scale + 3 * MARGIN_MM

    def _at(self, place: Array | list[float]) -> tuple[float, float]:
        x, y = (np.asarray(place) - self._low) * self._scale
        return float(x) + MARGIN_MM, self._height - MARGIN_MM - float(y)

    def svg(self, simulated: bool) -> str:
        parts = [*self._robot_drawn(), *self._volume_drawn(), *self._tracker_drawn()]
        return svg(WIDTH_MM, round(self._height, 2), "The cell from the side", parts, simulated)

    def _robot_drawn(self) -> Iterator[str]:
        (left, top), (right, low) = (
            self._at([self._robot[0] + sign * FOOT_MM, z])
            for sign, z in ((-1, self._robot[1]), (1, self._floor))
        )
        yield rectangle(left, top, right - left, low - top, "#eef3f8", MUTED)
        shoulder = self._robot + np.array([0.0, SHOULDER_MM])
        middle = np.array([self._volume[:, 0].mean(), self._volume[:, 1].mean()])
        elbow = (shoulder + middle) / 2 + np.array([0.0, SHOULDER_MM / 2])
        arm = [self._at(each) for each in (self._robot, shoulder, elbow, middle)]
        yield path(arm, MUTED, 1.4)
        yield path([(MARGIN_MM / 2, low), (WIDTH_MM - MARGIN_MM / 2, low)], INK, 0.5)
        yield text(WIDTH_MM / 2, low + 3.4, f"floor, z {self._floor:.0f}", "middle", MUTED)

    def _volume_drawn(self) -> Iterator[str]:
        (left, low), (right, top) = self._at(self._volume[0]), self._at(self._volume[1])
        left, right = sorted((left, right))
        yield rectangle(left, top, right - left, low - top, BAND, AFTER)
        covered = -TRACKER_MM < self._word_x() - right < TRACKER_MM + HEIGHTS_MM
        x, anchor = (left - 1.0, "end") if covered else (right + 1.0, "start")
        for z, y in ((self._volume[1][1], top + 1.0), (self._volume[0][1], low + 1.0)):
            yield text(x, y, f"z {z:.0f}", anchor, MUTED)

    def _tracker_drawn(self) -> Iterator[str]:
        x, y = self._at(self._tracker)
        low = self._at([self._tracker[0], self._floor])[1]
        yield path([(x - 1.6, low), (x, y), (x + 1.6, low)], INK, 0.4)
        yield circle(x, y, 1.1, "#fff", INK)
        yield text(self._word_x(), y - 2.2, "tracker", "middle", bold=True)

    def _word_x(self) -> float:
        """Return where the middle of the tracker's name stands, inside the drawing."""
        return min(max(self._at(self._tracker)[0], TRACKER_MM), WIDTH_MM - TRACKER_MM)
