"""The signatures of all commands but `run`, apart from what they do: a parser needs them alone."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

from hilcell.arguments import (
    HOLES,
    RUNS,
    STROKE_MM,
    TARGETS,
    Argument,
    Bounds,
    CellName,
    Json,
    JsonLines,
    MachineSeed,
    Noted,
    Output,
    RunName,
    Runs,
    Settings,
    Signature,
    Switches,
    ToolName,
    Word,
    days,
    folder,
    moment,
    name,
    noted,
    ports_of,
    reason,
    scheduler_of,
    seed_of,
    speed_of,
    standoff_of,
    stroke,
    stroke_tolerance_of,
    workers_of,
)
from hilcell.run.order import Release

HolesFile = Annotated[str, Word(HOLES, "HOLES.csv")]


class Pause(Signature):
    """Pause a live run after the point in flight."""

    run: RunName
    runs: Runs
    json: Annotated[bool, Argument("print JSON: the engine's answer")] = False


class Stop(Pause):
    """Stop a live run now, safely; it can be resumed."""


class Watch(Signature):
    """Follow a run from another terminal."""

    run: RunName
    runs: Runs
    json: JsonLines = False


class Tui(Signature):
    """The technician's screen: start, attach to or look at runs."""

    run: Annotated[
        str,
        Word(
            "a run's name, its beginning, or `last` (default: the live one, else the form)", "RUN"
        ),
    ] = ""
    runs: Runs
    cell: CellName = "paper"
    settings: Settings = ()
    theme: Annotated[
        Literal["calm", "daylight", "contrast", "contrast-light"],
        Argument("calm is safe for colour-blind eyes (default)"),
    ] = "calm"
    colors: Annotated[
        Literal["auto", "none", "16", "256", "truecolor"],
        Argument("what the terminal can show (default: auto)"),
    ] = "auto"
    ascii: Annotated[bool, Argument("no shapes beyond ASCII")] = False
    slow: Annotated[bool, Argument("for thin links: once a second")] = False
    keys: Annotated[
        str,
        Argument(
            "other keys (default: keys.toml in the user's configuration, where it exists)",
            "FILE.toml",
        ),
    ] = ""


class Plan(Signature):
    """Choose stations and orders for holes."""

    holes: HolesFile
    cell: CellName = "paper"
    settings: Settings = ()
    tool: ToolName = ""
    free: Annotated[bool, Argument("stations anywhere along the rail, too")] = False
    output: Annotated[str, Output("CSV: station,order,name", "OUT")] = ""
    calibration: Annotated[
        str,
        Argument(
            "a run or calibration.json: no hole where `compensate` would refuse it", "CALIBRATION"
        ),
    ] = ""
    release: Release
    json: Json = False


class Prepare(Signature):
    """Plan holes, correct them, and write a file of targets for each station."""

    holes: HolesFile
    cell: CellName = "paper"
    settings: Settings = ()
    tool: ToolName = ""
    standoff: Annotated[
        float | None,
        Argument(
            "along the outward normal, before and after each hole (default: the tool's of the "
            "cell file, at least its drill's length plus 20; 100 for the reflector)",
            "MM",
            standoff_of,
        ),
    ] = None
    calibration: Annotated[str, Argument("a run or calibration.json", "CALIBRATION")]
    output: Annotated[str, Output("a new folder, or an empty one", "FOLDER")]
    release: Release
    json: Json = False


class Compensate(Signature):
    """Correct targets by a calibration."""

    calibration: Annotated[str, Word("a run or calibration.json", "CALIBRATION")]
    targets: Annotated[
        str,
        Word(
            f"targets in {{W}}, header {TARGETS}; or a robot program of an installed format",
            "TARGETS.csv|PROGRAM",
        ),
    ]
    allow_stroke: Annotated[
        float,
        Argument(
            "how far a program's relative motions along the tool may lead from their point "
            f"(default: {STROKE_MM:g})",
            "MM",
            stroke,
        ),
    ] = STROKE_MM
    stroke_tolerance: Annotated[
        float | None,
        Argument(
            "by how far these may miss, across and along, on all of their way (default: the 95 % "
            "bound of their point)",
            "MM",
            stroke_tolerance_of,
        ),
    ] = None
    station: Annotated[str, Argument("where they are reached", "S")]
    output: Annotated[str, Output("corrected targets, or program", "OUT")]
    cell: Annotated[
        str, Argument("refuse a calibration of another cell, and joint turns that change", "CELL")
    ] = ""
    settings: Settings = ()
    tool: ToolName = ""
    release: Release
    bounds: Bounds = ""
    json: Json = False


class Show(Signature):
    """Show a run, computed from its journal."""

    run: RunName
    runs: Runs
    check: Annotated[
        bool, Argument("judge the run's invariants from its journal; exit 1 where one is broken")
    ] = False
    json: Json = False


class ListRuns(Signature):
    """List the runs."""

    cell: Annotated[str | None, Argument("those of this cell, by its name", "NAME")] = None
    operator: Annotated[str | None, Argument("those of this operator", "NAME", noted)] = None
    since: Annotated[
        datetime | None,
        Argument(
            "those that began at 2026-11-22 or later, or 2026-11-22T14:00, in local time",
            "DATE",
            moment,
        ),
    ] = None
    runs: Runs
    json: Annotated[bool, Argument("print JSON: one object with all runs")] = False


class Report(Signature):
    """Write a run's report."""

    run: RunName
    runs: Runs
    output: Annotated[
        str, Output("one file; FILE.pdf is printed by a browser of this machine", "FILE.html")
    ]


class Export(Signature):
    """Export a run's tables."""

    run: RunName
    runs: Runs
    form: Annotated[
        Literal["csv", "xlsx", "json", "dcc"],
        Switches(
            {
                "csv": "the points",
                "xlsx": "a workbook: run, points, frames, results",
                "json": "everything",
                "dcc": "a Digital Calibration Certificate (PTB, XML)",
            }
        ),
    ]
    output: Annotated[str, Output("where to write", "FILE")]


class Compare(Signature):
    """Compare two runs of a cell: the drift between them."""

    first: Annotated[str, Word("the earlier run", "RUN")]
    second: Annotated[str, Word("the later run", "RUN")]
    runs: Runs
    json: Json = False


class Explain(Signature):
    """Say what an alarm means, and what to do."""

    code: Annotated[str, Word("as shown beside the alarm: HC-R31", "CODE")]
    json: Json = False


class Revoke(Signature):
    """Revoke the calibration of a run."""

    run: RunName
    runs: Runs
    reason: Annotated[str, Argument("kept in the journal", "TEXT", reason)]
    operator: Noted = ""
    json: Json = False


class Check(Signature):
    """Check a cell file and its plan."""

    cell: Annotated[str, Word("a built-in name or a TOML path", "CELL")]
    settings: Settings = ()
    json: Json = False


class Doctor(Signature):
    """Check this PC before a run; nothing moves."""

    cell: Annotated[
        str, Argument("also connect once to each device of a real cell that no run uses", "CELL")
    ] = ""
    settings: Settings = ()
    runs: Runs
    json: Json = False


class Sim(Signature):
    """Run the simulated cell by itself."""

    cell: CellName = "paper"
    settings: Settings = ()
    seed: Annotated[int, Argument("of the machine (default: 1)", "N", seed_of)] = 1
    machine_seed: MachineSeed = None
    truth: Annotated[bool, Argument("the control channel answers what is true; for tests")] = False
    speed: Annotated[
        float,
        Argument("a factor of real time, or as fast as it goes (default: 1)", "X|max", speed_of),
    ] = 1.0
    faults: Annotated[
        str, Argument("faults to inject, TOML: docs/training.md has names and form", "FILE")
    ] = ""
    train: Annotated[bool, Argument("offer faults from a menu, to practise")] = False
    ports: Annotated[
        dict[str, int] | None,
        Argument(
            "TCP ports of rail, robot, tracker, control (default: free ones)",
            "NAME=PORT,...",
            ports_of,
        ),
    ] = None


class Completion(Signature):
    """Print the script that completes commands in bash, zsh, fish or tcsh."""

    shell: Annotated[Literal["bash", "zsh", "fish", "tcsh"], Word("the shell")]


class Fit(Signature):
    """Fit measured data and judge the fit."""

    robot: Annotated[str, Argument("nominal DH rows, or URDF", "ROBOT.toml|ROBOT.urdf")]
    tip: Annotated[str, Argument("of a URDF: the link where the arm ends", "LINK")] = ""
    train: Annotated[str, Argument("measured rows to learn from", "A.csv")]
    test: Annotated[str, Argument("rows to judge by (default: cross-validation)", "B.csv")] = ""
    urdf_out: Annotated[str, Argument("write the URDF with the identified arm", "FILE")] = ""
    dh_out: Annotated[
        str, Argument("write its DH table: CSV, or .json with covariance", "FILE")
    ] = ""
    correct: Annotated[str, Argument("correct poses or joints", "TARGETS.csv|PROGRAM")] = ""
    tool: Annotated[str, Argument("the reflector that targets are meant for", "TARGET")] = ""
    output: Annotated[str, Output("corrected targets, or program", "OUT")] = ""
    bounds: Bounds = ""
    json: Json = False


class RunStudy(Signature):
    """Simulate many cells before any exists: accuracy against minutes and money."""

    file: Annotated[str, Word("a study file (docs/study.md), or `report`", "FILE|report")]
    folder: Annotated[str, Word("results to report", "DIR")] = ""
    workers: Annotated[
        int | None,
        Argument("processes on this PC (default: one for each processor)", "N", workers_of),
    ] = None
    scheduler: Annotated[
        str | None,
        Argument(
            "a Dask scheduler, tcp://HOST:PORT, whose workers measure", "ADDRESS", scheduler_of
        ),
    ] = None
    output: Annotated[
        str,
        Output(
            "folder of results (default: FILE-results); of a report its file "
            "(default: DIR/report.html)",
            "OUT",
        ),
    ] = ""
    dry_run: Annotated[bool, Argument("list the cases only")] = False
    json: Json = False


class Diagram(Signature):
    """Print the state machines as Mermaid."""


class Plant(Signature):
    """Keep the records of all cells in one database, and ask it."""


DATABASE = (
    "the plant's database (default: HILCELL_PLANT): postgresql://USER@HOST/DATABASE, its password "
    "in ~/.pgpass, or sqlite:///FILE"
)
ToPlant = Annotated[str | None, Argument(DATABASE, "URL", names=("--to",))]
FromPlant = Annotated[str | None, Argument(DATABASE, "URL", names=("--from",))]


class PlantInit(Signature):
    """Make the tables, or bring them up to this version's."""

    plant: ToPlant = None
    json: Json = False


class PlantShip(Signature):
    """Ship the runs that are over and not there yet."""

    plant: ToPlant = None
    runs: Annotated[Path, Word(RUNS, "DIR", folder, required=False)]
    json: Json = False


class PlantShow(Signature):
    """Show cells, drift of robots, instruments and alarms."""

    plant: FromPlant = None
    cell: Annotated[str | None, Argument("of this cell alone", "NAME", name)] = None
    robot: Annotated[
        str | None, Argument("of this robot and what was with it alone", "SERIAL", name)
    ] = None
    max_age: Annotated[
        float, Argument("how long a calibration is valid (default: 180)", "DAYS", days)
    ] = 180.0
    json: Json = False


class PlantExport(Signature):
    """Write the record of one cell for an auditor, signed."""

    plant: FromPlant = None
    cell: Annotated[str, Word("name of the cell", "CELL")]
    serial: Annotated[str | None, Argument("of the cell with this serial number", "SERIAL")] = None
    out: Annotated[Path, Argument("a new place", "FOLDER|FILE.zip", Path, names=("-o",))]
    key: Annotated[Path, Argument("private key, Ed25519 in PEM", "KEYFILE", Path)]
    json: Json = False


class PlantVerify(Signature):
    """Verify an exported record: each file that differs, is missing or is extra."""

    record: Annotated[Path, Word("what was exported", "FOLDER|FILE.zip", Path)]
    public_key: Annotated[Path, Argument("the plant's, in PEM", "FILE", Path)]
    json: Json = False
