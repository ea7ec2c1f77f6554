"""``completion``: a script by which bash, zsh, fish or tcsh completes commands, options and names.

Files are completed where an argument's name is that of a file; cells, procedures and runs by name.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from importlib.metadata import entry_points

import shtab

from hilcell.cell.source import built_in_cells
from hilcell.commands.cli import whole_parser
from hilcell.commands.output import print_data

Completer = dict[str, str | dict[str, str]]  # by shell, as shtab has it
_FILE = re.compile(r"FILE|OUT|TARGETS|HOLES|\.csv|\.toml")
_FOLDER = re.compile(r"DIR|FOLDER")
# The C locale draws the table of runs in ASCII; three lines of it are its head.
_NAMES = "LC_ALL=C hilcell runs 2>/dev/null | tail -n +4 | cut -s -d'|' -f2"
_CELLS = " ".join(sorted(built_in_cells()))
PREAMBLE = {
    "bash": f"""
_hilcell_run() {{ compgen -W "last $({_NAMES})" -- "$1"; }}
_hilcell_cell() {{ compgen -W "{_CELLS}" -- "$1"; compgen -f -X '!*.toml' -- "$1"; }}
""",
    "zsh": f"""
_hilcell_run() {{ compadd last $({_NAMES}) }}
_hilcell_cell() {{ compadd {_CELLS}; _files -g '*.toml' }}
""",
}
_NAMED: dict[str, Completer] = {
    "RUN": {"bash": "_hilcell_run", "zsh": "_hilcell_run"},
    "CALIBRATION": {"bash": "_hilcell_run", "zsh": "_hilcell_run"},
    "CELL": {"bash": "_hilcell_cell", "zsh": "_hilcell_cell"},
}


def completion(args: argparse.Namespace) -> int:
    """Print the script of one shell."""
    parser = whole_parser()
    for action in _actions(parser):
        if action.dest == "procedure":
            action.choices = sorted(entry_points(group="hilcell.procedures").names)
        elif (by := _completed_by(str(action.metavar or ""))) is not None:
            action.complete = by  # type: ignore[attr-defined] # the attribute that shtab reads
    print_data(shtab.complete(parser, args.shell, preamble=PREAMBLE.get(args.shell, "")))
    return 0


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yield the arguments of all commands."""
    for action in parser._actions:  # noqa: SLF001 - argparse offers no list of them
        yield action
        for command in action.choices.values() if isinstance(action.choices, dict) else ():
            yield from _actions(command)


def _completed_by(name: str) -> Completer | None:
    """Return what completes an argument of this name; None for words of no list."""
    if name in _NAMED:
        return _NAMED[name]
    if _FOLDER.search(name):
        return shtab.DIRECTORY
    return shtab.FILE if _FILE.search(name) else None
