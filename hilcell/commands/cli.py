"""The command line: parses a command, runs its function and returns the exit code.

The module of a command is imported by name, so that each command loads only its own packages. Data
go to stdout, progress and messages to stderr.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

from hilcell import __version__
from hilcell.arguments import Signature
from hilcell.atomic_files import NotPrinted
from hilcell.commands import console, signatures
from hilcell.commands.parser import Parser, build
from hilcell.errors import EXIT_ABORTED, EXIT_REFUSED, HilcellError, exit_code
from hilcell.run.order import Order, Resume

if TYPE_CHECKING:
    from hilcell.decoding import Json

EXITS = (  # by code
    "in tolerance",
    "measured, out of tolerance",
    "refused before anything moved",
    "device fault, safe-stopped",
    "aborted by the operator",
    "internal error",
    "cell locked by another run",
    "storage fault",
)
AFTER = "After exit codes 3, 4, 5 and 7 of `run` and `resume` the last line tells how to resume."
OTHERS = """\
These are the exit codes of a run. Other commands return 0 on success, 2 if they refuse arguments, a
name or a file, 4 after ctrl-C, 5 after a defect of hilcell, and 7 if a journal, a disk or a pipe
failed (also if the reader of stdout ended early, as in `| head`)."""
OWN_EXITS = {  # of commands that differ from these
    "check": "2 if the cell file or its plan has a problem",
    "commission": "1 if a step has not proved what it should",
    "compare": "0 whatever changed: see `verdict` of `--json`",
    "doctor": "2 if something is WRONG; 0 with notes",
    "plant": "see [Records of a plant](plant.md)",
    "quickstart": "1 as well if a step has not proved what it should",
    "revoke": "6 while another run has locked the cell",
    "runs": "0 also with unreadable runs: see `state` of `--json`",
    "show": "0 whatever the run's outcome: see `exit` of `--json`; with `--check` 1 if an "
    "invariant is broken",
    "sim": "0 after ctrl-C",
    "study": "see [Design studies](study.md)",
    "tui": "0 however a run ended; 5 if the screen failed",
    "watch": "0 once the run has ended or its process has died, whatever the outcome: see `exit` "
    "of the `end` event of `--json`; 2 before the first record; 4 after ctrl-C, which does not "
    "affect the run, and is the only end of `--web`",
}
SAFETY = "hilcell is not a safety function: keep the E-stop within reach."
FIRST = """\
`hilcell run` calibrates a simulated cell in about a minute; nothing real moves
`hilcell show last` prints its result, `hilcell report last -o report.html` writes its report
your own cell: `hilcell check CELL.toml`, then `hilcell tui --cell CELL.toml`
`hilcell --help` lists all commands"""


Commands = Mapping[str, tuple[type[Signature], str]]  # signature, and module:function
GROUPS: Mapping[str, Commands] = {
    "daily work": {
        "run": (Order, "run:run"),
        "resume": (Resume, "run:resume"),
        "pause": (signatures.Pause, "control:pause"),
        "stop": (signatures.Stop, "control:stop"),
        "watch": (signatures.Watch, "control:watch"),
        "tui": (signatures.Tui, "tui:tui"),
        "plan": (signatures.Plan, "targets:plan"),
        "prepare": (signatures.Prepare, "targets:prepare"),
        "compensate": (signatures.Compensate, "targets:compensate"),
    },
    "records": {
        "show": (signatures.Show, "runs:show"),
        "runs": (signatures.ListRuns, "runs:runs"),
        "report": (signatures.Report, "runs:report"),
        "export": (signatures.Export, "runs:export"),
        "compare": (signatures.Compare, "runs:compare"),
        "explain": (signatures.Explain, "manual:explain"),
        "revoke": (signatures.Revoke, "runs:revoke"),
    },
    "setup": {
        "quickstart": (signatures.Quickstart, "quickstart:quickstart"),
        "commission": (signatures.Commission, "commission:commission"),
        "check": (signatures.Check, "cell:check"),
        "doctor": (signatures.Doctor, "doctor:doctor"),
        "files": (signatures.Files, "files:files"),
        "sim": (signatures.Sim, "cell:sim"),
        "completion": (signatures.Completion, "manual:completion"),
    },
    "engineering": {
        "fit": (signatures.Fit, "targets:fit"),
        "study": (signatures.RunStudy, "study:study"),
        "plant": (signatures.Plant, ""),
        "diagram": (signatures.Diagram, "cell:diagram"),
    },
}
PLANT: Commands = {
    "init": (signatures.PlantInit, "plant:init"),
    "ship": (signatures.PlantShip, "plant:ship"),
    "show": (signatures.PlantShow, "plant:show"),
    "assign": (signatures.PlantAssign, "plant:assign"),
    "held": (signatures.PlantHeld, "plant:held"),
    "archive": (signatures.PlantArchive, "plant:archive"),
    "export": (signatures.PlantExport, "plant:export"),
    "verify": (signatures.PlantVerify, "plant:verify"),
}


@cache
def whole_parser() -> Parser:
    codes = "; ".join(f"{code} {text}" for code, text in enumerate(EXITS))
    parser = Parser(
        prog="hilcell",
        description="Calibrates a robot on a cheap rail with a laser tracker, unattended.",
        epilog=f"{fill(f'exit codes: {codes}. {AFTER}', 91)}\n{SAFETY}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"hilcell {__version__}")
    parser.groups = GROUPS
    _add(parser, {name: each for group in GROUPS.values() for name, each in group.items()})
    return parser


def _add(parser: Parser, commands: Commands) -> None:
    parser.commands = subparsers = parser.add_subparsers(metavar="COMMAND", required=True)
    for name, (signature, function) in commands.items():
        text = signature.__doc__ or ""
        short = text[0].lower() + text[1:].rstrip(".")
        command = subparsers.add_parser(name, signature=signature, help=short, description=text)
        command.set_defaults(signature=signature, function=function)
        if name == "plant":
            _add(command, PLANT)


def read(words: Sequence[str]) -> tuple[str, type[Signature], Json]:
    """Return a command's module:function, its signature, and the parsed values."""
    values = vars(whole_parser().parse_args(words))
    return values.pop("function"), values.pop("signature"), values


def main(
    words: Sequence[str] | None = None, *, imported: Callable[[], object] = lambda: None
) -> int:
    """Run one command and return its exit code; ``imported`` is called before it begins."""
    console.never_fail_to_encode((sys.stdout, sys.stderr))
    words = sys.argv[1:] if words is None else words
    if not words:
        console.print_message(FIRST)
        return EXIT_REFUSED
    try:
        function, signature, values = read(words)
    except NotPrinted as error:  # the help
        return _refuse(error, as_json=False)
    # A second thread of the linear algebra makes many small matrices up to 30 times slower.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    module, _, name = function.partition(":")
    try:
        command = getattr(importlib.import_module(f"hilcell.commands.{module}"), name)
        imported()
        if "runs" in values:
            values["runs"] = _runs_folder(values["runs"])
        code = int(command(build(signature, values)))
        console.flush_data()
    except KeyboardInterrupt:
        console.print_message("hilcell: interrupted")
        return EXIT_ABORTED
    except Exception as error:  # noqa: BLE001 - the last place that can report it
        return _refuse(error, as_json=signature is Order and bool(values["json"]))
    else:
        return code


def _runs_folder(named: Path | None) -> Path:
    from hilcell.journal.runs_folder import at_home, usual_runs  # loads the journal

    if named is not None:
        folder = at_home(named)
        if os.path.exists(folder) and not os.path.isdir(folder):  # noqa: PTH110, PTH112 - no name raises
            raise HilcellError(f"--runs {folder}: expected a folder, got a file", code="HC-J09")
        return folder
    usual, note = usual_runs(os.environ)
    if note:
        console.print_message(note)
    return usual


def _refuse(error: Exception, *, as_json: bool) -> int:
    code = exit_code(error)
    console.print_error(error)
    if as_json:
        end: dict[str, object] = {"kind": "end", "run": None, "state": "idle", "exit": code}
        with suppress(NotPrinted):  # the first error is the one to report
            console.print_json(end | {"result": {}, "reason": str(error)})
            console.flush_data()
    return code
