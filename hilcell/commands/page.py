"""The manual's page of commands, from their signatures: ``python -m hilcell.commands.page``."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from typing import Literal, get_args, get_origin

from hilcell.arguments import MISSING, Argument, Field, Signature, Switches, fields_of
from hilcell.commands.cli import (
    AFTER,
    EXITS,
    GROUPS,
    OTHERS,
    OWN_EXITS,
    PLANT,
    SAFETY,
    Commands,
)

HEAD = """# The command line

All commands, with their options and defaults. This page is written from the signatures of the
commands by `make docs`; `hilcell COMMAND --help` prints the same.

Options stand after their command, in any order. `--help` is an option of each; `hilcell --version`
prints the version.
"""
STATED = re.compile(r" ?\(?\bdefault: ((?:[^()]|\([^()]*\))*)\)?")  # in the help of an argument


def page() -> str:
    """Return the page as Markdown."""
    parts = [HEAD]
    for title, commands in GROUPS.items():
        parts.append(f"## {title.capitalize()}\n")
        parts += _sections("hilcell", commands)
    codes = "\n".join(f"| {code} | {words} |" for code, words in enumerate(EXITS))
    parts.append(f"## Exit codes\n\n| code | meaning |\n|---|---|\n{codes}\n\n{AFTER} {SAFETY}\n")
    own = "\n".join(f"| `{command}` | {words} |" for command, words in OWN_EXITS.items())
    parts.append(f"{OTHERS}\n\n| command | its exit codes |\n|---|---|\n{own}\n")
    return "\n".join(parts)


def _sections(program: str, commands: Commands) -> Iterator[str]:
    for name, (takes, act) in commands.items():
        yield f"### {program} {name}\n\n{takes.__doc__}\n"
        if not act:  # what it does is done by commands of its own
            yield from _sections(f"{program} {name}", PLANT)
            continue
        yield f"```\n{_usage(f'{program} {name}', takes)}\n```\n"
        if rows := [row for field in fields_of(takes) for row in _rows(field)]:
            yield "\n".join(["| argument | meaning | default |", "|---|---|---|", *rows, ""])


def _usage(command: str, takes: type[Signature]) -> str:
    """Return the words that must be given, and those that may be."""
    fields = list(fields_of(takes))
    words = [_given(each) for each in fields if each.is_word or each.needed]
    optional = any(not (each.needed or each.is_word) for each in fields)
    return " ".join([command, *words, *["[OPTIONS]"] * optional])


def _given(field: Field) -> str:
    """Return how an argument is given."""
    if isinstance(field.argument, Switches):
        return f"({' | '.join(field.names)})"
    if field.is_word:
        return _value(field) if field.needed else f"[{_value(field)}]"
    return f"{field.names[0]} {_value(field)}"


def _value(field: Field) -> str:
    """Return the name of a value, or its choices."""
    if get_origin(field.kind) is Literal:
        return f"{{{','.join(get_args(field.kind))}}}"
    return (isinstance(field.argument, Argument) and field.argument.metavar) or field.name.upper()


def _rows(field: Field) -> Iterator[str]:
    """Yield the rows of an argument: one, or one for each switch of a choice."""
    argument = field.argument
    if isinstance(argument, Switches):
        for word, text in argument.help.items():
            yield _row(f"--{word}", text, "one of these")
        return
    value = "" if field.kind is bool else f" {_value(field)}"
    given = value.strip() if argument.word else f"{', '.join(field.names)}{value}"
    meaning, default = argument.help, ""
    if field.needed:
        default = "must be given"
    elif len(stated := STATED.findall(meaning)) == 1:
        meaning, default = STATED.sub("", meaning), stated[0]
    elif field.default not in (MISSING, None, "", False, ()):
        default = str(field.default)
    yield _row(given, meaning, default)


def _row(given: str, meaning: str, default: str) -> str:
    cells = (f"`{given}`", meaning, default)
    return f"| {' | '.join(each.replace('|', chr(92) + '|') for each in cells)} |"


if __name__ == "__main__":
    sys.stdout.write(page())
