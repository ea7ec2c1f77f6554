"""The paper's calibration, from power-on to a validated correction, and its steps one by one."""

from __future__ import annotations

from operator import itemgetter

from hilcell.decoding import typed
from hilcell.model.results import Place
from hilcell.model.verdicts import suspected_in
from hilcell.present.table import Column, Table
from hilcell.run.procedure import Procedure, Result
from procedures.axis_sweeps import AxisSweeps
from procedures.base_frame import BaseFrame
from procedures.fit import Choice, Fit, SignCheck
from procedures.rail import HoldStation, RailSurvey, StationRepeatability
from procedures.recalibration import TABLE, CarriedArm, Change, Once
from procedures.repeatability import Repeatability, Revisits
from procedures.robot_grid import ChosenPoses, RobotGrid
from procedures.station_frames import FrameRepeatability, StationFrames
from procedures.validate import Validate
from procedures.world_frame import Home, TwoFaces, WorldFrame


def words(result: Result) -> str:
    lines = []
    if "known_arm" in result:
        lines.append(typed(result["known_arm"], Change).text)
    for where, place in list(typed(result.get("validation", {}), dict[str, Place]).items())[:1]:
        before, after = place.before.orientation, place.chosen.orientation
        if before is not None and after is not None:
            lines.append(
                f"Orientation of the tool at {where}: {before.mean_deg:.4f} deg off before, "
                f"{after.mean_deg:.4f} deg after (means); "
                f"{typed(result['fit'], Choice).orientation}."
            )
    lines += [f"Suspected: {each.text}. {each.cause.advice}" for each in suspected_in(result)]
    return "\n".join(lines)


def point_table(result: Result) -> Table:
    points = Column("points", itemgetter(1), form="d")
    counts = typed(result["points"], dict[str, int])
    return Table([Column("group", itemgetter(0)), points], counts.items())


TO_STATION = (Home(), WorldFrame(), HoldStation())
TO_GRID = (*TO_STATION, BaseFrame(), RobotGrid())

HOME = Procedure("home", "park the robot; on a rail, reference its drive", (Home(),), point_table)
WORLD_FRAME = Procedure(
    "world-frame",
    "frame {W}",
    (Home(), WorldFrame(verifies=True)),
    point_table,
    words=WorldFrame.words,
)
STATION_REPEATABILITY = Procedure(
    "station-repeatability",
    "15 approaches of a station without and with the strip",
    (Home(), WorldFrame(), StationRepeatability()),
    StationRepeatability.table,
    of_rail=True,
)
RAIL_SURVEY = Procedure(
    "rail-survey",
    "the rail's error there and back, backlash, straightness, angles",
    (Home(), WorldFrame(), RailSurvey()),
    RailSurvey.table,
    of_rail=True,
)
FRAME_REPEATABILITY = Procedure(
    "frame-repeatability",
    "six slide points in base and station frames at every station",
    (*TO_STATION, BaseFrame(), RobotGrid(), StationFrames(), FrameRepeatability()),
    FrameRepeatability.table,
    of_rail=True,
)
AXIS_SWEEPS = Procedure(
    "axis-sweeps",
    "slow sweeps of single axes, each gear's error",
    (*TO_STATION, BaseFrame(), AxisSweeps()),
    AxisSweeps.table,
    words=AxisSweeps.words,
)
BASE_FRAME = Procedure("base-frame", "frame {B}", (*TO_STATION, BaseFrame()), point_table)
ROBOT_GRID = Procedure("robot-grid", "measure the robot's error on the grid", TO_GRID, point_table)
STATION_FRAMES = Procedure(
    "station-frames",
    "frame the slide at every station",
    (*TO_GRID, StationFrames()),
    StationFrames.table,
    of_rail=True,
)
SIGN_CHECK = Procedure(
    "sign-check",
    "send one target as it is and corrected, and measure both",
    (*TO_GRID, StationFrames(), Fit(), SignCheck()),
    SignCheck.table,
)
CALIBRATE = Procedure(
    "calibrate",
    "the paper's calibration, validated before and after at every station",
    (
        CarriedArm(),
        Home(),
        WorldFrame(),
        TwoFaces(),
        HoldStation(),
        BaseFrame(),
        RobotGrid(),
        Once(AxisSweeps()),
        ChosenPoses(),
        Once(Repeatability()),
        Once(Revisits()),
        StationFrames(validated=True),
        Fit(),
        SignCheck(),
        Validate(),
        TwoFaces(at_end=True),
        Revisits(at_end=True),
    ),
    Validate.table,
    words=words,
    may_use=TABLE,
    quick=True,
)
