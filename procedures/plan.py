"""Plans of procedures: checks of their targets, and the durations of their steps.

Durations are trapezoids of motions, waits and readings, in the cell's time, without a controller's
overhead and re-measured outliers: the forecast learns these from the run.
"""

from __future__ import annotations

import math

import numpy as np

from hilcell.cell.devices import Rests, abilities
from hilcell.cell.file import Cell, Station
from hilcell.geometry.frames import apply, from_rotvec, from_zyx, inverse, matrix, zyx_from_pose
from hilcell.geometry.inverse import ReachError
from hilcell.geometry.kinematics import Bools
from hilcell.model.plan import Span
from hilcell.ports import Array, HilcellError
from hilcell.run.collision import below, check_poses, clear_poses, leaves_cube

# -- targets --------------------------------------------------------------------------------------


def other_stations(cell: Cell) -> list[Station]:
    return [station for station in cell.station if station.name != cell.grid.station]


def stations_in_order(cell: Cell) -> list[Station]:
    """Return the stations in the order in which they are visited, the grid's first."""
    return [cell.reference, *other_stations(cell)]


def poses_at(cell: Cell, points_mm: Array) -> Array:
    """Return poses (N, 4, 4) in {B} at ``points_mm`` (N, 3) with the grid's orientation."""
    return matrix(cell.grid.centre.matrix()[:3, :3], points_mm)


def more_orientations(cell: Cell) -> Array:
    """Return the orientations (N, 3, 3) in {B} of the tool on the grid besides the grid's own."""
    return from_zyx(np.array(cell.plan.grid_orientations, dtype=float).reshape(-1, 3))


def angles_deg(T_W_B: Array, poses: Array) -> Array:
    """Return A, B, C (N, 3) in {W} of poses (N, 4, 4) in {B}."""
    return zyx_from_pose(T_W_B @ poses)[:, 3:]


def reoriented(poses: Array, turns_rad: Array) -> Array:
    """Return poses (N, 4, 4) rotated about their origins by rotation vectors (N, 3) in {B}."""
    return matrix(from_rotvec(turns_rad) @ poses[:, :3, :3], poses[:, :3, 3])


def drivable(cell: Cell, station: Station, poses: Array) -> Bools:
    """Return which poses (N, 4, 4) in {B} the robot may move to, (N,)."""
    robot = cell.robot.nominal()
    ok: Bools = robot.reachable(poses)
    ok[ok] = clear_poses(cell, station, robot.joints_for(poses[ok]))
    return ok


def joints_for(cell: Cell, points_mm: Array) -> Array:
    """Return joints (N, 6) in rad that nominally reach ``points_mm`` (N, 3) in {B}, in limits.

    Raises `ReachError` naming the targets that the robot cannot reach.
    """
    return cell.robot.nominal().joints_for(poses_at(cell, points_mm))


def check_reach(cell: Cell, poses: Array, what: str) -> Array:
    """Return the joints (N, 6) for poses (N, 4, 4) in {B}, or name those out of reach."""
    try:
        return cell.robot.nominal().joints_for(poses)
    except ReachError as error:
        raise HilcellError(f"{what}: {error}", code="HC-C10") from error


def check_targets(cell: Cell, station: Station, poses: Array, what: str) -> Array:
    """Return the joints (N, 6), or name the poses that cannot be reached."""
    joints_rad = check_reach(cell, poses, what)
    check_poses(cell, station, joints_rad, what)
    return joints_rad


def check_range(cell: Cell, points_mm: Array, what: str) -> None:
    """Refuse points (N, 3) in {W} that are nearer or farther than the tracker can measure."""
    range_mm = np.linalg.norm(apply(inverse(cell.tracker.pose.matrix()), points_mm), axis=1)
    low, high = cell.tracker.min_range_mm, cell.tracker.max_range_mm
    inside = (range_mm >= low) & (range_mm <= high)
    if not np.all(inside):
        worst = int(np.argmin(inside))
        raise HilcellError(
            f"{what}: {int(np.sum(~inside))} of {len(inside)} out of the tracker's range; the "
            f"first at {range_mm[worst]:.0f} mm, expected {low:.0f} .. {high:.0f} mm; move the "
            "tracker",
            code="HC-C10",
        )


# -- durations ------------------------------------------------------------------------------------


MOTION_END_S = 0.06  # until a driver detects the end of a motion


def measure_s(cell: Cell, samples: int) -> float:
    return cell.tracker.pointing_s + samples * cell.tracker.reading_s


def readings(cell: Cell, count: int, samples: int) -> Span:
    """Return the span of ``count`` reflectors measured with nothing moving between them."""
    return Span(f"{samples} readings", count, count * measure_s(cell, samples))


def floor_nest_points(cell: Cell) -> Span:
    """Return the span of the floor nests, of which {W} is framed."""
    return readings(cell, len(cell.layout.floor), cell.nest_samples)


def _tracker_check(cell: Cell) -> Span:
    return readings(cell, len(cell.layout.floor), cell.verification_samples)


def closing(cell: Cell, *, carried: bool = False, points: int = 1) -> list[Span]:
    """Return the spans of the tracker's verifications during and after ``points`` points."""
    if cell.layout.by_hand:
        return [_tracker_check(cell)] if carried else []
    return [_tracker_check(cell)] * math.ceil(points / cell.plan.prove_every)


def robot_moves_s(
    cell: Cell, from_rad: Array, to_rad: Array, percent: Array | None = None
) -> Array:
    """Return (N,) s for motions PTP between joints (N, 6): the slowest axis rules each.

    At ``percent`` (N,) of the axes' speed, or at the cell's.
    """
    speeds_rad_s = np.radians([joint.speed_deg_s for joint in cell.robot.joint])
    share = (cell.robot.speed_percent if percent is None else percent) / 100.0
    at_full_speed_s = np.max(np.abs(to_rad - from_rad) / speeds_rad_s, axis=-1)
    ramp_s = cell.robot.ramp_s * share
    trapezoid_s = at_full_speed_s / share + ramp_s
    triangle_s = 2.0 * np.sqrt(cell.robot.ramp_s * at_full_speed_s)
    moves_s: Array = np.where(at_full_speed_s > share * ramp_s, trapezoid_s, triangle_s)
    return moves_s + MOTION_END_S


def flange_points(cell: Cell, joints_rad: Array, *, seats: bool = False) -> Span:
    """Return the span of measuring at joints (N, 6), in order, from the safe pose on.

    With all ``seats``, the other reflectors on the flange are measured at each as well.
    """
    each = len(cell.robot.seats_mm) if seats else 1
    below_rad = below(cell, joints_rad)
    before_rad = np.vstack([np.radians(cell.robot.safe_deg), joints_rad[:-1]])
    percent = first_pass_percent(cell, joints_rad)
    there_s = robot_moves_s(cell, before_rad, below_rad, percent)
    landing_s = robot_moves_s(cell, below_rad, joints_rad, percent)
    count, tracker = each * len(joints_rad), cell.tracker
    # A tracker that streams follows one reflector from pose to pose.
    pointed = 1 if each == 1 and abilities(cell)["tracker_streams"] else count
    rests_s = len(joints_rad) * Rests.of(cell).robot_s
    read_s = pointed * tracker.pointing_s + count * tracker.samples * tracker.reading_s
    return Span("flange", count, float(np.sum(there_s + landing_s)) + rests_s + read_s)


def first_pass_percent(cell: Cell, joints_rad: Array) -> Array:
    """Return the speeds (N,) to joints (N, 6) on the first pass: no plan knows of runs before."""
    usual = cell.robot.speed_percent
    slow = usual if cell.surroundings is None else min(cell.robot.first_pass_percent, usual)
    return np.where(leaves_cube(cell, joints_rad), slow, usual)


def nearest_next(cell: Cell, joints_rad: Array) -> list[int]:
    """Return the order of joints (N, 6): after each the one that takes the robot the least time."""
    here_rad, left, order = np.radians(cell.robot.safe_deg), list(range(len(joints_rad))), []
    while left:
        moves_s = robot_moves_s(cell, here_rad, joints_rad[left])
        order.append(left.pop(int(np.argmin(moves_s))))
        here_rad = joints_rad[order[-1]]
    return order


def park_s(cell: Cell) -> float:
    home_rad, safe_rad = np.radians(cell.robot.home_deg), np.radians(cell.robot.safe_deg)
    return float(robot_moves_s(cell, home_rad, safe_rad))


def rail_travel_s(cell: Cell, distance_mm: float) -> float:
    """Return the slide's time from standstill to standstill, with the strip's reading."""
    speed_mm_s, acceleration_mm_s2 = cell.rail.speed_mm_s, cell.rail.acceleration_mm_s2
    peak_mm_s = min(speed_mm_s, math.sqrt(abs(distance_mm) * acceleration_mm_s2))
    ramps_s = peak_mm_s / acceleration_mm_s2
    travel_s = abs(distance_mm) / peak_mm_s + ramps_s if distance_mm else 0.0
    return travel_s + MOTION_END_S + cell.rail.standstill_dwell_s


def rail_move_s(cell: Cell, distance_mm: float) -> float:
    """Return the time of a motion by the drive alone until the slide is held."""
    return rail_travel_s(cell, distance_mm) + cell.settle.rail_s


def approach_s(cell: Cell, from_mm: float, station: Station) -> float:
    """Return the time to hold ``station`` by the strip with the robot parked."""
    back_off_mm, approaches = cell.rail.back_off_mm, 2  # by the drive, then by the strip's reading
    there_s = rail_travel_s(cell, station.rail_mm - back_off_mm - from_mm)
    again_s = (2 * approaches - 1) * rail_travel_s(cell, back_off_mm)
    return there_s + again_s + Rests.of(cell).rail_s


def first_hold(cell: Cell, station: Station) -> list[Span]:
    """Return the spans of a run's first motion to a station, from the drive's reference."""
    if not cell.has_rail:
        return []
    travel_s = approach_s(cell, cell.rail.travel_min_mm, station)
    return [Span("leg", 0, travel_s), *hold_check(cell)]


def hold_check(cell: Cell) -> list[Span]:
    """Return the span of the slide nest that verifies a hold, if reflectors are mounted."""
    return [] if cell.layout.by_hand else [readings(cell, 1, cell.tracker.samples)]


def leg(cell: Cell, here: Station, there: Station) -> list[Span]:
    """Return the spans from a held station to the next, the robot parked first; none to itself."""
    if here == there:
        return []
    seconds = park_s(cell) + approach_s(cell, here.rail_mm, there)
    return [Span("leg", 0, seconds), *hold_check(cell)]


def homing_s(cell: Cell) -> float:
    """Return the time of the drive's referencing from the middle of the travel."""
    if not cell.has_rail:
        return 0.0
    half_mm = (cell.rail.travel_max_mm - cell.rail.travel_min_mm) / 2
    travel_s = half_mm / min(cell.rail.homing_mm_s, cell.rail.speed_mm_s)
    return travel_s + MOTION_END_S + Rests.of(cell).rail_s
