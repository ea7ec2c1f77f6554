"""The cell drawn to scale, from above and from the side: one scale both ways."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hilcell.cell.file import Cell, Station
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
    shortened,
    svg,
    text,
)


def plan_view(cell: Cell, tracker_mm: Array, simulated: bool = False) -> str:
    """Return the cell from above: rail, stations, calibrated volumes, floor nests, tracker, {W}.

    x goes to the right and y up, as {W} has them; ``tracker_mm`` (3,) is the tracker's place
    in {W}.
    """
    return _Plan(cell, tracker_mm).svg(simulated)


def along_of(cell: Cell) -> Array:
    """Return the rail's direction (3,) in {W}; on the floor y of the base, x points to the work."""
    layout = cell.layout
    return np.array(layout.rail_direction if cell.has_rail else layout.base.matrix()[:3, 1])


class _Plan:
    WIDTH_MM, MARGIN_MM, MOST_HEIGHT_MM = 118.0, 6.0, 52.0  # on paper
    LEAST_NAME_MM, TRACKER_MM = 11.0, 6.0  # a station's name, and half the word tracker
    RAIL_WIDE_MM = 500.0  # drawn

    def __init__(self, cell: Cell, tracker_mm: Array) -> None:
        self._cell, self._tracker_mm = cell, np.asarray(tracker_mm)[:2]
        ends_mm = cell.rail.travel_min_mm, cell.rail.travel_max_mm
        self._rail_mm = np.array([cell.layout.nominal_base(at)[:2, 3] for at in ends_mm])
        self._floor = [(nest.name, nest.xyz_mm[:2]) for nest in cell.layout.floor]
        shown: list[Array] = [
            self._rail_corners(),
            self._tracker_mm[None],
            *(at_mm[None] for _, at_mm in self._floor),
            *(self._volume_mm(station) for station in cell.station),
        ]
        every = np.concatenate(shown)
        self._low_mm, high_mm = every.min(axis=0), every.max(axis=0)
        span_mm = np.maximum(high_mm - self._low_mm, 1000.0)
        room = np.array([self.WIDTH_MM, self.MOST_HEIGHT_MM]) - 2 * self.MARGIN_MM
        self._scale = float((room / span_mm).min())
        self._height = float(span_mm[1]) * self._scale + 2 * self.MARGIN_MM

    def svg(self, simulated: bool) -> str:
        parts = [
            *self._rail(), *self._volumes(), *self._nests(), *self._tracker(), *self._bar(),
        ]  # fmt: skip
        where = "rail, stations, volumes" if self._cell.has_rail else "robot, volume"
        title = f"The cell in plan view: {where}, tracker"
        return svg(self.WIDTH_MM, round(self._height, 2), title, parts, simulated)

    def _at(self, xy_mm: Array) -> tuple[float, float]:
        """Return a place of {W} on paper."""
        x, y = (np.asarray(xy_mm) - self._low_mm) * self._scale + self.MARGIN_MM
        return float(x), self._height - float(y)

    def _volume_mm(self, station: Station) -> Array:
        """Return the corners (4, 2) of a station's volume in {W}."""
        grid = self._cell.grid
        half = np.array(grid.size_mm)[:2] / 2
        x, y, z = grid.centre.x_mm, grid.centre.y_mm, grid.centre.z_mm
        signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
        corners = [(x + one * half[0], y + other * half[1], z) for one, other in signs]
        return apply(self._cell.layout.nominal_base(station.rail_mm), corners)[:, :2]

    def _across(self) -> Array:
        """Return half the rail's width (2,) as drawn, square to its direction."""
        along = along_of(self._cell)[:2]
        return np.array([-along[1], along[0]]) * self.RAIL_WIDE_MM / 2

    def _rail_corners(self) -> Array:
        (begin, end), across = self._rail_mm, self._across()
        if not self._cell.has_rail:  # a pedestal
            half = along_of(self._cell)[:2] * self.RAIL_WIDE_MM / 2
            begin, end = begin - half, end + half
        return np.array([begin + across, end + across, end - across, begin - across])

    def _rail(self) -> Iterator[str]:
        across = self._across()
        yield self._area(self._rail_corners(), MUTED, "#eef3f8")
        for station in self._cell.station:
            at = self._cell.layout.nominal_base(station.rail_mm)[:2, 3]
            yield self._line(at - across, at + across)
            bold = station.name == self._cell.grid.station
            x, y = self._at(at)
            if bold:
                yield circle(x, y, 1.6, "#fff", INK)
            beside = self._rail_corners() if not self._cell.has_rail else (at + across, at - across)
            right = max(self._at(corner)[0] for corner in beside)
            yield self._name(station, right, y + 0.9, INK, bold)

    def _volumes(self) -> Iterator[str]:
        for station in self._cell.station:
            corners_mm = self._volume_mm(station)
            own = station.name == self._cell.grid.station
            yield self._area(corners_mm, AFTER, *((f"{BAND}99",) if own else ("none", "1.2 0.8")))
            right = max(self._at(corner)[0] for corner in corners_mm)
            top = min(self._at(corner)[1] for corner in corners_mm)
            y = top + 2.0 if own else self._at(corners_mm.mean(axis=0))[1] + 0.9
            yield self._name(station, right, y, AFTER, own)
        middle_mm = self._volume_mm(self._cell.reference).mean(axis=0)
        yield self._line(self._tracker_mm, middle_mm, colour=MUTED, dash="0.5 0.8")

    def _name(self, station: Station, right: float, y: float, colour: str, bold: bool) -> str:
        """Return a station's name, as wide as there is room to the next volume or the tracker."""
        x = right + 0.8
        begins = [
            min(self._at(corner)[0] for corner in self._volume_mm(station))
            for station in self._cell.station
        ]
        ends = (*begins, self._at(self._tracker_mm)[0] - self.TRACKER_MM, self.WIDTH_MM)
        room_mm = max(min(end - x for end in ends if end > x) - 0.8, self.LEAST_NAME_MM)
        return text(x, y, shortened(station.name, room_mm), "start", colour, bold, room_mm)

    def _nests(self) -> Iterator[str]:
        for name, at_mm in self._floor:
            x, y = self._at(at_mm)
            yield circle(x, y, 0.8, "#fff", INK)
            yield text(x + 1.3, y - 0.8, name)
        if not self._floor:
            return
        origin = self._floor[0][1]
        for axis, direction in (("x", (1.0, 0.0)), ("y", (0.0, 1.0))):
            end = origin + np.array(direction) * 5.5 / self._scale
            yield self._line(origin, end, wide=0.4)
            x, y = self._at(end)
            yield text(x + 0.5, y + 2.6 * (axis == "x"), axis)

    def _tracker(self) -> Iterator[str]:
        x, y = self._at(self._tracker_mm)
        top, right, left = (x, y - 1.8), (x + 1.7, y + 1.2), (x - 1.7, y + 1.2)
        yield path([top, right, left, top], INK, 0.4, fill="#fff")
        yield text(x, y - 2.6, "tracker", "middle", bold=True)

    def _bar(self) -> Iterator[str]:
        y, begin = self._height - 1.5, self.WIDTH_MM - self.MARGIN_MM - 1000.0 * self._scale
        yield path([(begin, y), (self.WIDTH_MM - self.MARGIN_MM, y)], INK, 0.6)
        yield text(begin - 1.0, y + 0.9, "1 m", "end")

    def _line(self, *places_mm: Array, colour: str = INK, wide: float = 0.3, dash: str = "") -> str:
        return path([self._at(each) for each in places_mm], colour, wide, dash)

    def _area(self, corners_mm: Array, colour: str, fill: str, dash: str = "") -> str:
        corners = [self._at(each) for each in (*corners_mm, corners_mm[0])]
        return path(corners, colour, dash=dash, fill=fill)


def side_view(cell: Cell, tracker_mm: Array, simulated: bool) -> str:
    """Return the cell looked at along the rail, z up.

    ``tracker_mm`` (3,) is the tracker's place in {W}.
    """
    along = along_of(cell)
    across = np.array([along[1], -along[0], 0.0])
    station = cell.reference
    T = cell.layout.nominal_base(station.rail_mm)
    half, centre = np.array(cell.grid.size_mm) / 2, cell.grid.centre.matrix()[:3, 3]
    corners = [centre - half * (1, 0, 1), centre + half * (1, 0, 1)]
    seen = np.array([[across @ each, each[2]] for each in apply(T, corners)])
    volume = np.array([seen.min(axis=0), seen.max(axis=0)])
    robot, tracker = (np.array([across @ at_mm, at_mm[2]]) for at_mm in (T[:3, 3], tracker_mm))
    floor = min((float(nest.xyz_mm[2]) for nest in cell.layout.floor), default=0.0)
    return _Side(volume, robot, tracker, floor).svg(simulated)


class _Side:
    WIDTH_MM, MARGIN_MM, MOST_HEIGHT_MM = 58.0, 4.0, 42.0  # on paper
    TRACKER_MM, HEIGHTS_MM = 9.0, 13.0  # half the label of the tracker; labels of the heights
    FOOT_MM, SHOULDER_MM = 250.0, 700.0  # half the robot's foot, and its height, as drawn

    def __init__(self, volume: Array, robot: Array, tracker: Array, floor: float) -> None:
        self._volume, self._robot, self._tracker, self._floor = volume, robot, tracker, floor
        reach = robot + np.array([[-self.FOOT_MM, 0.0], [self.FOOT_MM, self.SHOULDER_MM]])
        every = np.vstack([volume, reach, tracker[None], [[robot[0], floor]]])
        self._low, high = every.min(axis=0), every.max(axis=0)
        room = np.array([self.WIDTH_MM, self.MOST_HEIGHT_MM]) - self.MARGIN_MM * np.array([2, 3])
        self._scale = float((room / (high - self._low)).min())
        self._height = float((high - self._low)[1]) * self._scale + 3 * self.MARGIN_MM

    def _at(self, place: Array | list[float]) -> tuple[float, float]:
        x, y = (np.asarray(place) - self._low) * self._scale
        return float(x) + self.MARGIN_MM, self._height - self.MARGIN_MM - float(y)

    def svg(self, simulated: bool) -> str:
        parts = [*self._robot_drawn(), *self._volume_drawn(), *self._tracker_drawn()]
        size = self.WIDTH_MM, round(self._height, 2)
        return svg(*size, "The cell from the side", parts, simulated)

    def _robot_drawn(self) -> Iterator[str]:
        (left, top), (right, low) = (
            self._at([self._robot[0] + sign * self.FOOT_MM, z])
            for sign, z in ((-1, self._robot[1]), (1, self._floor))
        )
        yield rectangle(left, top, right - left, low - top, "#eef3f8", MUTED)
        shoulder = self._robot + np.array([0.0, self.SHOULDER_MM])
        middle = np.array([self._volume[:, 0].mean(), self._volume[:, 1].mean()])
        elbow = (shoulder + middle) / 2 + np.array([0.0, self.SHOULDER_MM / 2])
        arm = [self._at(each) for each in (self._robot, shoulder, elbow, middle)]
        yield path(arm, MUTED, 1.4)
        yield path([(self.MARGIN_MM / 2, low), (self.WIDTH_MM - self.MARGIN_MM / 2, low)], INK, 0.5)
        yield text(self.WIDTH_MM / 2, low + 3.4, f"floor, z {self._floor:.0f}", "middle", MUTED)

    def _volume_drawn(self) -> Iterator[str]:
        (left, low), (right, top) = self._at(self._volume[0]), self._at(self._volume[1])
        left, right = sorted((left, right))
        yield rectangle(left, top, right - left, low - top, BAND, AFTER)
        covered = -self.TRACKER_MM < self._word_x() - right < self.TRACKER_MM + self.HEIGHTS_MM
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
        x, _ = self._at(self._tracker)
        return min(max(x, self.TRACKER_MM), self.WIDTH_MM - self.TRACKER_MM)
