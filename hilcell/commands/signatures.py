"""The arguments of all commands except `run` and `resume`: `hilcell.run.order` has theirs."""

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
    option,
    parse_days,
    parse_folder,
    parse_name,
    parse_note,
    parse_port,
    parse_ports,
    parse_reason,
    parse_scheduler,
    parse_seed,
    parse_speed,
    parse_standoff_mm,
    parse_stroke_mm,
    parse_stroke_tolerance_mm,
    parse_time,
    parse_workers,
)
from hilcell.run.order import Release

HOLES_FILE: str = option(HOLES, "HOLES.csv", positional=True)


class OfRun(Signature):
    """A run, and its folder of runs."""

    run: str = RUN
    runs: Path = RUNS


class Pause(OfRun):
    """Pause a live run after the present point."""

    json: bool = option("print the run's answer as JSON", default=False)


class Stop(Pause):
    """Stop a live run now, safely; it can be resumed."""


class Watch(OfRun):
    """Follow a run from another terminal."""

    json: bool = JSON_LINES
    web: bool = option(
        "serve a page that shows the run in a browser, until ctrl-C; `--json` prints its address",
        default=False,
    )
    bind: str = option("address of `--web` (default: 127.0.0.1, this PC only)", "IP", default="")
    port: int | None = option(
        "port of `--web` (default: a free one)", "PORT", parse_port, default=None
    )


class Tui(Signature):
    """Open the screen: start, follow and inspect runs."""

    run: str = option(
        "name of the run, its beginning, or `last` (default: the live run, else the start form)",
        "RUN",
        default="",
        positional=True,
    )
    runs: Path = RUNS
    cell: str = CELL
    settings: tuple[tuple[str, str], ...] = SETTINGS
    theme: Literal["calm", "daylight", "contrast", "contrast-light"] = option(
        "colours; calm suits colour-blind users (default: calm)", default="calm"
    )
    colors: Literal["auto", "none", "16", "256", "truecolor"] = option(
        "colours of the terminal (default: auto)", default="auto"
    )
    ascii: bool = option("use ASCII characters only", default=False)
    slow: bool = option("update once a second, for slow links", default=False)
    keys: str = option(
        "key bindings (default: keys.toml in the user's configuration)",
        "FILE.toml",
        default="",
    )


class Plan(Signature):
    """Choose stations for holes and the order of visits."""

    holes: str = HOLES_FILE
    cell: str = CELL
    settings: tuple[tuple[str, str], ...] = SETTINGS
    tool: str = TOOL
    free: bool = option("allow stations anywhere along the rail", default=False)
    output: str = option("CSV: station,order,name", "OUT", default="", flags=OUTPUT)
    calibration: str = option(
        "a run or calibration.json: plan only holes that `compensate` accepts",
        "CALIBRATION",
        default="",
    )
    release: Release
    json: bool = JSON


class Prepare(Signature):
    """Plan holes, correct them, and write the targets of each station."""

    holes: str = HOLES_FILE
    cell: str = CELL
    settings: tuple[tuple[str, str], ...] = SETTINGS
    tool: str = TOOL
    standoff: float | None = option(
        "distance along the outward normal before and after each hole (default: that of the tool "
        "in the cell file, at least the drill's length plus 20; 100 for the reflector)",
        "MM",
        parse_standoff_mm,
        default=None,
    )
    calibration: str = option("a run or calibration.json", "CALIBRATION")
    output: str = option("a new or empty folder", "FOLDER", flags=OUTPUT)
    release: Release
    json: bool = JSON


class Compensate(Signature):
    """Correct targets or a robot program by a calibration."""

    calibration: str = option("a run or calibration.json", "CALIBRATION", positional=True)
    targets: str = option(
        f"targets in {{W}}, header {TARGETS}; or a robot program of an installed format",
        "TARGETS.csv|PROGRAM",
        positional=True,
    )
    allow_stroke: float = option(
        "longest relative motion of a program along the tool, from its point "
        f"(default: {STROKE_MM:g})",
        "MM",
        parse_stroke_mm,
        default=STROKE_MM,
    )
    stroke_tolerance: float | None = option(
        "largest error of such motions, across and along (default: the 95 % bound of their point)",
        "MM",
        parse_stroke_tolerance_mm,
        default=None,
    )
    station: str = option("station from which the targets are reached", "S")
    output: str = option("corrected targets, or program", "OUT", flags=OUTPUT)
    cell: str = option(
        "cell of the calibration; also refuse changes of a joint's turn", "CELL", default=""
    )
    settings: tuple[tuple[str, str], ...] = SETTINGS
    tool: str = TOOL
    release: Release
    bounds: str = BOUNDS
    json: bool = JSON


class Show(OfRun):
    """Show a run and its results."""

    check: bool = option("check the run's invariants; exit 1 if one is broken", default=False)
    json: bool = JSON


class ListRuns(Signature):
    """List the runs."""

    cell: str | None = option("only runs of this cell", "NAME", default=None)
    operator: str | None = option("only runs of this operator", "NAME", parse_note, default=None)
    since: datetime | None = option(
        "only runs that began on or after 2026-11-22 or 2026-11-22T14:00, in local time",
        "DATE",
        parse_time,
        default=None,
    )
    runs: Path = RUNS
    json: bool = option("print one JSON object with all runs", default=False)


class Report(OfRun):
    """Write a run's report."""

    output: str = option(
        "the report; FILE.pdf needs a browser on this PC", "FILE.html", flags=OUTPUT
    )


class Export(OfRun):
    """Export a run's data."""

    form: Literal["csv", "xlsx", "json", "dcc", "urdf"] = option(
        switches={
            "csv": "points",
            "xlsx": "workbook of run, points, frames and results",
            "json": "all data",
            "dcc": "Digital Calibration Certificate (PTB, XML)",
            "urdf": "the identified arm: link parameters alone",
        }
    )
    output: str = option("the file to write", "FILE", flags=OUTPUT)


class Compare(Signature):
    """Compare two runs of a cell and list the changes."""

    first: str = option("earlier run", "RUN", positional=True)
    second: str = option("later run", "RUN", positional=True)
    runs: Path = RUNS
    json: bool = JSON


class Explain(Signature):
    """Explain an alarm and what to do."""

    code: str = option("code of the alarm, such as HC-R31", "CODE", positional=True)
    json: bool = JSON


class Revoke(OfRun):
    """Revoke the calibration of a run, or the verdict redo of a re-check."""

    reason: str = option("recorded in the journal", "TEXT", parse_reason)
    operator: str = NOTED
    json: bool = JSON


class Check(Signature):
    """Check a cell file and its plan."""

    cell: str = option("built-in cell or cell file", "CELL", positional=True)
    settings: tuple[tuple[str, str], ...] = SETTINGS
    json: bool = JSON


class Commission(Signature):
    """Commission a cell: find its devices, prove signs, scales and places, write its cell file."""

    cell: Path = option("cell file, new or begun", "CELL.toml", Path, positional=True)
    first: str = option("repeat this step and go on from it", "STEP", default="", flags=("--from",))
    only: str = option("perform this step alone", "STEP", default="")
    runs: Path = RUNS
    operator: str = NOTED
    list: bool = option("list the steps, who has proved them and when", default=False)
    report: str = option("write the page of the record, and perform nothing", "FILE", default="")


class Quickstart(Signature):
    """Calibrate a robot on the floor with three nests and one reflector, from no cell file on."""

    cell: Path = option("cell file, new or begun", "CELL.toml", Path, positional=True)
    runs: Path = RUNS
    operator: str = NOTED


class Doctor(Signature):
    """Check this PC; nothing moves."""

    cell: str = option(
        "also check the device connections of a cell that is not in use",
        "CELL",
        default="",
    )
    settings: tuple[tuple[str, str], ...] = SETTINGS
    runs: Path = RUNS
    json: bool = JSON


class Files(Signature):
    """Write the files that a driver needs on its device's controller, with a page of steps."""

    driver: str = option(
        "driver (default: list those with files)", "DRIVER", default="", positional=True
    )
    output: str = option("folder of the files", "FOLDER", default="", flags=OUTPUT)
    cell: str = option(
        "cell file whose addresses, ports and tool number are filled in", "CELL", default=""
    )
    force: bool = option("replace files of the folder that were changed", default=False)
    json: bool = JSON


class Sim(Signature):
    """Run a simulated cell on its own."""

    cell: str = CELL
    settings: tuple[tuple[str, str], ...] = SETTINGS
    seed: int = option("seed of the machine (default: 1)", "N", parse_seed, default=1)
    machine_seed: int | None = MACHINE_SEED
    truth: bool = option("answer true values on the control channel (for tests)", default=False)
    speed: float | None = option(
        "a factor of real time, or unlimited (default: 1; of cell unknown, max)",
        "X|max",
        parse_speed,
        default=None,
    )
    faults: str = option("TOML file of faults to inject (docs/training.md)", "FILE", default="")
    train: bool = option("training: inject faults from a menu", default=False)
    sheet: Path | None = option(
        "write the hall's sheet: text, JSON, the drawing of the nests, the volumes (default: hall, "
        "of cell unknown)",
        "FOLDER",
        parse_folder,
        default=None,
    )
    trap: str = option("set a trap in the truth, of which no cell file knows", "NAME", default="")
    traps: bool = option("only list the traps", default=False)
    ports: dict[str, int] | None = option(
        "TCP ports of rail, robot, tracker and control, 0 for a free one (default: free ports; of "
        "cell unknown, fixed ones)",
        "NAME=PORT,...",
        parse_ports,
        default=None,
    )


class Completion(Signature):
    """Print a completion script for bash, zsh, fish or tcsh."""

    shell: Literal["bash", "zsh", "fish", "tcsh"] = option("shell", positional=True)


class Fit(Signature):
    """Identify a robot from measured data, without a run."""

    robot: str = option("nominal DH rows or URDF", "ROBOT.toml|ROBOT.urdf")
    tip: str = option("last link of the arm in a URDF", "LINK", default="")
    base: str = option("link of a URDF that the arm stands on", "LINK", default="")
    coupling: Literal["0", "1", "-1"] = option(
        "turns of axis 3 by a turn of joint 2 alone, for a URDF (q3 = J3 + J2: 1)", default="0"
    )
    train: str = option("training data", "A.csv")
    test: str = option("test data (default: cross-validation)", "B.csv", default="")
    columns: str = option("names of both lists' columns", "FILE.toml|OURS=THEIRS,..", default="")
    urdf_out: str = option("write the identified arm as URDF", "FILE", default="")
    dh_out: str = option("write its DH table: CSV, or JSON with covariance", "FILE", default="")
    correct: str = option("poses or joints to correct", "TARGETS.csv|PROGRAM", default="")
    tool: str = option("reflector to which the targets refer", "TARGET", default="")
    output: str = option("corrected targets, or program", "OUT", default="", flags=OUTPUT)
    bounds: str = BOUNDS
    json: bool = JSON


class RunStudy(Signature):
    """Simulate variants of a cell to weigh accuracy against time and cost."""

    file: str = option("study file (docs/study.md), or `report`", "FILE|report", positional=True)
    folder: str = option("folder of results to report", "DIR", default="", positional=True)
    workers: int | None = option(
        "processes on this PC (default: one per processor)", "N", parse_workers, default=None
    )
    scheduler: str | None = option(
        "Dask scheduler that distributes the cases, tcp://HOST:PORT",
        "ADDRESS",
        parse_scheduler,
        default=None,
    )
    output: str = option(
        "folder of results (default: FILE-results), or file of the report "
        "(default: DIR/report.html)",
        "OUT",
        default="",
        flags=OUTPUT,
    )
    dry_run: bool = option("only plan each point, and list the cases", default=False)
    json: bool = JSON


class Diagram(Signature):
    """Print the state machines as Mermaid."""


class Plant(Signature):
    """Collect the records of all cells in one database."""


DATABASE = (
    "database of the plant: postgresql://USER@HOST/DATABASE, with the password in ~/.pgpass, or "
    "sqlite:///FILE (default: HILCELL_PLANT)"
)
TO_PLANT = option(DATABASE, "URL", default=None, flags=("--to",))
FROM_PLANT = option(DATABASE, "URL", default=None, flags=("--from",))


class PlantInit(Signature):
    """Create the tables, or upgrade them to this version."""

    plant: str | None = TO_PLANT
    json: bool = JSON


class PlantShip(Signature):
    """Copy ended runs that the database lacks."""

    plant: str | None = TO_PLANT
    runs: Path = option(RUNS_HELP, "DIR", parse_folder, required=False, positional=True)
    json: bool = JSON


class PlantShow(Signature):
    """Show cells, drift of robots, instruments and alarms."""

    plant: str | None = FROM_PLANT
    cell: str | None = option("only this cell", "NAME", parse_name, default=None)
    robot: str | None = option(
        "only this robot, its stations and instruments", "SERIAL", parse_name, default=None
    )
    max_age: float = option(
        "validity of a calibration (default: 180)", "DAYS", parse_days, default=180.0
    )
    all: bool = option("print all rows, not only those that ask for an act", default=False)
    check: bool = option("exit code 1 if a cell has no valid calibration", default=False)
    metrics: Path | None = option(
        "also write days left and last shipment of each cell, for Prometheus",
        "FILE.prom",
        Path,
        default=None,
    )
    json: bool = JSON


class PlantArchive(Signature):
    """Move the points of old runs to files; verdicts and all else stay in the database."""

    plant: str | None = FROM_PLANT
    before: datetime = option("only runs that ended before then", "DATE", parse_time)
    out: Path = option("folder of the files", "FOLDER", Path, flags=("-o",))
    json: bool = JSON


class PlantAssign(Signature):
    """Let one login ship a cell; without a cell, list the logins of all cells."""

    plant: str | None = TO_PLANT
    cell: str = option("name of the cell", "CELL", positional=True, default="")
    serial: str | None = option("serial number of the cell", "SERIAL", default=None)
    login: str = option("login that ships it from now on", "NAME", default="")
    json: bool = JSON


class PlantHeld(Signature):
    """List runs held apart, which ended in the future; accept or remove one."""

    plant: str | None = FROM_PLANT
    accept: str = option("let a held run count: its name or digest", "RUN", default="")
    remove: str = option("take a run out of all answers; it stays in exports", "RUN", default="")
    json: bool = JSON


class PlantExport(Signature):
    """Write the signed record of one cell for an audit."""

    plant: str | None = FROM_PLANT
    cell: str = option("name of the cell", "CELL", positional=True)
    serial: str | None = option("serial number of the cell", "SERIAL", default=None)
    out: Path = option("new folder or archive", "FOLDER|FILE.zip", Path, flags=("-o",))
    key: Path = option("private key: Ed25519, PEM", "KEYFILE", Path)
    archive: Path | None = option(
        "folder of `hilcell plant archive`, with the points of old runs",
        "FOLDER",
        Path,
        default=None,
    )
    json: bool = JSON


class PlantVerify(Signature):
    """Verify an exported record: list files that differ, are missing or were added."""

    record: Path = option("exported record", "FOLDER|FILE.zip", Path, positional=True)
    public_key: Path = option("public key of the plant: PEM", "FILE", Path)
    json: bool = JSON
