"""From holes to stations and orders of visit, after the paper's section 2.

As few stations as reach all holes; each hole belongs to the closest station that reaches it. Travel
counts between the holes of one station; between stations the robot is at its safe pose.

A hole is reached in the cell's configuration, for which its errors are known, with margin to the
joints' limits. The tracker must measure it from any station, so range depends on the hole alone.
Where holes are planned for a calibration, its `Volume` gives the poses that `compensate` corrects
at each station.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hilcell.calibration.file import Calibration
from hilcell.cell.file import Cell, Station
from hilcell.compensation.grid import ROUNDING_MM
from hilcell.compensation.targets import unit_hint
from hilcell.errors import MAX_LISTED, indented
from hilcell.geometry.frames import inverse, zyx_from_pose
from hilcell.geometry.kinematics import Array, Bools, Ints
from hilcell.geometry.statistics import lengths_mm
from hilcell.ports import HilcellError
from hilcell.programs.holes import Holes
from hilcell.programs.route import route
from hilcell.sanitize import counted


@dataclass(frozen=True, slots=True)
class StationPlan:
    """Holes of one station in order, poses (N, 6) in {W} for them, travel and its lower bound."""

    station: Station
    holes: list[str]
    poses: Array
    travel_mm: float
    travel_bound_mm: float


@dataclass(frozen=True, slots=True)
class HolePlan:
    """Stations in order of visit."""

    stations: list[StationPlan]

    @property
    def travel_mm(self) -> float:
        return sum(each.travel_mm for each in self.stations)

    @property
    def travel_bound_mm(self) -> float:
        return sum(each.travel_bound_mm for each in self.stations)


def ratio(travel_mm: float, bound_mm: float) -> float:
    """Travel over bound, 1 where nothing is travelled."""
    return travel_mm / bound_mm if bound_mm > 0 else 1.0


def plan(
    cell: Cell,
    holes: Holes,
    *,
    free: bool = False,
    calibrated: Volume | None = None,
    say: Callable[[str], object] = lambda words: None,
) -> HolePlan:
    """Plan the holes at recorded stations; ``free`` adds a raster along the travel.

    With ``calibrated`` each hole is drilled at a station, and with a rotation of the tool, where it
    is corrected. ``say`` reports each step of a long plan. Raises `HilcellError`.
    """
    slow_holes = 500  # whose plan takes seconds
    candidates = [*cell.station, *(_raster(cell) if free else ())]
    if calibrated is not None:
        candidates = [each for each in candidates if each.name in calibrated.stations]
        for station in candidates:
            holes = holes.with_rotation_near(calibrated.orientation(station.name))
    slow = len(holes.names) >= slow_holes
    if slow:
        say(f"planning {counted(len(holes.names), 'hole')}: where they are reached")
    reached = Reach(cell, holes, candidates, calibrated)
    new = np.array([station not in cell.station for station in candidates])
    chosen = fewest(reached.ok, (new + reached.remoteness) / 2)
    closest = np.where(reached.ok[:, chosen], reached.off_mm[:, chosen], np.inf).argmin(axis=1)
    owner = chosen[closest]
    order = along_rail({each: candidates[each].rail_mm for each in owner.tolist()})
    stations = []
    for each in order:
        own = np.flatnonzero(owner == each)
        if slow:
            say(f"{candidates[each].name}: the order of {counted(len(own), 'hole')}")
        stations.append(reached.planned(each, own))
    return HolePlan(stations)


def along_rail(rail_mm: dict[int, float]) -> list[int]:
    """Keys in one sweep, from the end nearer to 0, where homing leaves the slide."""
    order = sorted(rail_mm, key=lambda each: rail_mm[each])
    if abs(rail_mm[order[-1]]) < abs(rail_mm[order[0]]):
        order.reverse()
    return order


def _raster(cell: Cell) -> Iterator[Station]:
    """Free stations along the rail, beside the recorded ones."""
    raster_mm, travel_mm = 50.0, cell.rail.travel_max_mm
    low = np.ceil((cell.rail.travel_min_mm + cell.rail.back_off_mm) / raster_mm)
    known = {station.rail_mm for station in cell.station}
    for rail_mm in (raster_mm * np.arange(low, np.floor(travel_mm / raster_mm) + 1)).tolist():
        if rail_mm not in known:
            yield Station(name=f"at {rail_mm:g} mm", rail_mm=rail_mm, strip_mm=rail_mm)


def fewest(ok: Bools, penalty: Array) -> Ints:
    """Columns of ``ok`` (N, S), as few as possible, that reach every row.

    ``penalty`` (S,), 0..1 each, decides only between sets of equal number: its sum is scaled below
    one station. Raises `HilcellError` where a row is reached by none.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp  # slow to load, seldom needed

    rows = np.unique(ok, axis=0)
    if not rows.any(axis=1).all():
        raise HilcellError("set cover: some holes are reached from no station", code="HC-C10")
    cost = 1.0 + penalty / (2.0 * len(penalty))
    found = milp(
        cost,
        constraints=LinearConstraint(rows.astype(float), lb=1.0),
        integrality=np.ones(len(cost), dtype=int),
        bounds=Bounds(0, 1),
        options={"mip_rel_gap": 0.0},
    )
    chosen = np.flatnonzero(found.x > 0.5) if found.x is not None else np.array([], dtype=int)
    if not ok[:, chosen].any(axis=1).all():
        raise HilcellError(f"set cover: not solved: {found.message}", code="HC-C10")
    return chosen


class Reach:
    """N holes against S stations: from which ones each hole is reached, seen and corrected.

    ``ok`` (N, S); ``turn`` (N, S): the rotation of the tool with most margin; ``off_mm`` (N, S):
    distance of the hole from the station along the rail.
    """

    def __init__(
        self, cell: Cell, holes: Holes, stations: Sequence[Station], served: Volume | None = None
    ) -> None:
        """``served``: corrected poses. Raises `HilcellError` with reasons for unreached holes."""
        self._cell, self._holes, self._stations, self._served = cell, holes, stations, served
        self._robot, self._limits_rad = cell.robot.nominal(), cell.robot.margin_limits_rad
        self._poses = holes.reflector_poses()
        tracker = cell.tracker  # a reflector may be found anywhere within a radius
        self._low_mm = tracker.min_range_mm + tracker.find_radius_mm
        self._high_mm = tracker.max_range_mm - tracker.find_radius_mm
        self._range_mm = lengths_mm(holes.points_mm - tracker.pose.matrix()[:3, 3])
        self._in_range = (self._range_mm >= self._low_mm) & (self._range_mm <= self._high_mm)
        room_rad = np.empty((len(holes.names), len(stations)))
        self.turn: Ints = np.empty(room_rad.shape, dtype=int)
        for number, station in enumerate(stations):
            room = self._room_rad(self._in_base(station, self._poses))
            if served is not None:
                room = np.where(served.takes(station.name, self._poses), room, -np.inf)
            self.turn[:, number] = room.argmax(axis=1)
            room_rad[:, number] = room.max(axis=1)
        self.ok: Bools = (room_rad >= 0.0) & self._in_range[:, None]
        from_start_mm = holes.points_mm - cell.layout.nominal_base(0.0)[:3, 3]
        along_mm = from_start_mm @ np.array(cell.layout.rail_direction)
        rail_mm = np.array([station.rail_mm for station in stations])
        self.off_mm: Array = np.abs(along_mm[:, None] - rail_mm)
        self._refuse_unreached()

    @property
    def remoteness(self) -> Array:
        """Remoteness of the holes that each station reaches, (S,), 0..1."""
        count = self.ok.sum(axis=0)
        mean_mm = np.where(self.ok, self.off_mm, 0.0).sum(axis=0) / np.maximum(count, 1)
        return np.where(count > 0, mean_mm / max(float(self.off_mm.max()), 1.0), 1.0)

    def planned(self, column: int, own: Ints) -> StationPlan:
        """Plan of a station for its holes, both by number."""
        found = route(self._holes.points_mm[own])
        visit = own[found.order]
        poses = self._holes.poses()[visit, self.turn[visit, column]]
        names = [self._holes.names[each] for each in visit]
        return StationPlan(
            self._stations[column],
            names,
            zyx_from_pose(poses),
            found.travel_mm,
            found.travel_bound_mm,
        )

    def _in_base(self, station: Station, poses: Array) -> Array:
        return inverse(self._cell.layout.nominal_base(station.rail_mm)) @ poses

    def _room_rad(self, poses: Array) -> Array:
        """Margin to a joint limit or straight wrist at poses in {B}; -inf out of reach."""
        low_rad, high_rad = self._limits_rad
        room = np.full(poses.shape[:-2], -np.inf)
        there = self._robot.excess_mm(poses) == 0
        joints = self._robot.nearest(poses[there])
        inside = np.minimum(joints - low_rad, high_rad - joints).min(axis=-1)
        room[there] = np.where(inside >= 0, np.minimum(inside, np.abs(joints[:, 4])), inside)
        return room

    def _refuse_unreached(self) -> None:
        bad = np.flatnonzero(~self.ok.any(axis=1)).tolist()
        if not bad:
            return
        holes, stations = self._holes, self._stations
        why = (f"{holes.names[n]}: {self._why_not(n)}" for n in bad[:MAX_LISTED])
        named = indented(why, len(bad))
        places = stations[0].name if len(stations) == 1 else f"any of {len(stations)} stations"
        hint = unit_hint(holes.points_mm) if len(bad) == len(self.ok) else ""
        raise HilcellError(
            f"{len(bad)} of {counted(len(self.ok), 'hole')} cannot be drilled from {places} in the "
            f"robot's posture (robot.status = {self._cell.robot.status}):\n{named}\n"
            f"{self._act(bad)}{hint}",
            code="HC-C10",
        )

    def _act(self, bad: list[int]) -> str:
        if self._served is None:
            return (
                "move the part or the tracker, try --free stations, or another posture: --set "
                "robot.status=N, 0 to 7"
            )
        if all(self._points_back(n) for n in bad):
            return "nx, ny, nz of a list of holes point out of the part, against the tool's z"
        return (
            "move or turn the part, move the tracker, or calibrate a larger volume or in another "
            "posture (robot.status)"
        )

    def _points_back(self, n: int) -> bool:
        names = [each.name for each in self._stations]
        return self._served is not None and self._served.points_back(names, self._poses[n])

    def _why_not(self, n: int) -> str:
        """Why one hole is drilled from no station: out of reach, or not corrected there."""
        if self._points_back(n):
            return "its normal points into the part: turn it"
        if not self._in_range[n]:
            return (
                f"tracker range {self._range_mm[n]:.0f} mm, expected {self._low_mm:.0f} .. "
                f"{self._high_mm:.0f} mm"
            )
        stations = self._stations
        poses = np.stack([self._in_base(station, self._poses[n]) for station in stations])
        room = self._room_rad(poses)
        if self._served is not None and (room >= 0.0).any():
            best_rad = zip(stations, room.max(axis=1).tolist(), strict=True)
            names = [station.name for station, rad in best_rad if rad >= 0.0]
            return self._served.refusal(names, self._poses[n])
        excess_mm = self._robot.excess_mm(poses)
        if excess_mm.min() > 0:
            at = int(excess_mm.min(axis=1).argmin())
            return f"out of reach by {excess_mm.min():.1f} mm at {stations[at].name}"
        best = int(room.argmax())
        joints = self._robot.nearest(poses.reshape(-1, 4, 4)[best])
        low_rad, high_rad = self._limits_rad
        worst = int(np.minimum(joints - low_rad, high_rad - joints).argmin())
        low, high = np.degrees(self._limits_rad[:, worst])
        return (
            f"joint limit: A{worst + 1} at {np.degrees(joints[worst]):.2f} deg, expected {low:.2f} "
            f".. {high:.2f} deg, {np.degrees(-room.max()):.2f} deg beyond, at "
            f"{stations[best // room.shape[1]].name}"
        )


class Volume:
    """The calibrated poses, at each station."""

    ROUNDING_DEG = 1e-4  # of angles in a file: a planned target stays inside when it is read again

    def __init__(self, calibration: Calibration) -> None:
        self._grid = calibration.grid()
        self._validity = calibration.validity
        self._bases = {name: np.array(each.T_W_B) for name, each in calibration.stations.items()}

    @property
    def stations(self) -> list[str]:
        return list(self._bases)

    def orientation(self, station: str) -> Array:
        """The calibrated orientation (3, 3) in {W} at a station."""
        return np.asarray(self._bases[station][:3, :3] @ np.array(self._validity.orientation))

    def takes(self, station: str, poses: Array) -> Bools:
        """Which poses (..., 4, 4) in {W} are corrected at a station."""
        outside_mm, turned_deg = self._beyond(station, poses.reshape(-1, 4, 4))
        limit_deg = self._validity.orientation_tolerance_deg - self.ROUNDING_DEG
        taken: Bools = (outside_mm <= 0.0) & (turned_deg <= limit_deg)
        return taken.reshape(poses.shape[:-2])

    def points_back(self, stations: Sequence[str], poses: Array) -> bool:
        """Whether all poses (K, 4, 4) in {W} have z opposite to every calibrated one's at a
        station.
        """
        bases = (self._bases[name] for name in stations if name in self._bases)
        return any(bool(self._validity.points_back(inverse(T) @ poses).all()) for T in bases)

    def refusal(self, stations: Sequence[str], poses: Array) -> str:
        """Why none of poses (K, 4, 4) in {W} is corrected, for the nearest one."""
        known = [name for name in stations if name in self._bases]
        if not known:
            return f"none of its stations is calibrated; calibrated: {', '.join(self._bases)}"
        limit_deg = self._validity.orientation_tolerance_deg
        missing = list[tuple[float, float, str]]()
        for name in known:
            outside_mm, turned_deg = self._beyond(name, poses)
            turned_deg = np.maximum(turned_deg, limit_deg - self.ROUNDING_DEG)
            missing += (
                (*each, name) for each in zip(turned_deg.tolist(), outside_mm.tolist(), strict=True)
            )
        turned, off_mm, at = min(missing, key=lambda each: (round(each[0]), each[1], each[0]))
        outside = f"outside the calibrated volume by {off_mm:.1f} mm at {at}"
        if turned <= limit_deg - self.ROUNDING_DEG:
            return outside
        return (
            f"the flange would be turned by {turned:.2f} deg from the calibrated orientation at "
            f"{at}, expected at most {limit_deg:g} deg; calibrate with plan.tilt_deg or "
            f"plan.grid_orientations{f'; {outside}' if off_mm > 0.0 else ''}"
        )

    def _beyond(self, station: str, poses: Array) -> tuple[Array, Array]:
        """Distance outside (mm, 0 inside) and rotation (deg) of poses (N, 4, 4), each (N,)."""
        in_base = inverse(self._bases[station]) @ poses
        places_mm = in_base[:, :3, 3]
        outside_mm = lengths_mm(places_mm - self._grid.clamped(places_mm))
        outside_mm[outside_mm <= ROUNDING_MM] = 0.0
        return outside_mm, self._validity.turned_deg(in_base)
