"""The first cell file of a cell that nobody has measured: assumed values, each marked as such.

The file is complete and valid from here on, so that every step is an ordinary run; a step replaces
the values that it has measured.
"""

from __future__ import annotations

import math

from hilcell.cell.robot import Joint
from hilcell.cell.tables import UNPLACED_MM, Pose
from hilcell.commission.cell_text import CellText
from hilcell.commission.known_robots import KnownRobot
from hilcell.decoding import Json

ASSUMED = "assumed; a later step measures it"
BASE = {"x_mm": 0.0, "y_mm": 0.0, "z_mm": 300.0}
RING_MM = 400.0
SURVEY_MM = 300.0
MARGIN_MM = 30.0  # of a measure by tape


def write_robot(text: CellText, known: KnownRobot) -> None:
    """Write a known robot's nominal kinematics and working volume, unless the file has its own."""
    robot, grid, frame = known.robot, known.grid, known.base_frame
    for key, value, comment in (
        ("robot.name", robot.name, ""),
        ("robot.rp_mm", robot.rp_mm, "pose repeatability of the data sheet"),
        ("robot.smr_mm", list(robot.smr_mm), ASSUMED),
        ("robot.home_deg", list(robot.home_deg), ASSUMED),
        ("robot.safe_deg", list(robot.safe_deg), ASSUMED),
        ("robot.status", robot.status, ""),
        ("robot.speed_percent", 10.0, "raise it once the cell is proved"),
        ("robot.ramp_s", robot.ramp_s, ""),
        (
            "robot.joint",
            [joint_row(joint) for joint in robot.joint],
            f"nominal, of the maker's {robot.name}",
        ),
        ("grid.centre", pose_row(grid.centre), ""),
        ("grid.size_mm", list(grid.size_mm), ""),
        ("grid.pitch_mm", grid.pitch_mm, ""),
        ("base_frame.axis_1_deg", list(frame.axis_1_deg), ""),
        ("base_frame.axis_1_sweep_deg", list(frame.axis_1_sweep_deg), ""),
        ("base_frame.axis_6_deg", list(frame.axis_6_deg), ""),
        ("base_frame.axis_6_sweep_deg", list(frame.axis_6_sweep_deg), ""),
        ("base_frame.points", frame.points, ""),
    ):
        write_new(text, key, value, comment)


def write_travel(text: CellText, room_mm: float) -> None:
    """Write a travel of ``room_mm`` in both directions, at a place that no strip reads: the rail's
    step moves it to where the slide stands.
    """
    unplaced = f"{room_mm:g} mm each way; a later step places it"
    text.set("rail.travel_min_mm", UNPLACED_MM - room_mm + MARGIN_MM, unplaced)
    text.set("rail.travel_max_mm", UNPLACED_MM + room_mm - MARGIN_MM, unplaced)
    text.set("survey.from_mm", UNPLACED_MM)
    text.set("survey.to_mm", UNPLACED_MM + SURVEY_MM)


def write_floor_robot(text: CellText, nests: int) -> None:
    """Write what a robot on the floor with one reflector has, before anybody is asked."""
    write_new(text, "layout.reflectors", "by_hand", "one, carried from nest to nest")
    write_new(text, "layout.base", BASE, ASSUMED)  # with a base and no rail there is none
    if text.get("layout.floor") is None:
        write_nests(text, nests)


def write_nests(text: CellText, count: int) -> None:
    """Write floor nests at a place that none has: the tracker's step moves them to where they
    stand.
    """
    text.set("layout.floor", ring("N", count, UNPLACED_MM), "a later step places them")


def write_places(text: CellText, slide_nests: int) -> None:
    """Write assumed places of tracker and base, and, unless there are no nests on a slide, of these
    and of the first station.
    """
    nests = ring("P", slide_nests, 100.0)
    middle_mm = _middle_of_travel(text)
    write_new(text, "tracker.find_radius_mm", 50.0)
    assumed: list[tuple[str, object]] = [
        ("tracker.pose", {"x_mm": 4000.0, "y_mm": 0.0, "z_mm": 1500.0, "a_deg": 180.0}),
        ("layout.base", BASE),
    ]
    if nests:
        write_new(text, "grid.station", "S1")
        assumed += [
            ("layout.rail_direction", [0.0, 1.0, 0.0]),
            ("layout.slide", nests),
            ("station", [{"name": "S1", "rail_mm": middle_mm, "strip_mm": middle_mm}]),
        ]
    else:
        write_new(text, "touch.poses", 0, "no touch poses without a rail")
    for key, value in assumed:
        write_new(text, key, value, ASSUMED)


def ring(letter: str, count: int, z_mm: float) -> list[Json]:
    """Return nests at assumed places, evenly around a circle."""
    turns = [2.0 * math.pi * n / count for n in range(count)]
    return [
        {
            "name": f"{letter}{n + 1}",
            "x_mm": round(RING_MM * math.cos(turn), 1),
            "y_mm": round(RING_MM * math.sin(turn), 1),
            "z_mm": z_mm,
        }
        for n, turn in enumerate(turns)
    ]


def write_new(text: CellText, path: str, value: object, comment: str = "") -> None:
    """Write a value unless the file has one."""
    if value is not None and text.get(path) is None:
        text.set(path, value, comment)


def joint_row(joint: Joint) -> Json:
    row: Json = {
        "a_mm": joint.a_mm,
        "alpha_deg": joint.alpha_deg,
        "d_mm": joint.d_mm,
        "offset_deg": joint.offset_deg,
        "sign": joint.sign,
        "min_deg": joint.min_deg,
        "max_deg": joint.max_deg,
        "speed_deg_s": joint.speed_deg_s,
    }
    return row


def pose_row(pose: Pose) -> Json:
    names = ("x_mm", "y_mm", "z_mm", "a_deg", "b_deg", "c_deg")
    return {name: value for name in names if (value := getattr(pose, name)) or name[0] in "xyz"}


def _middle_of_travel(text: CellText) -> float:
    ends = (text.get("rail.travel_min_mm"), text.get("rail.travel_max_mm"))
    low_mm, high_mm = (float(end) if isinstance(end, (int, float)) else 0.0 for end in ends)
    return round((low_mm + high_mm) / 2.0, 1)
