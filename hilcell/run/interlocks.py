"""Conditions before anything moves or is measured; pure checks on fresh readings.

The readings are recent and are journalled with the motion that they admit. Each check raises
`Blocked` with the reason; NaN never passes. hilcell is not a safety function: these interlocks
protect the measurement and the machine, not people. I1 and I2 are in the list of
`hilcell.invariants`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

import msgspec
import numpy as np

from hilcell.cell.file import Cell, Station
from hilcell.model.events import ReadingTime
from hilcell.ports import Array, Clock, DeviceError, RailReading, RobotReading

SAFE_POSE_TOLERANCE_DEG = 0.1
RAIL_BLOCKED, ROBOT_BLOCKED = "rail move blocked", "robot move blocked"
TOO_OLD = {"Rail": "HC-R40", "Robot": "HC-B30"}  # a reading, by device


class Blocked(DeviceError):
    """An interlock forbids the motion or the measurement."""


# -- readings that admit motions ------------------------------------------------------------------

# A PC that was suspended between a reading and its use has an old reading of a working device. So
# it reads again; the interlocks check the age of the new reading all the same.

R = TypeVar("R", RailReading, RobotReading)


def fresh_reading(read: Callable[[], R], clock: Clock, limit_s: float, taken: R | None = None) -> R:
    """Return ``taken`` if its age is well below ``limit_s``, else one of up to five readings.

    The last one is returned if all are old.
    """
    tries, share = 5, 0.8  # share of the limit: the rest is left until the motion begins
    reading = read() if taken is None else taken
    for _ in range(tries - 1):
        if clock.pc_s() - reading.taken_s <= share * limit_s:
            break
        reading = read()
    return reading


def reading_time(reading: RailReading | RobotReading, now_s: float) -> ReadingTime:
    return ReadingTime(reading.taken_s, now_s - reading.taken_s, reading.ended_s)


def reading_facts(reading: RailReading | RobotReading, now_s: float) -> dict[str, object]:
    """Return the journal's facts of the reading that admits a motion of the other device."""
    facts = msgspec.structs.asdict(reading_time(reading, now_s))
    if isinstance(reading, RobotReading):
        state: dict[str, object] = {"joints_deg": np.degrees(reading.joints_rad)}
    else:
        state = {"strip_mm": reading.strip_mm, "powered": reading.powered}
    return facts | {"still": reading.still} | state


# -- checks ---------------------------------------------------------------------------------------


def check_age(device: str, operation: str, taken_s: float, now_s: float, limit_s: float) -> None:
    """Raise `Blocked` for a reading older than ``limit_s``, or from the future."""
    age_s = now_s - taken_s
    if not -0.001 <= age_s <= limit_s:
        raise Blocked(
            TOO_OLD[device],
            device,
            operation,
            f"reading is {age_s * 1000:.0f} ms old",
            expected=f"<= {limit_s * 1000:.0f} ms",
            act="the link is slow or stalled; check it",
            fields={"age_s": age_s, "limit_s": limit_s},
        )


def check_rail_may_move(cell: Cell, robot: RobotReading, now_s: float) -> None:
    """I1: the robot is at rest at its safe pose, by a reading taken after it stopped."""
    check_age("Robot", RAIL_BLOCKED, robot.taken_s, now_s, cell.settle.reading_age_s)
    check_safe_pose(cell, robot)


def check_safe_pose(cell: Cell, robot: RobotReading) -> None:
    """Raise `Blocked` for a robot that moves or is not at its safe pose."""
    check_still(robot, RAIL_BLOCKED, expected="at rest at its safe pose")
    off_deg = np.abs(np.degrees(robot.joints_rad) - cell.robot.safe_deg)
    if not bool(np.all(off_deg <= SAFE_POSE_TOLERANCE_DEG)):
        worst = int(np.argmax(np.nan_to_num(off_deg, nan=np.inf)))
        raise Blocked(
            "HC-B32",
            "Robot",
            RAIL_BLOCKED,
            f"robot not at safe pose, A{worst + 1} {np.degrees(robot.joints_rad[worst]):.3f} deg",
            expected=f"{cell.robot.safe_deg[worst]:.3f} +-{SAFE_POSE_TOLERANCE_DEG} deg",
            fields={
                "axis": worst + 1,
                "angle_deg": np.degrees(robot.joints_rad[worst]),
                "wanted_deg": cell.robot.safe_deg[worst],
            },
        )


def check_robot_rests(cell: Cell, robot: RobotReading, now_s: float) -> None:
    """Raise `Blocked` for a robot that moves or was not read recently."""
    check_age("Robot", ROBOT_BLOCKED, robot.taken_s, now_s, cell.settle.reading_age_s)
    check_still(robot, ROBOT_BLOCKED)


def check_still(robot: RobotReading, operation: str, expected: str = "at rest") -> None:
    if not robot.still:
        raise Blocked("HC-B31", "Robot", operation, "the robot is moving", expected=expected)


def check_robot_may_move(
    cell: Cell, rail: RailReading, station: Station | None, now_s: float
) -> None:
    """I2: the slide is at rest and held, and the strip reads the station's value."""
    check_age("Rail", ROBOT_BLOCKED, rail.taken_s, now_s, cell.settle.reading_age_s)
    check_held(cell, rail, station, ROBOT_BLOCKED)


def check_held(cell: Cell, rail: RailReading, station: Station | None, operation: str) -> None:
    """Raise `Blocked` for a slide that moves, has power, or is not at ``station``."""
    readings = (rail.position_mm, rail.strip_mm, rail.velocity_mm_s)
    if not (rail.still and all(map(math.isfinite, readings))):
        raise Blocked(
            "HC-R41",
            "Rail",
            operation,
            f"slide moves at {rail.velocity_mm_s:.3f} mm/s",
            expected="at rest",
            fields={"speed_mm_s": rail.velocity_mm_s},
        )
    if rail.powered:
        raise Blocked(
            "HC-R42", "Rail", operation, "the drive has power to move", expected="held by the brake"
        )
    if station is not None:
        check_strip(cell, rail, station, operation)


def check_strip(cell: Cell, rail: RailReading, station: Station, operation: str) -> None:
    """Raise `Blocked` for a strip reading more than one count beyond the tolerance."""
    limit_mm = cell.rail.hold_limit_mm + 1e-9
    if not abs(rail.strip_mm - station.strip_mm) <= limit_mm:
        raise Blocked(
            "HC-S05",
            "Rail",
            operation,
            f"station {station.name} not held: strip {rail.strip_mm:.2f} mm",
            expected=f"{station.strip_mm:.2f} +-{limit_mm:.2f} mm",
            fields={
                "station": station.name,
                "strip_mm": rail.strip_mm,
                "wanted_mm": station.strip_mm,
                "limit_mm": limit_mm,
            },
        )


def check_joint_limits(cell: Cell, joints_rad: Array, what: str) -> None:
    """Raise `Blocked` for joints (6,) outside the software limits less the margin."""
    low, high = cell.robot.margin_limits_rad
    inside = (joints_rad >= low) & (joints_rad <= high)
    if not inside.all():
        axis = int(np.argmin(inside))
        raise Blocked(
            "HC-B33",
            "Robot",
            what,
            f"A{axis + 1} {np.degrees(joints_rad[axis]):.2f} deg",
            expected=f"{np.degrees(low[axis]):.1f} .. {np.degrees(high[axis]):.1f} deg",
            fields={"axis": axis + 1, "angle_deg": np.degrees(joints_rad[axis])},
        )
