"""The paper's calibration, from power-on to a validated correction, and its acts one by one."""

from __future__ import annotations

from collections.abc import Mapping
from operator import itemgetter, methodcaller
from typing import Any

from hilcell.geometry.statistics import Figures
from hilcell.model.outcome import Outcome
from hilcell.model.point import BOTH, HOW, Sent
from hilcell.present.table import Column, Named, Table
from hilcell.run.procedure import Procedure
from procedures.axis_sweeps import AxisSweeps, sweep_table, sweep_words
from procedures.base_frame import BaseFrame
from procedures.chosen_poses import ChosenPoses
from procedures.fit import Fit
from procedures.frame_repeatability import FrameRepeatability, frame_repeatability_table
from procedures.home import Home
from procedures.rail_survey import RailSurvey, survey_table
from procedures.repeatability import Repeatability
from procedures.revisits import Revisits, suspicion_words
from procedures.robot_grid import RobotGrid
from procedures.sign_check import SignCheck, sign_table
from procedures.station import HoldStation, StationRepeatability, approach_table
from procedures.station_frames import StationFrames
from procedures.two_faces import TwoFaces
from procedures.validate import Validate
from procedures.world_frame import WorldFrame


def validation_table(result: dict[str, Any]) -> Table:
    """Return the errors before and after, station by station, as the paper states them."""
    rows = [
        {"place": where, "way": way, "sent": sent.get(way), "outcome": outcome}
        | figures[way]
        | figures[way].get("orientation", {})
        for where, figures in result["validation"].items()
        for sent in (figures.get("points_sent", {Sent.BEFORE: figures["points"]}),)
        for outcome in (figures.get("decision", {}).get("outcome"),)
        for way in (*Sent, "floor")
        if way in figures
    ]
    names = Figures._fields
    oriented = any(row["way"] == Sent.BEFORE and "orientation" in row for row in rows)
    return Table(
        [
            Column("station", lambda row: row["place"] if row["way"] == Sent.BEFORE else ""),
            Column("points", itemgetter("sent"), form="d"),
            Column("error of", lambda row: _sent(row, result["method"])),
            *(Column(name, methodcaller("get", name), "mm", ".4f") for name in names),
            *(
                Column(f"turn {name}", methodcaller("get", f"{name}_deg"), "°", ".4f")
                for name in names
                if oriented
            ),
        ],
        rows,
    )


def _sent(row: Mapping[str, Any], method: str) -> Named:
    """Return how targets were sent, and the outcome of those that were corrected."""
    name, words = row["way"], HOW.get(row["way"], row["way"])
    if name == Sent.CHOSEN:
        judged = f", {Outcome(row['outcome']).words}" if row["outcome"] else ""
        return Named(f"chosen: {method}{judged}", f"{words}{judged}")
    return Named(name, words)


def words(result: dict[str, Any]) -> str:
    """Return in words what became of the tool's orientation, and what is suspected."""
    lines = []
    for where, figures in list(result.get("validation", {}).items())[:1]:
        if all("orientation" in figures.get(how, {}) for how in BOTH):
            before, after = (figures[how]["orientation"] for how in BOTH)
            lines.append(
                f"Orientation of the tool at {where}: {before['mean_deg']:.4f} deg off before, "
                f"{after['mean_deg']:.4f} deg after (means); {result['fit']['orientation']}."
            )
    return "\n".join(line for line in (*lines, suspicion_words(result)) if line)


def station_table(result: dict[str, Any]) -> Table:
    """Return the quality of each station's frame."""
    return Table(
        [
            Column("station", itemgetter("station")),
            Column("strip", itemgetter("strip_mm"), "mm", ".2f"),
            Column("fit rms", itemgetter("rms_mm"), "mm", ".4f"),
            Column("tool point u", itemgetter("tool_uncertainty_mm"), "mm", ".4f"),
            Column("worst corner u", itemgetter("cube_uncertainty_mm"), "mm", ".4f"),
            Column("left out", lambda row: ", ".join(row["left_out"]) or "none"),
        ],
        [each | {"station": name} for name, each in result["stations"].items()],
    )


def point_table(result: dict[str, Any]) -> Table:
    """Return how many points of each group were measured."""
    points = Column("points", itemgetter(1), form="d")
    return Table([Column("group", itemgetter(0)), points], result["points"].items())


TO_STATION = (Home(), WorldFrame(), HoldStation())
TO_GRID = (*TO_STATION, BaseFrame(), RobotGrid())

HOME = Procedure("home", "park the robot; on a rail, reference its drive", (Home(),), point_table)
WORLD_FRAME = Procedure("world-frame", "frame {W}", (Home(), WorldFrame(proves=True)), point_table)
STATION_REPEATABILITY = Procedure(
    "station-repeatability",
    "15 approaches of a station without and with the strip",
    (Home(), WorldFrame(), StationRepeatability()),
    approach_table,
    of_rail=True,
)
RAIL_SURVEY = Procedure(
    "rail-survey",
    "the rail's error there and back, backlash, straightness, angles",
    (Home(), WorldFrame(), RailSurvey()),
    survey_table,
    of_rail=True,
)
FRAME_REPEATABILITY = Procedure(
    "frame-repeatability",
    "six slide points in base and station frames at every station",
    (*TO_STATION, BaseFrame(), RobotGrid(), StationFrames(), FrameRepeatability()),
    frame_repeatability_table,
    of_rail=True,
)
AXIS_SWEEPS = Procedure(
    "axis-sweeps",
    "slow sweeps of single axes, each gear's error",
    (*TO_STATION, BaseFrame(), AxisSweeps()),
    sweep_table,
    words=sweep_words,
)
BASE_FRAME = Procedure("base-frame", "frame {B}", (*TO_STATION, BaseFrame()), point_table)
ROBOT_GRID = Procedure("robot-grid", "measure the robot's error on the grid", TO_GRID, point_table)
STATION_FRAMES = Procedure(
    "station-frames",
    "frame the slide at every station",
    (*TO_GRID, StationFrames()),
    station_table,
    of_rail=True,
)
SIGN_CHECK = Procedure(
    "sign-check",
    "send one target as it is and corrected, and measure both",
    (*TO_GRID, StationFrames(), Fit(), SignCheck()),
    sign_table,
)
CALIBRATE = Procedure(
    "calibrate",
    "the paper's calibration, validated before and after at every station",
    (
        Home(),
        WorldFrame(),
        TwoFaces(),
        HoldStation(),
        BaseFrame(),
        RobotGrid(),
        AxisSweeps(),
        ChosenPoses(),
        Repeatability(),
        Revisits(),
        StationFrames(validated=True),
        Fit(),
        SignCheck(),
        Validate(),
        TwoFaces(at_end=True),
        Revisits(at_end=True),
    ),
    validation_table,
    words=words,
)
