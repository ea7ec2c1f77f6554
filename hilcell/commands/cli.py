"""The command line: arguments in, exit code out. Each command imports its own heavy modules.

stdout carries data only; progress and messages go to stderr.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path

from hilcell import __version__
from hilcell.clean import clean
from hilcell.commands import arguments, options
from hilcell.commands.encoding import never_fail_to_encode
from hilcell.commands.output import (
    flush_data,
    print_error,
    print_json,
    print_message,
)
from hilcell.commands.parser import Parser
from hilcell.commands.plant_parser import add_plant
from hilcell.writing import NotPrinted

EPILOG = """\
exit codes: 0 in tolerance; 1 measured, out of tolerance; 2 refused before anything moved;
3 device fault, safe-stopped; 4 aborted by the operator; 5 internal error; 6 cell locked by
another run; 7 storage fault. After 3, 4 and 7, `hilcell resume RUN` continues.
hilcell is not a safety function: keep the E-stop in reach."""
FIRST = """\
`hilcell run` calibrates a simulated cell in about a minute; nothing real moves
`hilcell show last` shows its result; `hilcell report last -o report.html` prints it
your own cell: `hilcell check CELL.toml`, then `hilcell tui --cell CELL.toml`
`hilcell --help` lists all commands"""

GROUPS: dict[str, tuple[str, ...]] = {
    "every day": (
        "run",
        "resume",
        "pause",
        "stop",
        "watch",
        "tui",
        "plan",
        "prepare",
        "compensate",
    ),
    "look back": ("show", "runs", "report", "export", "compare", "explain", "revoke"),
    "set up": ("check", "doctor", "sim", "completion"),
    "for engineers": ("fit", "study", "plant", "diagram"),
}  # fmt: skip


@cache
def whole_parser() -> Parser:
    """Return the parser of all commands."""
    parser = Parser(
        prog="hilcell",
        description="Calibrates a robot on a cheap rail with a laser tracker, unattended.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"hilcell {__version__}")
    commands = parser.add_commands()
    parser.groups = GROUPS
    _add_run(commands)
    _add_live(commands)
    _add_tui(commands)
    _add_past(commands)
    _add_reports(commands)
    _add_cell(commands)
    _add_set_up(commands)
    _add_plan(commands)
    _add_files(commands)
    _add_study(commands)
    add_plant(commands)
    return parser


def _add_run(commands: argparse._SubParsersAction[Parser]) -> None:
    run = _command(commands, "run", "commands.run:run", "perform a procedure on a cell")
    run.add_argument("procedure", nargs="?", default="calibrate", help="default: calibrate")
    options.add_cell_options(run)
    run.add_argument(
        "--seed",
        type=arguments.seed_of,
        default=1,
        metavar="N",
        help="of random targets; of the simulated machine, too, unless it has its own (default: 1)",
    )
    options.add_machine_seed_option(run)
    options.add_runs_option(run)
    run.add_argument(
        "--speed",
        type=arguments.speed_of,
        metavar="X|max",
        help="of a simulated cell's time: a factor, or as fast as it goes (default: max)",
    )
    options.add_watch_options(run)
    run.add_argument(
        "--operator", type=clean, default="", metavar="NAME", help="kept in the journal"
    )
    run.add_argument(
        "--name",
        type=arguments.run_name,
        metavar="RUN",
        help="the run's name and folder (default: made of time and procedure)",
    )
    run.add_argument("--job", type=clean, default="", metavar="ID", help="kept in the journal")
    options.add_accept_options(run)
    run.add_argument("--dry-run", action="store_true", help="check and show the plan; open nothing")
    options.add_json_option(run, "one event a line, as journalled")
    resume = _command(commands, "resume", "commands.run:resume", "continue a run, or a paused one")
    options.add_run_argument(resume)
    options.add_watch_options(resume)
    resume.add_argument(
        "--accept-changes",
        action="store_true",
        help="go on with another device, cell file or version of hilcell; the journal keeps it",
    )
    resume.add_argument(
        "--retake",
        action="append",
        default=[],
        metavar="KEY",
        help="re-measure this point; may be repeated; opens a finished run again",
    )
    options.add_json_option(resume, "one event a line, as journalled")


def _add_live(commands: argparse._SubParsersAction[Parser]) -> None:
    for name, text in (
        ("pause", "pause a live run after the point in flight"),
        ("stop", "stop a live run now, safely; it can be resumed"),
    ):
        command = _command(commands, name, f"commands.live:{name}", text)
        options.add_run_argument(command)
        options.add_json_option(command, "the engine's answer")
    watch = _command(commands, "watch", "commands.live:watch", "follow a run from another terminal")
    options.add_run_argument(watch)
    options.add_json_option(watch, "one event a line, as journalled")


def _add_tui(commands: argparse._SubParsersAction[Parser]) -> None:
    tui = _command(
        commands,
        "tui",
        "commands.tui:tui",
        "the technician's screen: start, attach to or look at runs",
    )
    tui.add_argument(
        "run",
        nargs="?",
        default="",
        metavar="RUN",
        help="a run's name, its beginning, or `last` (default: the live one, else the form)",
    )
    options.add_runs_option(tui)
    options.add_cell_options(tui)
    tui.add_argument(
        "--theme",
        choices=("calm", "daylight", "contrast", "contrast-light"),
        default="calm",
        help="calm is safe for colour-blind eyes (default)",
    )
    tui.add_argument(
        "--colors",
        choices=("auto", "none", "16", "256", "truecolor"),
        default="auto",
        help="what the terminal can show (default: auto)",
    )
    tui.add_argument("--ascii", action="store_true", help="no shapes beyond ASCII")
    tui.add_argument("--slow", action="store_true", help="for thin links: once a second")
    tui.add_argument(
        "--keys",
        default="",
        metavar="FILE.toml",
        help="other keys (default: keys.toml in the user's configuration, where it exists)",
    )


def _add_past(commands: argparse._SubParsersAction[Parser]) -> None:
    runs = _command(commands, "runs", "commands.past:runs", "list the runs")
    runs.add_argument("--cell", metavar="NAME", help="those of this cell, by its name")
    runs.add_argument("--operator", metavar="NAME", help="those of this operator")
    runs.add_argument(
        "--since",
        type=arguments.moment,
        metavar="DATE",
        help="those that began at 2026-11-22 or later, or 2026-11-22T14:00, in local time",
    )
    options.add_runs_option(runs)
    options.add_json_option(runs, "one object with all runs")
    revoke = _command(
        commands, "revoke", "commands.revoke:revoke", "revoke the calibration of a run"
    )
    options.add_run_argument(revoke)
    revoke.add_argument(
        "--reason", type=arguments.reason, required=True, metavar="TEXT", help="kept in the journal"
    )
    revoke.add_argument(
        "--operator", type=clean, default="", metavar="NAME", help="kept in the journal"
    )
    options.add_json_option(revoke, "one object")
    compare = _command(
        commands,
        "compare",
        "commands.compare:compare",
        "compare two runs of a cell: the drift between them",
    )
    compare.add_argument("first", metavar="RUN", help="the earlier run")
    compare.add_argument("second", metavar="RUN", help="the later run")
    options.add_runs_option(compare)
    options.add_json_option(compare, "one object")
    explain = _command(
        commands, "explain", "commands.explain:explain", "say what an alarm means, and what to do"
    )
    explain.add_argument("code", metavar="CODE", help="as shown beside the alarm: HC-R31")
    options.add_json_option(explain, "one object")
    show = _command(commands, "show", "commands.past:show", "show a run, computed from its journal")
    options.add_run_argument(show)
    show.add_argument(
        "--check",
        action="store_true",
        help="judge the run's invariants from its journal; exit 1 where one is broken",
    )
    options.add_json_option(show, "one object")


def _add_reports(commands: argparse._SubParsersAction[Parser]) -> None:
    report = _command(commands, "report", "commands.report:report", "write a run's report")
    options.add_run_argument(report)
    report.add_argument(
        "-o",
        "--output",
        required=True,
        metavar="FILE.html",
        help="one file; FILE.pdf is printed by a browser of this machine",
    )
    export = _command(commands, "export", "commands.report:export", "export a run's tables")
    options.add_run_argument(export)
    forms = export.add_mutually_exclusive_group(required=True)
    for form, text in (
        ("csv", "the points"),
        ("xlsx", "a workbook: run, points, frames, results"),
        ("json", "everything"),
        ("dcc", "a Digital Calibration Certificate (PTB, XML)"),
    ):
        forms.add_argument(f"--{form}", dest="form", action="store_const", const=form, help=text)
    export.add_argument("-o", "--output", required=True, metavar="FILE", help="where to write")


def _add_cell(commands: argparse._SubParsersAction[Parser]) -> None:
    check = _command(commands, "check", "commands.cell:check", "check a cell file and its plan")
    check.add_argument("cell", metavar="CELL", help="a built-in name or a TOML path")
    options.add_set_option(check)
    options.add_json_option(check, "one object")
    sim = _command(commands, "sim", "commands.cell:sim", "run the simulated cell by itself")
    options.add_cell_options(sim)
    sim.add_argument(
        "--seed", type=arguments.seed_of, default=1, metavar="N", help="of the machine (default: 1)"
    )
    options.add_machine_seed_option(sim)
    sim.add_argument(
        "--truth", action="store_true", help="the control channel answers what is true; for tests"
    )
    sim.add_argument(
        "--speed", type=arguments.speed_of, default=1.0, metavar="X|max", help="default: 1"
    )
    sim.add_argument(
        "--faults",
        default="",
        metavar="FILE",
        help="faults to inject, TOML: docs/training.md has their names and their form",
    )
    sim.add_argument(
        "--train", action="store_true", help="offer faults from a menu, for technicians to practise"
    )
    sim.add_argument(
        "--ports",
        type=arguments.ports_of,
        default={},
        metavar="NAME=PORT,...",
        help="TCP ports of rail, robot, tracker, control (default: free ones)",
    )
    _command(commands, "diagram", "commands.cell:diagram", "print the state machines as Mermaid")


def _add_set_up(commands: argparse._SubParsersAction[Parser]) -> None:
    doctor = _command(
        commands, "doctor", "commands.doctor:doctor", "check this PC before a run; nothing moves"
    )
    doctor.add_argument(
        "--cell",
        default="",
        metavar="CELL",
        help="also connect once to each device of a real cell that no run is using",
    )
    options.add_set_option(doctor)
    options.add_runs_option(doctor)
    options.add_json_option(doctor, "one object")
    completion = _command(
        commands,
        "completion",
        "commands.completion:completion",
        "print the script that completes commands in a shell: bash, zsh, ..",
    )
    completion.add_argument("shell", choices=("bash", "zsh", "fish", "tcsh"), help="the shell")


def _add_plan(commands: argparse._SubParsersAction[Parser]) -> None:
    plan = _command(commands, "plan", "commands.plan:plan", "choose stations and orders for holes")
    plan.add_argument("holes", metavar="HOLES.csv", help=arguments.HOLES)
    options.add_cell_options(plan)
    options.add_tool_option(plan)
    plan.add_argument("--free", action="store_true", help="stations anywhere along the rail, too")
    plan.add_argument("-o", "--output", default="", metavar="OUT", help="CSV: station,order,name")
    plan.add_argument(
        "--calibration",
        default="",
        metavar="CALIBRATION",
        help="a run or calibration.json: no hole where `compensate` would refuse it",
    )
    options.add_release_options(plan)
    options.add_json_option(plan, "one object")
    prepare = _command(
        commands,
        "prepare",
        "commands.prepare:prepare",
        "plan holes, correct them, and write a file of targets for each station",
    )
    prepare.add_argument("holes", metavar="HOLES.csv", help=arguments.HOLES)
    options.add_cell_options(prepare)
    options.add_tool_option(prepare)
    prepare.add_argument(
        "--standoff",
        type=arguments.standoff,
        default=None,
        metavar="MM",
        help="along the outward normal, before and after each hole (default: the tool's of the "
        "cell file, at least its drill's length plus 20; 100 for the reflector)",
    )
    prepare.add_argument(
        "--calibration", required=True, metavar="CALIBRATION", help="a run or calibration.json"
    )
    prepare.add_argument(
        "-o", "--output", required=True, metavar="FOLDER", help="a new folder, or an empty one"
    )
    options.add_release_options(prepare)
    options.add_json_option(prepare, "one object")


def _add_files(commands: argparse._SubParsersAction[Parser]) -> None:
    fit = _command(commands, "fit", "commands.fit:fit", "fit measured data and judge the fit")
    fit.add_argument(
        "--robot", required=True, metavar="ROBOT.toml|ROBOT.urdf", help="nominal DH rows, or URDF"
    )
    fit.add_argument(
        "--tip", default="", metavar="LINK", help="of a URDF: the link where the arm ends"
    )
    fit.add_argument("--train", required=True, metavar="A.csv", help="measured rows to learn from")
    fit.add_argument("--test", metavar="B.csv", help="rows to judge by (default: cross-validation)")
    fit.add_argument(
        "--urdf-out", default="", metavar="FILE", help="write the URDF with the identified arm"
    )
    fit.add_argument(
        "--dh-out",
        default="",
        metavar="FILE",
        help="write its DH table: CSV, or .json with covariance",
    )
    fit.add_argument(
        "--correct", default="", metavar="TARGETS.csv|PROGRAM", help="correct poses or joints"
    )
    fit.add_argument(
        "--tool", default="", metavar="TARGET", help="the reflector that targets are meant for"
    )
    fit.add_argument(
        "-o", "--output", default="", metavar="OUT", help="corrected targets, or program"
    )
    options.add_bounds_option(fit)
    options.add_json_option(fit, "one object")
    compensate = _command(
        commands, "compensate", "commands.files:compensate", "correct targets by a calibration"
    )
    compensate.add_argument("calibration", metavar="CALIBRATION", help="a run or calibration.json")
    compensate.add_argument(
        "targets",
        metavar="TARGETS.csv|PROGRAM",
        help=f"nominal targets in {{W}}, header {arguments.TARGETS}; or a robot program of an "
        "installed format",
    )
    compensate.add_argument(
        "--allow-stroke",
        type=arguments.stroke,
        default=arguments.STROKE_MM,
        metavar="MM",
        help="how far a program's relative motions along the tool may lead from their point "
        f"(default: {arguments.STROKE_MM:g})",
    )
    compensate.add_argument(
        "--stroke-tolerance",
        type=arguments.stroke_tolerance,
        metavar="MM",
        help="by how far these may miss, across and along, on all of their way (default: the 95 %% "
        "bound of their point)",
    )
    compensate.add_argument("--station", required=True, metavar="S", help="where they are reached")
    compensate.add_argument(
        "-o", "--output", required=True, metavar="OUT", help="corrected targets, or program"
    )
    compensate.add_argument(
        "--cell",
        metavar="CELL",
        help="refuse a calibration of another cell, and turns of the joints that change",
    )
    options.add_set_option(compensate)
    options.add_tool_option(compensate)
    options.add_release_options(compensate)
    options.add_bounds_option(compensate)
    options.add_json_option(compensate, "one object")


def _add_study(commands: argparse._SubParsersAction[Parser]) -> None:
    study = _command(
        commands,
        "study",
        "commands.study:study",
        "simulate many cells before any exists: accuracy against minutes and money",
    )
    study.add_argument(
        "file", metavar="FILE|report", help="a study file (docs/study.md), or `report`"
    )
    study.add_argument("folder", nargs="?", default="", metavar="DIR", help="results to report")
    study.add_argument(
        "--workers",
        type=arguments.workers,
        metavar="N",
        help="processes on this PC (default: one for each processor)",
    )
    study.add_argument(
        "--scheduler",
        type=arguments.scheduler,
        metavar="ADDRESS",
        help="a Dask scheduler, tcp://HOST:PORT, whose workers measure",
    )
    study.add_argument(
        "-o",
        "--output",
        default="",
        metavar="OUT",
        help="folder of results (default: FILE-results); of a report its file "
        "(default: DIR/report.html)",
    )
    study.add_argument("--dry-run", dest="plan", action="store_true", help="list the cases only")
    options.add_json_option(study, "one object")


def _command(
    commands: argparse._SubParsersAction[Parser], name: str, act: str, text: str
) -> argparse.ArgumentParser:
    parser = commands.add_parser(name, help=text, description=text.capitalize() + ".")
    parser.set_defaults(act=act)
    return parser


def main(
    words: Sequence[str] | None = None, *, imported: Callable[[], object] = lambda: None
) -> int:
    """Run one command and return its exit code; ``imported`` is called when the command begins."""
    never_fail_to_encode((sys.stdout, sys.stderr))
    words = sys.argv[1:] if words is None else words
    if not words:
        print_message(FIRST)
        return 2
    try:
        args = whole_parser().parse_args(words)
    except NotPrinted as error:  # the help
        return _refuse(error, as_json=False)
    # Many small matrices: a second thread of the linear algebra makes them up to 30 times slower.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    module, _, function = args.act.partition(":")
    try:
        act = getattr(importlib.import_module(f"hilcell.{module}"), function)
        imported()
        if "runs" in args:
            args.runs = _runs_of(args.runs)
        code = int(act(args))
        flush_data()
    except KeyboardInterrupt:
        print_message("hilcell: interrupted")
        return 4
    except Exception as error:  # noqa: BLE001 - the last place where an error can be reported
        return _refuse(error, as_json=getattr(args, "json", False) and args.command == "run")
    else:
        return code


def _runs_of(named: Path | None) -> Path:
    from hilcell.errors import HilcellError
    from hilcell.journal.runs_folder import at_home, usual_runs  # loads the journal

    if named is not None:
        folder = at_home(named)
        if os.path.exists(folder) and not os.path.isdir(folder):  # noqa: PTH110, PTH112 - no name raises
            raise HilcellError(f"--runs {folder}: expected a folder, got a file", code="HC-J09")
        return folder
    usual = usual_runs(os.environ)
    if usual.note:
        print_message(usual.note)
    return usual.path


def _refuse(error: Exception, *, as_json: bool) -> int:
    from hilcell.run.exits import exit_code

    code = exit_code(error)
    print_error(error)
    if as_json:
        end: dict[str, object] = {"kind": "end", "run": None, "state": "idle", "exit": code}
        with suppress(NotPrinted):  # the first error is the one to report
            print_json(end | {"result": {}, "reason": str(error)})
            flush_data()
    return code
