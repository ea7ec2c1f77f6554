"""Collision checks of the arm's paths against the cell's volumes, in plans and before each motion.

A path is a PTP motion, all axes synchronous; between two postures within the joint limits it stays
within them. The robot moves to its next pose directly, or by its safe pose where only that path is
clear. So a plan that proves the paths between the safe pose and each of its poses is valid in any
order, also after a resume.

Without volumes in the cell file the robot may move only in the places that the operator has given:
the grid's cube and the circles of the base frame.
"""

from __future__ import annotations

import numpy as np

from hilcell.cell.file import Cell, Station
from hilcell.cell.surroundings import Surroundings, posture
from hilcell.geometry.kinematics import Bools, forward
from hilcell.ports import Array
from hilcell.run.interlocks import Blocked, check_joint_limits

PLAN_MARGIN_MM = 10.0  # for corrections, the measured base, the held position


# -- for plans ------------------------------------------------------------------------------------


def clear(cell: Cell, station: Station, from_rad: Array, to_rad: Array) -> Bools:
    """Return which paths between joints (N, 6) a plan may use at ``station``, (N,).

    In a cell without volumes: those between finite joints.
    """
    if cell.surroundings is None:
        return np.array([bool(np.isfinite(path).all()) for path in from_rad + to_rad])
    start, end = posture(station.rail_mm, from_rad), posture(station.rail_mm, to_rad)
    return cell.surroundings.prove(start, end, PLAN_MARGIN_MM).clear


def clear_poses(cell: Cell, station: Station, joints_rad: Array) -> Bools:
    """Return which poses (N, 6) a plan may move to at ``station``, and back, (N,)."""
    ok = _within(joints_rad, *cell.robot.margin_limits_rad)
    if cell.surroundings is None:
        return ok & ~leaves_cube(cell, joints_rad)
    for start, end in _legs(cell, joints_rad):
        ok[ok] = clear(cell, station, start[ok], end[ok])
    return ok


def check_planned_path(
    cell: Cell, station: Station, from_rad: Array, to_rad: Array, what: str
) -> None:
    """Raise `Blocked` for a plan's paths between joints (6,) or (N, 6) at ``station``."""
    check_path(cell, station.rail_mm, from_rad, to_rad, what, PLAN_MARGIN_MM)


def check_poses(cell: Cell, station: Station, joints_rad: Array, what: str) -> None:
    """Raise `Blocked` for poses (N, 6) that a plan cannot move to at ``station``, or back."""
    for joints in joints_rad[~_within(joints_rad, *cell.robot.margin_limits_rad)]:
        check_joint_limits(cell, joints, what)
    if not bool(np.all(~leaves_cube(cell, joints_rad))):
        check_volumes_known(cell, what)
    legs = _legs(cell, joints_rad)
    if bool(clear(cell, station, *map(np.concatenate, zip(*legs, strict=True))).all()):
        return
    for start, end in legs:
        check_planned_path(cell, station, start, end, what)


def check_sweep(cell: Cell, station: Station, from_rad: Array, to_rad: Array, what: str) -> None:
    """Raise `Blocked` for a plan's motion of one axis between joints (6,) at ``station``."""
    check_volumes_known(cell, what)
    check_poses(cell, station, np.array([from_rad, to_rad]), f"ends of {what}")
    check_planned_path(cell, station, from_rad, to_rad, what)


def check_volumes_known(cell: Cell, what: str) -> None:
    """Raise `Blocked` outside the cube in a cell without volumes."""
    if cell.surroundings is None:
        raise Blocked(
            "HC-B35",
            "Robot",
            what,
            "it leaves the grid's cube, and the cell file has no volumes around the arm",
            expected="robot.envelope and keep_out",
        )


def check_slide_travel(cell: Cell) -> None:
    """Raise `Blocked` for a safe pose with which the slide cannot cover its travel."""
    safe_rad = np.radians(cell.robot.safe_deg)
    ends_mm = (cell.rail.travel_min_mm, cell.rail.travel_max_mm)
    start, end = (posture(end_mm, safe_rad) for end_mm in ends_mm)
    _refuse_paths(cell, start[None], end[None], "slide travel at the safe pose", PLAN_MARGIN_MM)


def leaves_cube(cell: Cell, joints_rad: Array) -> Bools:
    """Return which poses (N, 6) are outside the places that the operator has given, (N,).

    These are the grid's cube, with the grid's tool orientation, and the circles of the base frame.
    """
    cube_mm, cube_rad = 20.0, np.radians(1.0)  # corrected poses are a little outside, too
    poses, centre = forward(cell.robot.arm(), joints_rad), cell.grid.centre.matrix()
    off_mm = np.abs(poses[:, :3, 3] - centre[:3, 3]) - np.array(cell.grid.size_mm) / 2
    cosine = (
        np.einsum("nij,ij->n", poses[:, :3, :3], centre[:3, :3]) - 1.0
    ) / 2.0  # of the rotation
    stated = (off_mm <= cube_mm).all(axis=-1) & (cosine >= np.cos(cube_rad))
    if not bool(stated.all()):
        table = cell.base_frame
        stated |= _on_circle(joints_rad, 0, table.axis_1_deg, table.axis_1_sweep_deg)
        stated |= _on_circle(joints_rad, 5, table.axis_6_deg, table.axis_6_sweep_deg)
    left: Bools = ~stated
    return left


def _on_circle(
    joints_rad: Array, axis: int, fixed_deg: tuple[float, ...], sweep_deg: tuple[float, float]
) -> Bools:
    low, high = np.radians(fixed_deg), np.radians(fixed_deg)
    low[axis], high[axis] = np.radians(min(sweep_deg)), np.radians(max(sweep_deg))
    more_rad = np.radians(1.0)
    return _within(joints_rad, low - more_rad, high + more_rad)


def _within(joints_rad: Array, low: Array, high: Array) -> Bools:
    """Return which poses (N, 6) are within limits (6,) on every axis, (N,)."""
    within: Bools = np.all((joints_rad >= low) & (joints_rad <= high), axis=-1)
    return within


def _legs(cell: Cell, joints_rad: Array) -> list[tuple[Array, Array]]:
    """Return the paths between the safe pose and poses (N, 6): there from below, and back."""
    safe_rad = np.broadcast_to(np.radians(cell.robot.safe_deg), joints_rad.shape)
    below_rad = below(cell, joints_rad)
    return [(safe_rad, below_rad), (below_rad, joints_rad), (joints_rad, safe_rad)]


# -- before a motion ------------------------------------------------------------------------------


def below(cell: Cell, joints_rad: Array) -> Array:
    """Return the joints from which every axis approaches joints (..., 6)."""
    beside: Array = joints_rad - cell.robot.approach_rad
    return beside


def check_path(
    cell: Cell, rail_mm: float, from_rad: Array, to_rad: Array, what: str, more_mm: float = 0.0
) -> None:
    """Raise `Blocked` for motions between joints (6,) or (N, 6) with the slide at ``rail_mm``.

    ``more_mm`` is added to the required clearance.
    """
    start, end = posture(rail_mm, np.atleast_2d(from_rad)), posture(rail_mm, np.atleast_2d(to_rad))
    _refuse_paths(cell, start, end, what, more_mm)


def waypoints(
    cell: Cell, rail_mm: float, from_rad: Array, to_rad: Array, what: str, *, above: bool = False
) -> list[Array]:
    """Return the waypoints from joints (6,) to others: below or above them, then there.

    The safe pose comes first where only that path is clear. Raises `Blocked` where none is.
    """
    side_rad = cell.robot.approach_rad
    beside_rad = to_rad + (side_rad if above else -side_rad)
    safe_rad = np.radians(cell.robot.safe_deg)
    surroundings = cell.surroundings
    if surroundings is None or bool(
        np.all(_proven(surroundings, rail_mm, from_rad, beside_rad, to_rad))
    ):
        return [beside_rad, to_rad]
    if bool(np.all(_proven(surroundings, rail_mm, from_rad, safe_rad, beside_rad, to_rad))):
        return [safe_rad, beside_rad, to_rad]
    check_path(cell, rail_mm, beside_rad, to_rad, what)
    check_path(cell, rail_mm, from_rad, beside_rad, what)
    return [beside_rad, to_rad]


def _proven(surroundings: Surroundings, rail_mm: float, *stops_rad: Array) -> Bools:
    """Return which paths between successive stops (6,) are proven clear."""
    stops = posture(rail_mm, np.array(stops_rad))
    return surroundings.prove(stops[:-1], stops[1:]).clear


def _refuse_paths(cell: Cell, start: Array, end: Array, what: str, more_mm: float) -> None:
    """Raise `Blocked` for motions between postures (N, 7) that are not all proven clear."""
    surroundings = cell.surroundings
    if surroundings is None:
        return
    proof = surroundings.prove(start, end, more_mm)
    if bool(np.all(proof.clear)):
        return
    first, count = int(np.argmin(proof.clear)), int(np.sum(~proof.clear))
    from_posture, to_posture = start[first], end[first]
    nearest = surroundings.nearest(from_posture, to_posture, float(proof.share[first]))
    wanted_mm = surroundings.wanted_mm + more_mm
    at = from_posture + nearest.share * (to_posture - from_posture)
    axes = ", ".join(f"A{axis} {deg:.1f}" for axis, deg in enumerate(np.degrees(at[1:]), 1))
    of = f" (path {first + 1}, and {count - 1} more of {len(start)})" if len(start) > 1 else ""
    inside = nearest.clearance_mm < 0.0
    near = "is in" if inside else f"comes within {nearest.clearance_mm:.0f} mm of"
    raise Blocked(
        "HC-B34",
        "Robot",
        f"{what}{of}",
        f"link {nearest.link} {near} keep-out {nearest.volume}, at {axes} deg, rail {at[0]:.0f} mm",
        expected=f">= {wanted_mm:.0f} mm",
        fields={
            "link": nearest.link,
            "keep_out": nearest.volume,
            "clearance_mm": nearest.clearance_mm,
            "wanted_mm": wanted_mm,
            "share": nearest.share,
            "joints_deg": np.degrees(at[1:]),
            "rail_mm": at[0],
        },
    )


# -- before motions in sequence -------------------------------------------------------------------

# The proof assumes where each path begins and leaves a reserve. Where slide and robot are then read
# elsewhere, no point of the arm is farther from its proven path than the levers allow
# (`Body.travel_mm`): axes are synchronous, so two paths to the same pose differ most at their
# beginnings. Within the reserve the path is clear; any other path is proven by itself.

RESERVE_MM = 5.0  # beyond the required clearance; a plan has 10


class UpcomingPoses:
    """Poses whose paths are proven in advance, keyed by exact joint values."""

    def __init__(self, cell: Cell) -> None:
        self._cell = cell
        # The posture (7,) from which its paths are proven, if they are; whether it leaves the cube.
        self._upcoming: dict[bytes, tuple[Array | None, bool]] = {}

    def expect(self, rail_mm: float, joints_rad: Array) -> None:
        """Prove the paths from the safe pose to joints (N, 6) in sequence, each from below."""
        cell = self._cell
        if cell.surroundings is None:
            return
        before_rad = np.vstack([np.radians(cell.robot.safe_deg), joints_rad])[:-1]
        stops = posture(rail_mm, np.array([before_rad, below(cell, joints_rad), joints_rad]))
        paths = stops[:-1].reshape(-1, 7), stops[1:].reshape(-1, 7)
        proof = cell.surroundings.prove(*paths, RESERVE_MM)
        to_below, from_there = proof.clear.reshape(2, -1)
        clear = to_below & from_there
        self._upcoming = {
            joints.tobytes(): (stops[0, n] if clear[n] else None, bool(leaves))
            for n, (joints, leaves) in enumerate(
                zip(joints_rad, leaves_cube(cell, joints_rad), strict=True)
            )
        }

    def clear(self, rail_mm: float, from_rad: Array, to_rad: Array) -> bool:
        """Whether the paths from joints (6,) to others, from below, are within the reserve."""
        start, _ = self._upcoming.get(to_rad.tobytes(), (None, True))
        surroundings = self._cell.surroundings
        if start is None or surroundings is None:
            return False
        return surroundings.apart_mm(start, posture(rail_mm, from_rad)) <= RESERVE_MM

    def leaves_cube(self, joints_rad: Array) -> bool:
        if (coming := self._upcoming.get(joints_rad.tobytes())) is not None:
            return coming[1]
        return bool(leaves_cube(self._cell, joints_rad[None])[0])
