"""Which holes the robot reaches from which place on the rail, with how much room, and why not.

The configuration is the cell's, for which its errors are known. The tracker must see the hole
wherever the robot stands, so range depends on the hole alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hilcell.calibration.volume import Volume
from hilcell.cell.file import Cell, Station
from hilcell.compensation.grid import FAR_MM, UNITS
from hilcell.errors import MOST_LISTED, bounded
from hilcell.geometry.frames import inverse
from hilcell.geometry.inverse import inverse_kinematics, nearest_turns, reach_excess_mm
from hilcell.geometry.kinematics import Array
from hilcell.ports import HilcellError
from hilcell.programs.holes import Holes

Bools = NDArray[np.bool_]
Ints = NDArray[np.int_]


class UnreachableHoles(HilcellError):
    """Holes that no candidate station can serve."""

    code = "HC-C10"


@dataclass(frozen=True, slots=True)
class Reach:
    """Holes against stations, each (N, S): ``ok``, and the turn of the tool with most room."""

    ok: Bools
    turn: Ints


def reach(
    cell: Cell, holes: Holes, stations: Sequence[Station], served: Volume | None = None
) -> Reach:
    """Return which holes each station reaches, and corrects where ``served`` says so.

    Raises `UnreachableHoles` with the reasons.
    """
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
    _refuse_unreached(cell, holes, stations, ok, served)
    return Reach(ok, turn)


def _in_base(cell: Cell, station: Station, poses: Array) -> Array:
    return inverse(cell.layout.nominal_base(station.rail_mm)) @ poses


def _room_rad(cell: Cell, poses: Array) -> Array:
    """Return the least distance to a joint limit or a straight wrist at poses (..., 4, 4) in {B}.

    Below 0 beyond a limit, -inf where the arm does not reach.
    """
    arm, limits = cell.robot.arm(), cell.robot.margin_limits_rad
    room = np.full(poses.shape[:-2], -np.inf)
    there = reach_excess_mm(arm, poses, cell.robot.status) == 0
    joints = inverse_kinematics(arm, poses[there], cell.robot.status)
    joints = nearest_turns(joints, limits, np.radians(cell.robot.home_deg))
    inside = np.minimum(joints - limits[0], limits[1] - joints).min(axis=-1)
    room[there] = np.where(inside >= 0, np.minimum(inside, np.abs(joints[:, 4])), inside)
    return room


def _range_mm(cell: Cell, holes: Holes) -> Array:
    range_mm: Array = np.linalg.norm(holes.points_mm - cell.tracker.pose.matrix()[:3, 3], axis=1)
    return range_mm


def _range_limits_mm(cell: Cell) -> tuple[float, float]:
    """Return the tracker's limits less the radius within which it may find a reflector."""
    margin = cell.tracker.find_radius_mm
    return cell.tracker.min_range_mm + margin, cell.tracker.max_range_mm - margin


def _in_range(cell: Cell, holes: Holes) -> Bools:
    range_mm, (low, high) = _range_mm(cell, holes), _range_limits_mm(cell)
    return (range_mm >= low) & (range_mm <= high)


def _refuse_unreached(
    cell: Cell, holes: Holes, stations: Sequence[Station], ok: Bools, served: Volume | None
) -> None:
    bad = np.flatnonzero(~ok.any(axis=1))
    if len(bad):
        why = (
            f"{holes.names[n]}: {_why_not(cell, holes.one(n), stations, served)}"
            for n in bad[:MOST_LISTED].tolist()
        )
        named = "".join(f"\n  {line}" for line in bounded(why, len(bad)))
        count = f"{len(ok)} hole{'s' * (len(ok) != 1)}"
        places = stations[0].name if len(stations) == 1 else f"any of {len(stations)} stations"
        small = len(bad) == len(ok) and float(np.abs(holes.points_mm).max()) < FAR_MM
        raise UnreachableHoles(
            f"{len(bad)} of {count} cannot be drilled from {places} in status "
            f"{cell.robot.status}:{named}"
            f"\n{_act(holes, bad, stations, served)}{UNITS if small else ''}"
        )


def _act(holes: Holes, bad: Ints, stations: Sequence[Station], served: Volume | None) -> str:
    """Return what to do about holes (K,) that are drilled from no station."""
    if served is None:
        return "move the part or the tracker, or try --free stations"
    names, poses = [each.name for each in stations], holes.reflector_poses()
    if all(served.points_back(names, poses[n]) for n in bad.tolist()):
        return "nx, ny, nz of a list of holes point out of the part, against the tool's z"
    return "move or turn the part, move the tracker, or calibrate a larger volume"


def _why_not(cell: Cell, hole: Holes, stations: Sequence[Station], served: Volume | None) -> str:
    """Return why one hole is drilled from no station: out of reach, or reached and not served."""
    names = [each.name for each in stations]
    if served is not None and served.points_back(names, hole.reflector_poses()[0]):
        return "its normal points into the part: turn it"
    if served is not None and _in_range(cell, hole).all():
        poses = hole.reflector_poses()[0]
        rooms = {each.name: _room_rad(cell, _in_base(cell, each, poses)) for each in stations}
        reached = [name for name, room in rooms.items() if (room >= 0.0).any()]
        if reached:
            return served.refusal(reached, poses)
    return _reason(cell, hole, stations)


def _reason(cell: Cell, hole: Holes, stations: Sequence[Station]) -> str:
    """Return why one hole is reached from no station, at the station where least is missing."""
    range_mm, (low, high) = float(_range_mm(cell, hole)[0]), _range_limits_mm(cell)
    if not low <= range_mm <= high:
        return f"tracker range {range_mm:.0f} mm, wanted {low:.0f} .. {high:.0f} mm"
    arm, status = cell.robot.arm(), cell.robot.status
    seen = hole.reflector_poses()[0]
    poses = np.stack([_in_base(cell, station, seen) for station in stations])
    excess_mm = reach_excess_mm(arm, poses, status)
    if excess_mm.min() > 0:
        at = int(excess_mm.min(axis=1).argmin())
        return f"out of reach by {excess_mm.min():.1f} mm at {stations[at].name}"
    room = _room_rad(cell, poses)
    best = int(room.argmax())
    station = stations[best // room.shape[1]]
    limits = cell.robot.margin_limits_rad
    joints = inverse_kinematics(arm, poses.reshape(-1, 4, 4)[best], status)
    joints = nearest_turns(joints, limits, np.radians(cell.robot.home_deg))
    worst = int(np.minimum(joints - limits[0], limits[1] - joints).argmin())
    low, high = np.degrees(limits[:, worst])
    return (
        f"joint limit: A{worst + 1} at {np.degrees(joints[worst]):.2f} deg, wanted {low:.2f} .. "
        f"{high:.2f} deg, {np.degrees(-room.max()):.2f} deg beyond, at {station.name}"
    )
