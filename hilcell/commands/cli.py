"""The command line: words in, exit code out. Each command imports its own heavy modules.

stdout carries data only; progress and messages go to stderr.
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
from hilcell.commands.parser import Parser, made
from hilcell.errors import EXIT_ABORTED, EXIT_REFUSED, HilcellError, exit_code
from hilcell.run.order import Order, Resume

if TYPE_CHECKING:
    from hilcell.decoding import Json

EXITS = (  # by their number
    "in tolerance",
    "measured, out of tolerance",
    "refused before anything moved",
    "device fault, safe-stopped",
    "aborted by the operator",
    "internal error",
    "cell locked by another run",
    "storage fault",
)
AFTER = (
    "Where `run` or `resume` ends with 3, 4, 5 or 7 and the run can go on, the last line says how."
)
OTHERS = """\
These are of a run. Any other command ends with 0 where it did its work, 2 where it refuses its
arguments, a name or a file, 4 where ctrl-C ended it, 5 after a defect of hilcell, and 7 where a
journal, a disk or a pipe failed: also where the reader of stdout went away, as in `| head`."""
OWN_EXITS = {  # of commands, beyond these
    "check": "2 where the cell file or its plan has a problem",
    "compare": "0 whatever has changed: `verdict` of `--json` says it",
    "doctor": "2 where something is WRONG; notes alone are 0",
    "plant": "[Records of a plant](plant.md) lists them",
    "revoke": "6 while another run holds the cell",
    "runs": "0 with unreadable runs as well: `state` of `--json` says it",
    "show": "0 whatever the run's outcome: `exit` of `--json` has its code; with `--check` 1 where "
    "an invariant is broken",
    "sim": "0 after ctrl-C, which ends it",
    "study": "[Design studies](study.md) lists them",
    "tui": "0 however a run ended; 5 where the screen failed",
    "watch": "0 where the run has ended or its engine is gone, whatever its outcome: `exit` of the "
    "`end` event of `--json` has its code; 2 before the first record; 4 after ctrl-C, which "
    "changes nothing of the run",
}
SAFETY = "hilcell is not a safety function: keep the E-stop in reach."
FIRST = """\
`hilcell run` calibrates a simulated cell in about a minute; nothing real moves
`hilcell show last` shows its result; `hilcell report last -o report.html` prints it
your own cell: `hilcell check CELL.toml`, then `hilcell tui --cell CELL.toml`
`hilcell --help` lists all commands"""


Commands = Mapping[str, tuple[type[Signature], str]]  # what each takes, and module:function
GROUPS: Mapping[str, Commands] = {
    "every day": {
        "run": (Order, "run:run"),
        "resume": (Resume, "run:resume"),
        "pause": (signatures.Pause, "control:pause"),
        "stop": (signatures.Stop, "control:stop"),
        "watch": (signatures.Watch, "control:watch"),
        "tui": (signatures.Tui, "tui:tui"),
        "plan": (signatures.Plan, "prepare:plan"),
        "prepare": (signatures.Prepare, "prepare:prepare"),
        "compensate": (signatures.Compensate, "targets:compensate"),
    },
    "look back": {
        "show": (signatures.Show, "runs:show"),
        "runs": (signatures.ListRuns, "runs:runs"),
        "report": (signatures.Report, "runs:report"),
        "export": (signatures.Export, "runs:export"),
        "compare": (signatures.Compare, "runs:compare"),
        "explain": (signatures.Explain, "manual:explain"),
        "revoke": (signatures.Revoke, "runs:revoke"),
    },
    "set up": {
        "check": (signatures.Check, "cell:check"),
        "doctor": (signatures.Doctor, "doctor:doctor"),
        "sim": (signatures.Sim, "cell:sim"),
        "completion": (signatures.Completion, "manual:completion"),
    },
    "for engineers": {
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
    "export": (signatures.PlantExport, "plant:export"),
    "verify": (signatures.PlantVerify, "plant:verify"),
}


@cache
def whole_parser() -> Parser:
    codes = "; ".join(f"{code} {words}" for code, words in enumerate(EXITS))
    parser = Parser(
        prog="hilcell",
        description="Calibrates a robot on a cheap rail with a laser tracker, unattended.",
        epilog=f"{fill(f'exit codes: {codes}. {AFTER}', 91)}\n{SAFETY}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"hilcell {__version__}")
    parser.groups = GROUPS
    choices = _add(
        parser, {name: each for group in GROUPS.values() for name, each in group.items()}
    )
    _add(choices["plant"], PLANT)
    return parser


def _add(parser: Parser, commands: Commands) -> Mapping[str, Parser]:
    added = parser.add_commands()
    for name, (takes, act) in commands.items():
        text = takes.__doc__ or ""
        words = text[0].lower() + text[1:].rstrip(".")
        command = added.add_parser(name, takes=takes, help=words, description=text)
        command.set_defaults(takes=takes, act=act)
    return added.choices


def read(words: Sequence[str]) -> tuple[str, type[Signature], Json]:
    """Return what performs a command, what it takes, and the values of this."""
    values = vars(whole_parser().parse_args(words))
    return values.pop("act"), values.pop("takes"), values


def main(
    words: Sequence[str] | None = None, *, imported: Callable[[], object] = lambda: None
) -> int:
    """Run one command and return its exit code; ``imported`` is called when the command begins."""
    console.never_fail_to_encode((sys.stdout, sys.stderr))
    words = sys.argv[1:] if words is None else words
    if not words:
        console.print_message(FIRST)
        return EXIT_REFUSED
    try:
        act, takes, values = read(words)
    except NotPrinted as error:  # the help
        return _refuse(error, as_json=False)
    # Many small matrices: a second thread of the linear algebra makes them up to 30 times slower.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    module, _, function = act.partition(":")
    try:
        perform = getattr(importlib.import_module(f"hilcell.commands.{module}"), function)
        imported()
        if "runs" in values:
            values["runs"] = _runs_of(values["runs"])
        code = int(perform(made(takes, values)))
        console.flush_data()
    except KeyboardInterrupt:
        console.print_message("hilcell: interrupted")
        return EXIT_ABORTED
    except Exception as error:  # noqa: BLE001 - the last place where an error can be reported
        return _refuse(error, as_json=takes is Order and bool(values["json"]))
    else:
        return code


def _runs_of(named: Path | None) -> Path:
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
