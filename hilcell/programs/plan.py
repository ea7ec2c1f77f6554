"""From holes to stations and orders of visit, after the paper's section 2.

As few stations as reach all holes; each hole belongs to the station closest to it among those that
reach it, and the slide moves only when the next hole is out of reach. Travel is counted between the
holes of one station; between stations the robot is at its safe pose.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hilcell.calibration.volume import Volume
from hilcell.cell.file import Cell, Station
from hilcell.geometry.frames import zyx_from_pose
from hilcell.geometry.kinematics import Array
from hilcell.ports import HilcellError
from hilcell.programs.holes import Holes
from hilcell.programs.reach import Reach, reach
from hilcell.programs.route import route


class CoverError(HilcellError):
    """Holes that no set of stations covers."""

    code = "HC-C10"


def fewest(ok: NDArray[np.bool_], burden: Array) -> NDArray[np.int_]:
    """Return the columns of ``ok`` (N, S), a least number of them, that reach every row.

    ``burden`` (S,), 0..1 each, decides only between sets of equal number: its sum is made less
    than one station costs. Raises `CoverError` where a row is reached by none.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp  # slow to load, seldom needed

    rows = np.unique(ok, axis=0)
    if not rows.any(axis=1).all():
        raise CoverError("set cover: some holes are reached from no station")
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
        raise CoverError(f"set cover: not solved: {found.message}")
    return chosen


SLOW_HOLES = 500  # whose plan takes seconds
RASTER_MM = 50.0  # of free stations along the rail


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
        """Return the travel between holes at all stations."""
        return sum(each.travel_mm for each in self.stations)

    @property
    def bound_mm(self) -> float:
        """Return a travel that no orders of these stations' holes are below."""
        return sum(each.bound_mm for each in self.stations)


def ratio(travel_mm: float, bound_mm: float) -> float:
    """Return travel over bound, 1 where nothing is travelled."""
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

    With ``calibrated`` each hole is drilled at a station, and with a turn of the tool, where it is
    corrected. ``say`` is called with each step of a plan that takes long. Raises
    `UnreachableHoles`.
    """
    candidates = _candidates(cell, free=free)
    if calibrated is not None:
        candidates = [each for each in candidates if each.name in calibrated.stations]
        for station in candidates:
            holes = holes.with_turn_near(calibrated.orientation(station.name))
    slow = len(holes.names) >= SLOW_HOLES
    if slow:
        say(f"planning {len(holes.names)} holes: where they are reached")
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
            say(f"{candidates[each].name}: the order of {count} holes")
        stations.append(_at_station(holes, reached, candidates[each], each, owner))
    return HolePlan(stations)


def along_rail(rail_mm: dict[int, float]) -> list[int]:
    """Return the keys in one sweep, from the end nearer to 0, where homing leaves the slide."""
    order = sorted(rail_mm, key=lambda each: rail_mm[each])
    if abs(rail_mm[order[-1]]) < abs(rail_mm[order[0]]):
        order.reverse()
    return order


def _candidates(cell: Cell, *, free: bool) -> list[Station]:
    recorded = list(cell.station)
    if not free:
        return recorded
    low = cell.rail.travel_min_mm + cell.rail.back_off_mm
    raster = RASTER_MM * np.arange(
        np.ceil(low / RASTER_MM), np.floor(cell.rail.travel_max_mm / RASTER_MM) + 1
    )
    known = {station.rail_mm for station in recorded}
    return recorded + [
        Station(name=f"at {rail_mm:g} mm", rail_mm=rail_mm, strip_mm=rail_mm)
        for rail_mm in raster.tolist()
        if rail_mm not in known
    ]


def _off_mm(cell: Cell, holes: Holes, stations: list[Station]) -> Array:
    """Return how far along the rail each hole lies from each station, (N, S)."""
    from_start = holes.points_mm - cell.layout.nominal_base(0.0)[:3, 3]
    along_mm = from_start @ np.array(cell.layout.rail_direction)
    rail_mm = np.array([station.rail_mm for station in stations])
    off_mm: Array = np.abs(along_mm[:, None] - rail_mm)
    return off_mm


def _remoteness(off_mm: Array, ok: NDArray[np.bool_]) -> Array:
    """Return how far off the holes are that each station reaches, (S,), 0..1."""
    count = ok.sum(axis=0)
    mean_mm = np.where(ok, off_mm, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.where(count > 0, mean_mm / max(float(off_mm.max()), 1.0), 1.0)


def _at_station(
    holes: Holes, reached: Reach, station: Station, column: int, owner: NDArray[np.int_]
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
