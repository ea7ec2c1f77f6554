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
from pathlib import Path

from hilcell import __version__
from hilcell.clean import clean
from hilcell.commands import arguments
from hilcell.commands.encoding import never_fail_to_encode
from hilcell.commands.output import (
    flush_data,
    print_error,
    print_json,
    print_message,
)
from hilcell.commands.parser import Parser
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


def _parser() -> Parser:
    parser = Parser(
        prog="hilcell",
        description="Calibrates a robot on a cheap rail with a laser tracker, unattended.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"hilcell {__version__}")
    commands = parser.add_commands()
    _add_run(commands)
    _add_live(commands)
    _add_tui(commands)
    _add_past(commands)
    _add_reports(commands)
    _add_cell(commands)
    _add_plan(commands)
    _add_files(commands)
    return parser


def _add_run(commands: argparse._SubParsersAction[Parser]) -> None:
    run = _command(commands, "run", "commands.run:run", "perform a procedure on a cell")
    run.add_argument("procedure", nargs="?", default="calibrate", help="default: calibrate")
    _cell_options(run)
    run.add_argument(
        "--seed",
        type=arguments.seed_of,
        default=1,
        metavar="N",
        help="of random targets; of the simulated machine, too, unless it has its own (default: 1)",
    )
    _machine_seed_option(run)
    _runs_option(run)
    run.add_argument(
        "--speed",
        type=arguments.speed_of,
        metavar="X|max",
        help="of a simulated cell's time: a factor, or as fast as it goes (default: max)",
    )
    _watch_options(run)
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
    _accept_options(run)
    run.add_argument("--dry-run", action="store_true", help="check and show the plan; open nothing")
    _json_option(run, "one event a line, as journalled")
    resume = _command(commands, "resume", "commands.run:resume", "continue a run, or a paused one")
    _run_argument(resume)
    _watch_options(resume)
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
    _json_option(resume, "one event a line, as journalled")


def _add_live(commands: argparse._SubParsersAction[Parser]) -> None:
    for name, text in (
        ("pause", "pause a live run after the point in flight"),
        ("stop", "stop a live run now, safely; it can be resumed"),
    ):
        command = _command(commands, name, f"commands.live:{name}", text)
        _run_argument(command)
        _json_option(command, "the engine's answer")
    watch = _command(commands, "watch", "commands.live:watch", "follow a run from another terminal")
    _run_argument(watch)
    _json_option(watch, "one event a line, as journalled")


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
    _runs_option(tui)
    _cell_options(tui)
    tui.add_argument(
        "--theme",
        choices=("calm", "daylight", "contrast"),
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
    _runs_option(runs)
    _json_option(runs, "one object with all runs")
    revoke = _command(
        commands, "revoke", "commands.revoke:revoke", "revoke the calibration of a run"
    )
    _run_argument(revoke)
    revoke.add_argument(
        "--reason", type=arguments.reason, required=True, metavar="TEXT", help="kept in the journal"
    )
    revoke.add_argument(
        "--operator", type=clean, default="", metavar="NAME", help="kept in the journal"
    )
    _json_option(revoke, "one object")
    compare = _command(
        commands,
        "compare",
        "commands.compare:compare",
        "compare two runs of a cell: the drift between them",
    )
    compare.add_argument("first", metavar="RUN", help="the earlier run")
    compare.add_argument("second", metavar="RUN", help="the later run")
    _runs_option(compare)
    _json_option(compare, "one object")
    explain = _command(
        commands, "explain", "commands.explain:explain", "say what an alarm means, and what to do"
    )
    explain.add_argument("code", metavar="CODE", help="as shown beside the alarm: HC-R31")
    _json_option(explain, "one object")
    show = _command(commands, "show", "commands.past:show", "show a run, computed from its journal")
    _run_argument(show)
    show.add_argument(
        "--check",
        action="store_true",
        help="judge the run's invariants from its journal; exit 1 where one is broken",
    )
    _json_option(show, "one object")


def _add_reports(commands: argparse._SubParsersAction[Parser]) -> None:
    report = _command(commands, "report", "commands.report:report", "write a run's report")
    _run_argument(report)
    report.add_argument(
        "-o",
        "--output",
        required=True,
        metavar="FILE.html",
        help="one file; FILE.pdf is printed by a browser of this machine",
    )
    export = _command(commands, "export", "commands.report:export", "export a run's tables")
    _run_argument(export)
    forms = export.add_mutually_exclusive_group(required=True)
    for form, text in (
        ("csv", "the points"),
        ("xlsx", "a workbook: run, points, frames, results"),
        ("json", "everything"),
    ):
        forms.add_argument(f"--{form}", dest="form", action="store_const", const=form, help=text)
    export.add_argument("-o", "--output", required=True, metavar="FILE", help="where to write")


def _add_cell(commands: argparse._SubParsersAction[Parser]) -> None:
    check = _command(commands, "check", "commands.cell:check", "check a cell file and its plan")
    check.add_argument("cell", metavar="CELL", help="a built-in name or a TOML path")
    _set_option(check)
    _json_option(check, "one object")
    sim = _command(commands, "sim", "commands.cell:sim", "run the simulated cell by itself")
    _cell_options(sim)
    sim.add_argument(
        "--seed", type=arguments.seed_of, default=1, metavar="N", help="of the machine (default: 1)"
    )
    _machine_seed_option(sim)
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


def _add_plan(commands: argparse._SubParsersAction[Parser]) -> None:
    plan = _command(commands, "plan", "commands.plan:plan", "choose stations and orders for holes")
    plan.add_argument("holes", metavar="HOLES.csv", help=arguments.HOLES)
    _cell_options(plan)
    plan.add_argument("--free", action="store_true", help="stations anywhere along the rail, too")
    plan.add_argument("-o", "--output", default="", metavar="OUT", help="CSV: station,order,name")
    plan.add_argument(
        "--calibration",
        default="",
        metavar="CALIBRATION",
        help="a run or calibration.json: no hole where `compensate` would refuse it",
    )
    _release_options(plan)
    _json_option(plan, "one object")
    prepare = _command(
        commands,
        "prepare",
        "commands.prepare:prepare",
        "plan holes, correct them, and write a file of targets for each station",
    )
    prepare.add_argument("holes", metavar="HOLES.csv", help=arguments.HOLES)
    _cell_options(prepare)
    prepare.add_argument(
        "--calibration", required=True, metavar="CALIBRATION", help="a run or calibration.json"
    )
    prepare.add_argument(
        "-o", "--output", required=True, metavar="FOLDER", help="a new folder, or an empty one"
    )
    _release_options(prepare)
    _json_option(prepare, "one object")


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
    _bounds_option(fit)
    _json_option(fit, "one object")
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
    compensate.add_argument("--station", required=True, metavar="S", help="where they are reached")
    compensate.add_argument(
        "-o", "--output", required=True, metavar="OUT", help="corrected targets, or program"
    )
    compensate.add_argument(
        "--cell",
        metavar="CELL",
        help="refuse a calibration of another cell, and turns of the joints that change",
    )
    _set_option(compensate)
    _release_options(compensate)
    _bounds_option(compensate)
    _json_option(compensate, "one object")


def _release_options(parser: argparse.ArgumentParser) -> None:
    """Add the conditions under which a calibration is used."""
    parser.add_argument(
        "--temperature",
        type=arguments.finite,
        metavar="T_C",
        help="the room's: refuse one further than 2 K from the calibrated",
    )
    parser.add_argument(
        "--max-age",
        type=arguments.days,
        default=180.0,
        metavar="DAYS",
        help="refuse an older calibration (default: 180)",
    )
    _accept_options(parser)
    _runs_option(parser)


def _accept_options(parser: argparse.ArgumentParser) -> None:
    """Add what a calibration is used in spite of; the output, or the journal, says so."""
    parser.add_argument(
        "--accept-out-of-tolerance",
        action="store_true",
        help="use a calibration whose validation failed, was not made or had another tolerance",
    )
    parser.add_argument(
        "--accept-not-current",
        action="store_true",
        help="use a calibration that is revoked, superseded or out of date",
    )


def _command(
    commands: argparse._SubParsersAction[Parser], name: str, act: str, text: str
) -> argparse.ArgumentParser:
    parser = commands.add_parser(name, help=text, description=text.capitalize() + ".")
    parser.set_defaults(act=act)
    return parser


def _cell_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--cell",
        default="paper",
        metavar="CELL",
        help="a built-in name or a TOML path (default: paper, simulated)",
    )
    _set_option(parser)


def _set_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        type=arguments.assignment,
        metavar="KEY=VALUE",
        help="override one value of the cell file; may be repeated",
    )


def _run_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", metavar="RUN", help="a run's name, its beginning, or `last`")
    _runs_option(parser)


def _runs_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--runs",
        type=Path,
        default=Path("runs"),
        metavar="DIR",
        help="folder of runs (default: runs)",
    )


def _watch_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--unattended", action="store_true", help="nobody is there to ask")
    parser.add_argument(
        "--screen",
        action="store_true",
        help="a screen has ordered this: nothing moves before one attends",
    )


def _bounds_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--bounds",
        default="",
        metavar="FILE.csv",
        help="also write the 95 %% bound of each target's error, and u of its coordinates",
    )


def _json_option(parser: argparse.ArgumentParser, text: str) -> None:
    parser.add_argument("--json", action="store_true", help=f"print JSON: {text}")


def _machine_seed_option(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--machine-seed",
        type=arguments.seed_of,
        default=None,
        metavar="N",
        help="of the simulated machine: robot, rail, tracker (default: the seed; where a run uses "
        "a calibration, that of the calibrated machine)",
    )


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
        args = _parser().parse_args(words)
    except NotPrinted as error:  # the help
        return _refuse(error, as_json=False)
    # Many small matrices: a second thread of the linear algebra makes them up to 30 times slower.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    module, _, function = args.act.partition(":")
    try:
        act = getattr(importlib.import_module(f"hilcell.{module}"), function)
        imported()
        code = int(act(args))
        flush_data()
    except KeyboardInterrupt:
        print_message("hilcell: interrupted")
        return 4
    except Exception as error:  # noqa: BLE001 - the last place where an error can be reported
        return _refuse(error, as_json=getattr(args, "json", False) and args.command == "run")
    else:
        return code


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
