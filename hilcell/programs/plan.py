"""From holes to stations and orders of visit, after the paper's section 2.

As few stations as reach all holes; each hole belongs to the closest station that reaches it. Travel
counts between the holes of one station; between stations the robot is at its safe pose.

A hole is reached in the cell's configuration, for which its errors are known, with margin to the
joints' limits. The tracker must measure it from any station, so range depends on the hole alone.
Where holes are planned for a calibration, its `Volume` gives the poses that `compensate` corrects
at each station.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
    bound_mm: float


@dataclass(frozen=True, slots=True)
class HolePlan:
    """Stations in order of visit."""

    stations: list[StationPlan]

    @property
    def travel_mm(self) -> float:
        return sum(each.travel_mm for each in self.stations)

    @property
    def bound_mm(self) -> float:
        return sum(each.bound_mm for each in self.stations)


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
    candidates = _candidates(cell, free=free)
    if calibrated is not None:
        candidates = [each for each in candidates if each.name in calibrated.stations]
        for station in candidates:
            holes = holes.with_rotation_near(calibrated.orientation(station.name))
    slow = len(holes.names) >= slow_holes
    if slow:
        say(f"planning {counted(len(holes.names), 'hole')}: where they are reached")
    reached = reach(cell, holes, candidates, calibrated)
    off_mm = _off_mm(cell, holes, candidates)
    new = np.array([station not in cell.station for station in candidates])
    chosen = fewest(reached.ok, (new + _remoteness(off_mm, reached.ok)) / 2)
    closest = np.where(reached.ok[:, chosen], off_mm[:, chosen], np.inf).argmin(axis=1)
    owner = chosen[closest]
    order = along_rail({each: candidates[each].rail_mm for each in owner.tolist()})
    stations = []
    for each in order:
        if slow:
            count = int((owner == each).sum())
            say(f"{candidates[each].name}: the order of {counted(count, 'hole')}")
        stations.append(_at_station(holes, reached, candidates[each], each, owner))
    return HolePlan(stations)


def along_rail(rail_mm: dict[int, float]) -> list[int]:
    """Keys in one sweep, from the end nearer to 0, where homing leaves the slide."""
    order = sorted(rail_mm, key=lambda each: rail_mm[each])
    if abs(rail_mm[order[-1]]) < abs(rail_mm[order[0]]):
        order.reverse()
    return order


def _candidates(cell: Cell, *, free: bool) -> list[Station]:
    raster_mm = 50.0  # of free stations along the rail
    recorded = list(cell.station)
    if not free:
        return recorded
    low = cell.rail.travel_min_mm + cell.rail.back_off_mm
    raster = raster_mm * np.arange(
        np.ceil(low / raster_mm), np.floor(cell.rail.travel_max_mm / raster_mm) + 1
    )
    known = {station.rail_mm for station in recorded}
    return recorded + [
        Station(name=f"at {rail_mm:g} mm", rail_mm=rail_mm, strip_mm=rail_mm)
        for rail_mm in raster.tolist()
        if rail_mm not in known
    ]


def _off_mm(cell: Cell, holes: Holes, stations: list[Station]) -> Array:
    """Distance of each hole from each station along the rail, (N, S)."""
    from_start = holes.points_mm - cell.layout.nominal_base(0.0)[:3, 3]
    along_mm = from_start @ np.array(cell.layout.rail_direction)
    rail_mm = np.array([station.rail_mm for station in stations])
    return np.asarray(np.abs(along_mm[:, None] - rail_mm))


def _remoteness(off_mm: Array, ok: Bools) -> Array:
    """Remoteness of the holes that each station reaches, (S,), 0..1."""
    count = ok.sum(axis=0)
    mean_mm = np.where(ok, off_mm, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.where(count > 0, mean_mm / max(float(off_mm.max()), 1.0), 1.0)


def _at_station(
    holes: Holes, reached: Reach, station: Station, column: int, owner: Ints
) -> StationPlan:
    own = np.flatnonzero(owner == column)
    found = route(holes.points_mm[own])
    visit = own[found.order]
    poses = holes.poses()[visit, reached.turn[visit, column]]
    return StationPlan(
        station,
        [holes.names[each] for each in visit],
        zyx_from_pose(poses),
        found.travel_mm,
        found.bound_mm,
    )


def fewest(ok: Bools, burden: Array) -> Ints:
    """Columns of ``ok`` (N, S), as few as possible, that reach every row.

    ``burden`` (S,), 0..1 each, decides only between sets of equal number: its sum is scaled below
    one station. Raises `HilcellError` where a row is reached by none.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp  # slow to load, seldom needed

    rows = np.unique(ok, axis=0)
    if not rows.any(axis=1).all():
        raise HilcellError("set cover: some holes are reached from no station", code="HC-C10")
    cost = 1.0 + burden / (2.0 * len(burden))
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


@dataclass(frozen=True, slots=True)
class Reach:
    """Holes against stations, each (N, S): ``ok``, and the rotation of the tool with most
    margin.
    """

    ok: Bools
    turn: Ints


def reach(
    cell: Cell, holes: Holes, stations: Sequence[Station], served: Volume | None = None
) -> Reach:
    """Holes that each station reaches and corrects; raises `HilcellError` with reasons."""
    room_rad = np.empty((len(holes.names), len(stations)))
    turn = np.empty(room_rad.shape, dtype=int)
    poses = holes.reflector_poses()
    for number, station in enumerate(stations):
        room = _room_rad(cell, _in_base(cell, station, poses))
        if served is not None:
            room = np.where(served.takes(station.name, poses), room, -np.inf)
        turn[:, number] = room.argmax(axis=1)
        room_rad[:, number] = room.max(axis=1)
    ok = (room_rad >= 0.0) & _in_range(cell, holes)[:, None]
    _Unreached(cell, holes, stations, served).refuse(ok)
    return Reach(ok, turn)


def _in_base(cell: Cell, station: Station, poses: Array) -> Array:
    return inverse(cell.layout.nominal_base(station.rail_mm)) @ poses


def _room_rad(cell: Cell, poses: Array) -> Array:
    """Margin to a joint limit or straight wrist at poses in {B}; -inf out of reach."""
    robot, limits = cell.robot.nominal(), cell.robot.margin_limits_rad
    room = np.full(poses.shape[:-2], -np.inf)
    there = robot.excess_mm(poses) == 0
    joints = robot.nearest(poses[there])
    inside = np.minimum(joints - limits[0], limits[1] - joints).min(axis=-1)
    room[there] = np.where(inside >= 0, np.minimum(inside, np.abs(joints[:, 4])), inside)
    return room


def _range_mm(cell: Cell, holes: Holes) -> Array:
    return np.asarray(np.linalg.norm(holes.points_mm - cell.tracker.pose.matrix()[:3, 3], axis=1))


def _range_limits_mm(cell: Cell) -> tuple[float, float]:
    """Return the tracker's limits less the radius within which it may find a reflector."""
    margin = cell.tracker.find_radius_mm
    return cell.tracker.min_range_mm + margin, cell.tracker.max_range_mm - margin


def _in_range(cell: Cell, holes: Holes) -> Bools:
    range_mm, (low, high) = _range_mm(cell, holes), _range_limits_mm(cell)
    return (range_mm >= low) & (range_mm <= high)


@dataclass(frozen=True, slots=True)
class _Unreached:
    """Reasons why holes are drilled from no station; ``served``: corrected poses."""

    cell: Cell
    holes: Holes
    stations: Sequence[Station]
    served: Volume | None

    def refuse(self, ok: Bools) -> None:
        """Raise `HilcellError` with reasons where a hole is reached (N, S) from no station."""
        holes, stations = self.holes, self.stations
        bad = np.flatnonzero(~ok.any(axis=1))
        if len(bad):
            why = (
                f"{holes.names[n]}: {self._why_not(holes.one(n))}"
                for n in bad[:MAX_LISTED].tolist()
            )
            named = indented(why, len(bad))
            count = counted(len(ok), "hole")
            places = stations[0].name if len(stations) == 1 else f"any of {len(stations)} stations"
            hint = unit_hint(holes.points_mm) if len(bad) == len(ok) else ""
            raise HilcellError(
                f"{len(bad)} of {count} cannot be drilled from {places} in the robot's posture "
                f"(robot.status = {self.cell.robot.status}):\n{named}\n"
                f"{self._act(bad)}{hint}",
                code="HC-C10",
            )

    def _act(self, bad: Ints) -> str:
        served = self.served
        if served is None:
            return (
                "move the part or the tracker, try --free stations, or another posture: --set "
                "robot.status=N, 0 to 7"
            )
        names, poses = [each.name for each in self.stations], self.holes.reflector_poses()
        if all(served.points_back(names, poses[n]) for n in bad.tolist()):
            return "nx, ny, nz of a list of holes point out of the part, against the tool's z"
        return (
            "move or turn the part, move the tracker, or calibrate a larger volume or in another "
            "posture (robot.status)"
        )

    def _why_not(self, hole: Holes) -> str:
        """Why one hole is drilled from no station: out of reach, or not corrected there."""
        cell, stations, served = self.cell, self.stations, self.served
        names = [each.name for each in stations]
        if served is not None and served.points_back(names, hole.reflector_poses()[0]):
            return "its normal points into the part: turn it"
        if served is not None and _in_range(cell, hole).all():
            poses = hole.reflector_poses()[0]
            rooms = {each.name: _room_rad(cell, _in_base(cell, each, poses)) for each in stations}
            reached = [name for name, room in rooms.items() if (room >= 0.0).any()]
            if reached:
                return served.refusal(reached, poses)
        return self._reason(hole)

    def _reason(self, hole: Holes) -> str:
        """Why one hole is reached from no station, for the nearest one."""
        cell, stations = self.cell, self.stations
        range_mm, (low, high) = float(_range_mm(cell, hole)[0]), _range_limits_mm(cell)
        if not low <= range_mm <= high:
            return f"tracker range {range_mm:.0f} mm, expected {low:.0f} .. {high:.0f} mm"
        robot, limits = cell.robot.nominal(), cell.robot.margin_limits_rad
        seen = hole.reflector_poses()[0]
        poses = np.stack([_in_base(cell, station, seen) for station in stations])
        excess_mm = robot.excess_mm(poses)
        if excess_mm.min() > 0:
            at = int(excess_mm.min(axis=1).argmin())
            return f"out of reach by {excess_mm.min():.1f} mm at {stations[at].name}"
        room = _room_rad(cell, poses)
        best = int(room.argmax())
        station = stations[best // room.shape[1]]
        joints = robot.nearest(poses.reshape(-1, 4, 4)[best])
        worst = int(np.minimum(joints - limits[0], limits[1] - joints).argmin())
        low, high = np.degrees(limits[:, worst])
        return (
            f"joint limit: A{worst + 1} at {np.degrees(joints[worst]):.2f} deg, expected {low:.2f} "
            f".. {high:.2f} deg, {np.degrees(-room.max()):.2f} deg beyond, at {station.name}"
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
