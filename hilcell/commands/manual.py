"""``explain``, ``completion``, and the manual's page of all commands.

Shells complete commands, options, cells, procedures, runs, codes of alarms, and files where the
argument's name is that of a file. ``python -m hilcell.commands.manual`` prints the page.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections import Counter
from collections.abc import Iterator
from copy import deepcopy
from importlib.metadata import entry_points
from typing import Literal, get_args, get_origin

import shtab

from hilcell.alarms.catalogue import catalogue
from hilcell.arguments import MISSING, Argument, Signature, arguments_of
from hilcell.cell.settings import near_misses
from hilcell.cell.source import built_in_cells
from hilcell.commands import cli
from hilcell.commands.console import print_data, print_json
from hilcell.commands.parser import Parser
from hilcell.commands.signatures import Completion, Explain
from hilcell.errors import HilcellError
from hilcell.language import of_environment, speaking, tr


def explain(args: Explain) -> int:
    """Print one entry of the catalogue; suggest similar codes for an unknown one."""
    known = catalogue()
    code = re.sub("^(HC[- ]?)?", "HC-", args.code.upper(), count=1)
    if code not in known:
        # a single digit or a word resembles too many codes
        near = near_misses(code, known, most=3) if re.match(r"HC-[A-Z].*\d", code) else []
        hint = f"did you mean {' or '.join(near)}?" if near else "expected a code like HC-T10"
        raise HilcellError(f"unknown alarm {args.code[:80]!r}; {hint}")
    entry = known[code]
    facts = {"code": entry.code, "title": entry.title, "means": entry.means, "do": entry.do}
    if args.json:
        print_json(facts)
    else:
        with speaking(of_environment(os.environ)):
            steps = (f"  {number}. {tr(step)}" for number, step in enumerate(entry.do, start=1))
            print_data("\n".join([f"{entry.code} {tr(entry.title)}", tr(entry.means), *steps]))
    return 0


# -- completion -----------------------------------------------------------------------------------

# Functions of shells; a table of runs has bars in ASCII or box characters, and three head lines.
PREAMBLE = {
    "bash": """
_hilcell_run() {{ compgen -W "last $({names})" -- "$1"; }}
_hilcell_cell() {{ compgen -W "{cells}" -- "$1"; compgen -f -X '!*.toml' -- "$1"; }}
_hilcell_cell_of_runs() {{ compgen -W "$({cells_of_runs})" -- "$1"; }}
""",
    "zsh": """
_hilcell_run() {{ compadd last $({names}) }}
_hilcell_cell() {{ compadd {cells}; _files -g '*.toml' }}
_hilcell_cell_of_runs() {{ compadd $({cells_of_runs}) }}
""",
}


def completion(args: Completion) -> int:
    parser = deepcopy(cli.whole_parser())  # its actions are changed
    for action in _actions(parser):
        if action.dest == "procedure":
            action.choices = sorted(entry_points(group="hilcell.procedures").names)
        elif action.metavar == "CODE":
            action.choices = sorted(catalogue())
        elif (completer := _completer(action)) is not None:
            action.complete = completer  # type: ignore[attr-defined] # read by shtab
    listed = "hilcell runs 2>/dev/null | LC_ALL=C sed '1,3d; s/│/|/g' | cut -s -d'|'"
    preamble = PREAMBLE.get(args.shell, "").format(
        names=f"{listed} -f2",
        cells=" ".join(sorted(built_in_cells())),
        cells_of_runs=f"{listed} -f4 | sort -u",
    )
    print_data(shtab.complete(parser, args.shell, preamble=preamble))
    return 0


def _actions(parser: Parser) -> Iterator[argparse.Action]:
    for action in parser.fill()._actions:  # noqa: SLF001 - argparse has no public list
        yield action
        for command in action.choices.values() if isinstance(action.choices, dict) else ():
            yield from _actions(command)


def _completer(action: argparse.Action) -> dict[str, str | dict[str, str]] | None:
    """Return shtab's completer of an argument, by shell; None for free text."""
    name = str(action.metavar or "")
    of_runs = (action.dest, name) == ("cell", "NAME")
    functions = {"RUN": "run", "CALIBRATION": "run", "CELL": "cell"}  # of the preamble
    if function := "cell_of_runs" if of_runs else functions.get(name):
        return dict.fromkeys(PREAMBLE, f"_hilcell_{function}")
    if re.search(r"DIR|FOLDER", name):
        return shtab.DIRECTORY
    return shtab.FILE if re.search(r"FILE|OUT|TARGETS|HOLES|\.csv|\.toml", name) else None


# -- the page of the commands ---------------------------------------------------------------------

HEAD = """# The command line

All commands with their options and defaults. `make docs` writes this page from the commands'
signatures; `hilcell COMMAND --help` prints the same.

Options follow their command, in any order. Every command has `--help`; `hilcell --version` prints
the version.
"""
COLUMNS = ("| argument | meaning | default |", "|---|---|---|")
DEFAULT = re.compile(r" ?\(?\bdefault: ((?:[^()]|\([^()]*\))*)\)?")  # in the help of an argument


def page() -> str:
    parts, shared = [HEAD], _shared_rows()
    if shared:
        about = 'Each command names its own of these after "Also".\n'
        parts += ["## Common arguments\n", about, "\n".join([*COLUMNS, *shared.values(), ""])]
    for title, commands in cli.GROUPS.items():
        parts.append(f"## {title.capitalize()}\n")
        parts += _sections("hilcell", commands, shared)
    codes = "\n".join(f"| {code} | {text} |" for code, text in enumerate(cli.EXITS))
    parts.append(
        f"## Exit codes\n\n| code | meaning |\n|---|---|\n{codes}\n\n{cli.AFTER} {cli.SAFETY}\n"
    )
    own = "\n".join(f"| `{command}` | {text} |" for command, text in cli.OWN_EXITS.items())
    parts.append(f"{cli.OTHERS}\n\n| command | its exit codes |\n|---|---|\n{own}\n")
    return "\n".join(parts)


def _shared_rows() -> dict[str, str]:
    """Return the rows of arguments that several commands have with the same help, by argument."""
    signatures: set[type[Signature]] = set()
    for commands in cli.GROUPS.values():
        for each, function in commands.values():
            signatures |= {each} if function else {part for part, _ in cli.PLANT.values()}
    counts = Counter(
        (_name(field), row)
        for each in signatures
        for field in arguments_of(each)
        if not field.switches
        for row in _rows(field)
    )
    shared: dict[str, str] = {}
    for (name, row), count in sorted(counts.items(), key=lambda item: (-item[1], item[0])):
        if count > 1:
            shared.setdefault(name, row)
    return shared


def _sections(program: str, commands: cli.Commands, shared: dict[str, str]) -> Iterator[str]:
    for name, (signature, function) in commands.items():
        yield f"### {program} {name}\n\n{signature.__doc__}\n"
        if not function:  # has subcommands
            yield from _sections(f"{program} {name}", cli.PLANT, shared)
            continue
        fields = list(arguments_of(signature))
        words = [_usage(each) for each in fields if each.positional or each.must_be_given]
        words += ["[OPTIONS]"] * (len(words) < len(fields))
        yield f"```\n{' '.join([program, name, *words])}\n```\n"
        rows = [(_name(field), row) for field in fields for row in _rows(field)]
        if own := [row for given, row in rows if shared.get(given) != row]:
            yield "\n".join([*COLUMNS, *own, ""])
        if common := [f"`{given}`" for given, row in rows if shared.get(given) == row]:
            yield f"Also: {', '.join(common)}\n"


def _usage(field: Argument) -> str:
    if field.switches:
        return f"({' | '.join(field.names)})"
    if field.positional:
        return _value(field) if field.must_be_given else f"[{_value(field)}]"
    return f"{field.names[0]} {_value(field)}"


def _value(field: Argument) -> str:
    if get_origin(field.kind) is Literal:
        return f"{{{','.join(get_args(field.kind))}}}"
    return field.metavar or field.name.upper()


def _name(field: Argument) -> str:
    """Return an argument as on a command line, with its value."""
    value = "" if field.kind is bool or field.switches else f" {_value(field)}"
    return value.strip() if field.positional else f"{', '.join(field.names)}{value}"


def _rows(field: Argument) -> Iterator[str]:
    """Yield the rows of an argument: one, or one for each switch of a choice."""

    def row(argument: str, meaning: str, default: str) -> str:
        cells = (f"`{argument}`", meaning, default)
        return f"| {' | '.join(each.replace('|', chr(92) + '|') for each in cells)} |"

    for switch, text in field.switches.items():
        yield row(f"--{switch}", text, "one of these")
    if field.switches:
        return
    meaning, default = field.help, ""
    if field.must_be_given:
        default = "required"
    elif len(defaults := DEFAULT.findall(meaning)) == 1:
        meaning, default = DEFAULT.sub("", meaning), defaults[0]
    elif field.default not in (MISSING, None, "", False, ()):
        default = str(field.default)
    yield row(_name(field), meaning, default)


if __name__ == "__main__":
    sys.stdout.write(page())
