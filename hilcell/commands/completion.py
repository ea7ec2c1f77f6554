"""``completion``: a script by which bash, zsh, fish or tcsh completes commands, options and names.

Files are completed where an argument's name is that of a file; cells, procedures and runs by name,
alarms by code.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from copy import deepcopy
from importlib.metadata import entry_points

import shtab

from hilcell.alarms.catalogue import catalogue
from hilcell.cell.source import built_in_cells
from hilcell.commands.cli import whole_parser
from hilcell.commands.orders import Completion
from hilcell.commands.output import print_data
from hilcell.commands.parser import Parser

Completer = dict[str, str | dict[str, str]]  # by shell, as shtab has it
# The lines of the table of runs are bars in ASCII, or box characters; three of it are its head.
_LISTED = "hilcell runs 2>/dev/null | LC_ALL=C sed '1,3d; s/│/|/g' | cut -s -d'|'"
_NAMES, _CELLS_OF_RUNS = f"{_LISTED} -f2", f"{_LISTED} -f4 | sort -u"
_CELLS = " ".join(sorted(built_in_cells()))
PREAMBLE = {
    "bash": f"""
_hilcell_run() {{ compgen -W "last $({_NAMES})" -- "$1"; }}
_hilcell_cell() {{ compgen -W "{_CELLS}" -- "$1"; compgen -f -X '!*.toml' -- "$1"; }}
_hilcell_cell_of_runs() {{ compgen -W "$({_CELLS_OF_RUNS})" -- "$1"; }}
""",
    "zsh": f"""
_hilcell_run() {{ compadd last $({_NAMES}) }}
_hilcell_cell() {{ compadd {_CELLS}; _files -g '*.toml' }}
_hilcell_cell_of_runs() {{ compadd $({_CELLS_OF_RUNS}) }}
""",
}
_NAMED = {"RUN": "run", "CALIBRATION": "run", "CELL": "cell"}  # the functions of the preamble


def completion(args: Completion) -> int:
    """Print the script of one shell."""
    parser = deepcopy(whole_parser())  # it is written into
    for action in _actions(parser):
        if action.dest == "procedure":
            action.choices = sorted(entry_points(group="hilcell.procedures").names)
        elif action.metavar == "CODE":
            action.choices = sorted(catalogue())
        elif (by := _completed_by(action)) is not None:
            action.complete = by  # type: ignore[attr-defined] # the attribute that shtab reads
    print_data(shtab.complete(parser, args.shell, preamble=PREAMBLE.get(args.shell, "")))
    return 0


def _actions(parser: Parser) -> Iterator[argparse.Action]:
    """Yield the arguments of all commands."""
    for action in parser.fill()._actions:  # noqa: SLF001 - argparse offers no list of them
        yield action
        for command in action.choices.values() if isinstance(action.choices, dict) else ():
            yield from _actions(command)


def _completed_by(action: argparse.Action) -> Completer | None:
    """Return what completes an argument; None for words of no list."""
    name = str(action.metavar or "")
    of_runs = (action.dest, name) == ("cell", "NAME")
    if function := "cell_of_runs" if of_runs else _NAMED.get(name):
        return dict.fromkeys(PREAMBLE, f"_hilcell_{function}")
    if re.search(r"DIR|FOLDER", name):
        return shtab.DIRECTORY
    return shtab.FILE if re.search(r"FILE|OUT|TARGETS|HOLES|\.csv|\.toml", name) else None
