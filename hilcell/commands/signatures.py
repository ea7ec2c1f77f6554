"""The signatures of all commands but `run`, apart from what they do: a parser needs them alone."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Literal

from hilcell.arguments import (
    BOUNDS,
    CELL,
    HOLES,
    JSON,
    JSON_LINES,
    MACHINE_SEED,
    NOTED,
    OUTPUT,
    RUN,
    RUNS,
    RUNS_HELP,
    SETTINGS,
    STROKE_MM,
    TARGETS,
    TOOL,
    Signature,
    days,
    folder,
    moment,
    name,
    noted,
    option,
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

HOLES_FILE: str = option(HOLES, "HOLES.csv", word=True)


class OfRun(Signature):
    """A run, and the folder where it is."""

    run: str = RUN
    runs: Path = RUNS


class Pause(OfRun):
    """Pause a live run after the point in flight."""

    json: bool = option("print JSON: the engine's answer", default=False)


class Stop(Pause):
    """Stop a live run now, safely; it can be resumed."""


class Watch(OfRun):
    """Follow a run from another terminal."""

    json: bool = JSON_LINES


class Tui(Signature):
    """The technician's screen: start, attach to or look at runs."""

    run: str = option(
        "a run's name, its beginning, or `last` (default: the live one, else the form)",
        "RUN",
        default="",
        word=True,
    )
    runs: Path = RUNS
    cell: str = CELL
    settings: tuple[tuple[str, str], ...] = SETTINGS
    theme: Literal["calm", "daylight", "contrast", "contrast-light"] = option(
        "calm is safe for colour-blind eyes (default)", default="calm"
    )
    colors: Literal["auto", "none", "16", "256", "truecolor"] = option(
        "what the terminal can show (default: auto)", default="auto"
    )
    ascii: bool = option("no shapes beyond ASCII", default=False)
    slow: bool = option("for thin links: once a second", default=False)
    keys: str = option(
        "other keys (default: keys.toml in the user's configuration, where it exists)",
        "FILE.toml",
        default="",
    )


class Plan(Signature):
    """Choose stations and orders for holes."""

    holes: str = HOLES_FILE
    cell: str = CELL
    settings: tuple[tuple[str, str], ...] = SETTINGS
    tool: str = TOOL
    free: bool = option("stations anywhere along the rail, too", default=False)
    output: str = option("CSV: station,order,name", "OUT", default="", flags=OUTPUT)
    calibration: str = option(
        "a run or calibration.json: no hole where `compensate` would refuse it",
        "CALIBRATION",
        default="",
    )
    release: Release
    json: bool = JSON


class Prepare(Signature):
    """Plan holes, correct them, and write a file of targets for each station."""

    holes: str = HOLES_FILE
    cell: str = CELL
    settings: tuple[tuple[str, str], ...] = SETTINGS
    tool: str = TOOL
    standoff: float | None = option(
        "along the outward normal, before and after each hole (default: the tool's of the "
        "cell file, at least its drill's length plus 20; 100 for the reflector)",
        "MM",
        standoff_of,
        default=None,
    )
    calibration: str = option("a run or calibration.json", "CALIBRATION")
    output: str = option("a new folder, or an empty one", "FOLDER", flags=OUTPUT)
    release: Release
    json: bool = JSON


class Compensate(Signature):
    """Correct targets by a calibration."""

    calibration: str = option("a run or calibration.json", "CALIBRATION", word=True)
    targets: str = option(
        f"targets in {{W}}, header {TARGETS}; or a robot program of an installed format",
        "TARGETS.csv|PROGRAM",
        word=True,
    )
    allow_stroke: float = option(
        "how far a program's relative motions along the tool may lead from their point "
        f"(default: {STROKE_MM:g})",
        "MM",
        stroke,
        default=STROKE_MM,
    )
    stroke_tolerance: float | None = option(
        "by how far these may miss, across and along, on all of their way (default: the 95 % "
        "bound of their point)",
        "MM",
        stroke_tolerance_of,
        default=None,
    )
    station: str = option("where they are reached", "S")
    output: str = option("corrected targets, or program", "OUT", flags=OUTPUT)
    cell: str = option(
        "refuse a calibration of another cell, and joint turns that change", "CELL", default=""
    )
    settings: tuple[tuple[str, str], ...] = SETTINGS
    tool: str = TOOL
    release: Release
    bounds: str = BOUNDS
    json: bool = JSON


class Show(OfRun):
    """Show a run, computed from its journal."""

    check: bool = option(
        "judge the run's invariants from its journal; exit 1 where one is broken", default=False
    )
    json: bool = JSON


class ListRuns(Signature):
    """List the runs."""

    cell: str | None = option("those of this cell, by its name", "NAME", default=None)
    operator: str | None = option("those of this operator", "NAME", noted, default=None)
    since: datetime | None = option(
        "those that began at 2026-11-22 or later, or 2026-11-22T14:00, in local time",
        "DATE",
        moment,
        default=None,
    )
    runs: Path = RUNS
    json: bool = option("print JSON: one object with all runs", default=False)


class Report(OfRun):
    """Write a run's report."""

    output: str = option(
        "one file; FILE.pdf is printed by a browser of this machine", "FILE.html", flags=OUTPUT
    )


class Export(OfRun):
    """Export a run's tables."""

    form: Literal["csv", "xlsx", "json", "dcc"] = option(
        switches={
            "csv": "the points",
            "xlsx": "a workbook: run, points, frames, results",
            "json": "everything",
            "dcc": "a Digital Calibration Certificate (PTB, XML)",
        }
    )
    output: str = option("where to write", "FILE", flags=OUTPUT)


class Compare(Signature):
    """Compare two runs of a cell: the drift between them."""

    first: str = option("the earlier run", "RUN", word=True)
    second: str = option("the later run", "RUN", word=True)
    runs: Path = RUNS
    json: bool = JSON


class Explain(Signature):
    """Say what an alarm means, and what to do."""

    code: str = option("as shown beside the alarm: HC-R31", "CODE", word=True)
    json: bool = JSON


class Revoke(OfRun):
    """Revoke the calibration of a run."""

    reason: str = option("kept in the journal", "TEXT", reason)
    operator: str = NOTED
    json: bool = JSON


class Check(Signature):
    """Check a cell file and its plan."""

    cell: str = option("a built-in name or a TOML path", "CELL", word=True)
    settings: tuple[tuple[str, str], ...] = SETTINGS
    json: bool = JSON


class Doctor(Signature):
    """Check this PC before a run; nothing moves."""

    cell: str = option(
        "also connect once to each device of a real cell that no run uses", "CELL", default=""
    )
    settings: tuple[tuple[str, str], ...] = SETTINGS
    runs: Path = RUNS
    json: bool = JSON


class Sim(Signature):
    """Run the simulated cell by itself."""

    cell: str = CELL
    settings: tuple[tuple[str, str], ...] = SETTINGS
    seed: int = option("of the machine (default: 1)", "N", seed_of, default=1)
    machine_seed: int | None = MACHINE_SEED
    truth: bool = option("the control channel answers what is true; for tests", default=False)
    speed: float = option(
        "a factor of real time, or as fast as it goes (default: 1)", "X|max", speed_of, default=1.0
    )
    faults: str = option(
        "faults to inject, TOML: docs/training.md has names and form", "FILE", default=""
    )
    train: bool = option("offer faults from a menu, to practise", default=False)
    ports: dict[str, int] | None = option(
        "TCP ports of rail, robot, tracker, control (default: free ones)",
        "NAME=PORT,...",
        ports_of,
        default=None,
    )


class Completion(Signature):
    """Print the script that completes commands in bash, zsh, fish or tcsh."""

    shell: Literal["bash", "zsh", "fish", "tcsh"] = option("the shell", word=True)


class Fit(Signature):
    """Fit measured data and judge the fit."""

    robot: str = option("nominal DH rows, or URDF", "ROBOT.toml|ROBOT.urdf")
    tip: str = option("of a URDF: the link where the arm ends", "LINK", default="")
    train: str = option("measured rows to learn from", "A.csv")
    test: str = option("rows to judge by (default: cross-validation)", "B.csv", default="")
    urdf_out: str = option("write the URDF with the identified arm", "FILE", default="")
    dh_out: str = option("write its DH table: CSV, or .json with covariance", "FILE", default="")
    correct: str = option("correct poses or joints", "TARGETS.csv|PROGRAM", default="")
    tool: str = option("the reflector that targets are meant for", "TARGET", default="")
    output: str = option("corrected targets, or program", "OUT", default="", flags=OUTPUT)
    bounds: str = BOUNDS
    json: bool = JSON


class RunStudy(Signature):
    """Simulate many cells before any exists: accuracy against minutes and money."""

    file: str = option("a study file (docs/study.md), or `report`", "FILE|report", word=True)
    folder: str = option("results to report", "DIR", default="", word=True)
    workers: int | None = option(
        "processes on this PC (default: one for each processor)", "N", workers_of, default=None
    )
    scheduler: str | None = option(
        "a Dask scheduler, tcp://HOST:PORT, whose workers measure",
        "ADDRESS",
        scheduler_of,
        default=None,
    )
    output: str = option(
        "folder of results (default: FILE-results); of a report its file "
        "(default: DIR/report.html)",
        "OUT",
        default="",
        flags=OUTPUT,
    )
    dry_run: bool = option("list the cases only", default=False)
    json: bool = JSON


class Diagram(Signature):
    """Print the state machines as Mermaid."""


class Plant(Signature):
    """Keep the records of all cells in one database, and ask it."""


DATABASE = (
    "the plant's database (default: HILCELL_PLANT): postgresql://USER@HOST/DATABASE, its password "
    "in ~/.pgpass, or sqlite:///FILE"
)
TO_PLANT = option(DATABASE, "URL", default=None, flags=("--to",))
FROM_PLANT = option(DATABASE, "URL", default=None, flags=("--from",))


class PlantInit(Signature):
    """Make the tables, or bring them up to this version's."""

    plant: str | None = TO_PLANT
    json: bool = JSON


class PlantShip(Signature):
    """Ship the runs that are over and not there yet."""

    plant: str | None = TO_PLANT
    runs: Path = option(RUNS_HELP, "DIR", folder, required=False, word=True)
    json: bool = JSON


class PlantShow(Signature):
    """Show cells, drift of robots, instruments and alarms."""

    plant: str | None = FROM_PLANT
    cell: str | None = option("of this cell alone", "NAME", name, default=None)
    robot: str | None = option(
        "of this robot and what was with it alone", "SERIAL", name, default=None
    )
    max_age: float = option(
        "how long a calibration is valid (default: 180)", "DAYS", days, default=180.0
    )
    json: bool = JSON


class PlantExport(Signature):
    """Write the record of one cell for an auditor, signed."""

    plant: str | None = FROM_PLANT
    cell: str = option("name of the cell", "CELL", word=True)
    serial: str | None = option("of the cell with this serial number", "SERIAL", default=None)
    out: Path = option("a new place", "FOLDER|FILE.zip", Path, flags=("-o",))
    key: Path = option("private key, Ed25519 in PEM", "KEYFILE", Path)
    json: bool = JSON


class PlantVerify(Signature):
    """Verify an exported record: each file that differs, is missing or is extra."""

    record: Path = option("what was exported", "FOLDER|FILE.zip", Path, word=True)
    public_key: Path = option("the plant's, in PEM", "FILE", Path)
    json: bool = JSON
