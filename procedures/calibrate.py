"""The paper's calibration, from power-on to a validated correction, and its steps one by one."""

from __future__ import annotations

from operator import itemgetter

from hilcell.decoding import typed
from hilcell.geometry.statistics import Figures
from hilcell.model.point import Sent
from hilcell.model.results import FramedStation, Place
from hilcell.present.table import Column, Named, Table, Value
from hilcell.run.procedure import Procedure, Result
from procedures.axis_sweeps import AxisSweeps, sweep_table, sweep_words
from procedures.base_frame import BaseFrame
from procedures.fit import Choice, Fit, SignCheck, sign_table
from procedures.rail import (
    HoldStation,
    RailSurvey,
    StationRepeatability,
    approach_table,
    survey_table,
)
from procedures.repeatability import Repeatability, Revisits, suspicion_words
from procedures.robot_grid import ChosenPoses, RobotGrid
from procedures.station_frames import FrameRepeatability, StationFrames, frame_repeatability_table
from procedures.validate import Validate
from procedures.world_frame import Home, TwoFaces, WorldFrame


def validation_table(result: Result) -> Table:
    places, method = typed(result["validation"], dict[str, Place]), str(result["method"])
    rows = list[tuple[Value, ...]]()
    for where, place in places.items():
        judged = "" if place.decision is None else f", {place.decision.outcome.text}"
        named = {way: Named(way, way.text) for way in Sent}
        named[Sent.CHOSEN] = Named(f"chosen: {method}{judged}", f"{Sent.CHOSEN.text}{judged}")
        for way, errors in place.sent.items():
            figures = [getattr(errors, name) for name in Figures._fields]
            figures += [
                getattr(errors.orientation, f"{name}_deg", None) for name in Figures._fields
            ]
            first = where if way is Sent.BEFORE else ""
            rows.append((first, place.points_sent.get(way), named[way], *figures))
        if place.floor is not None:  # the errors that are left
            left = place.floor.mean, place.floor.p95, None
            rows.append(("", None, Named("floor", "floor"), *left, None, None, None))
    oriented = any(place.before.orientation is not None for place in places.values())
    turns = Figures._fields if oriented else ()
    return Table(
        [
            Column("station", itemgetter(0)),
            Column("points", itemgetter(1), form="d"),
            Column("error of", itemgetter(2)),
            *(Column(n, itemgetter(at), "mm", ".4f") for at, n in enumerate(Figures._fields, 3)),
            *(Column(f"turn {n}", itemgetter(at), "°", ".4f") for at, n in enumerate(turns, 6)),
        ],
        rows,
    )


def words(result: Result) -> str:
    lines = []
    for where, place in list(typed(result.get("validation", {}), dict[str, Place]).items())[:1]:
        before, after = place.before.orientation, place.chosen.orientation
        if before is not None and after is not None:
            lines.append(
                f"Orientation of the tool at {where}: {before.mean_deg:.4f} deg off before, "
                f"{after.mean_deg:.4f} deg after (means); "
                f"{typed(result['fit'], Choice).orientation}."
            )
    return "\n".join(line for line in (*lines, suspicion_words(result)) if line)


def station_table(result: Result) -> Table:
    return Table(
        [
            Column("station", itemgetter(0)),
            Column("strip", lambda row: row[1].strip_mm, "mm", ".2f"),
            Column("fit rms", lambda row: row[1].rms_mm, "mm", ".4f"),
            Column("tool point u", lambda row: row[1].tool_uncertainty_mm, "mm", ".4f"),
            Column("worst corner u", lambda row: row[1].cube_uncertainty_mm, "mm", ".4f"),
            Column("left out", lambda row: ", ".join(row[1].left_out) or "none"),
        ],
        typed(result["stations"], dict[str, FramedStation]).items(),
    )


def point_table(result: Result) -> Table:
    points = Column("points", itemgetter(1), form="d")
    counts = typed(result["points"], dict[str, int])
    return Table([Column("group", itemgetter(0)), points], counts.items())


TO_STATION = (Home(), WorldFrame(), HoldStation())
TO_GRID = (*TO_STATION, BaseFrame(), RobotGrid())

HOME = Procedure("home", "park the robot; on a rail, reference its drive", (Home(),), point_table)
WORLD_FRAME = Procedure(
    "world-frame", "frame {W}", (Home(), WorldFrame(verifies=True)), point_table
)
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
