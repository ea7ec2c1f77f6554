"""The text of a cell file, built in or at a path, and its line that gives a value its path."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any
from unicodedata import normalize

from hilcell.cell.settings import SettingsError, did_you_mean, read_text, unreadable
from hilcell.decoding import Json


def read_source(where: str) -> str:
    """Return the text of a cell file; raises `SettingsError`."""
    if not where.strip():
        known = ", ".join(built_in_cells())
        raise SettingsError(
            "cell", [f"no cell was named; built in are: {known}; or give a path to a TOML file"]
        )
    if where in built_in_cells():
        return (resources.files("hilcell.cells") / f"{where}.toml").read_text("utf-8")
    try:
        return normalize("NFC", read_text(Path(where)))  # the letters of names, however typed
    except FileNotFoundError:
        names = built_in_cells()
        hint = f"; built in: {', '.join(names)}{did_you_mean(where, names)}"
        raise SettingsError(
            where, [f"no such file, and no built-in cell of that name{hint}"]
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise unreadable(where, error, "cell file") from error


def folder_of(where: str) -> Path:
    """Return where the files lie that a cell file names."""
    return Path() if where in built_in_cells() else Path(where).parent


def parsed(text: str, where: str) -> Json:
    """Return the tables of a cell file; raises `SettingsError`."""
    at_line = re.compile(r"\(at line (\d+)")  # tomllib says it in words only
    try:
        return deepcopy(_tables(text))
    except RecursionError:
        raise SettingsError(where, ["nested too deeply"]) from None
    except ValueError as error:  # also an integer of more digits than Python reads
        place = at_line.search(str(error))
        line = f"{where}:{place[1]}: " if place else ""
        raise SettingsError(where, [f"{line}not valid TOML: {error}"]) from error


@lru_cache(maxsize=8)
def _tables(text: str) -> Json:
    """Return the tables of a text; a study reads one cell for each of its cases."""
    return tomllib.loads(text)


def built_in_cells() -> list[str]:
    folder = resources.files("hilcell.cells")
    return sorted(
        p.name.removesuffix(".toml") for p in folder.iterdir() if p.name.endswith(".toml")
    )


# -- lines: proven by parsing, or none -------------------------------------------------------------

# `tomllib` keeps no lines. A line is the value's if the text above it, parsed, lacks the path and
# the text with it has the path; text that ends within an array is closed first.


def with_lines(problems: Iterable[str], text: str, where: str, changed: Iterable[str]) -> list[str]:
    """Return problems, which begin with a path and ": ", in the order of their lines.

    Each has file and line where one is proven. Paths in ``changed``, such as ``rail.speed_mm_s``,
    have values that are not the file's.
    """
    located = []
    for problem in problems:
        path = problem.partition(": ")[0]
        line = None if any(_overlap(path, each) for each in changed) else line_of(text, path)
        located.append(problem if line is None else f"{where}:{line}: {problem}")
    return by_line(located, where)


def of_options(problem: str, exchanged: Mapping[str, tuple[str, str]]) -> str:
    """Return a problem of options with why the file's do not count, where a driver is exchanged."""
    table, _, found = problem.partition(".options: ")
    if not found or table not in exchanged:
        return problem
    then, now = exchanged[table]
    return (
        f"{problem}; the options of {then!r} in the cell file do not apply to {now!r}: "
        f"state them by --set {table}.options.KEY=VALUE, or driver and options in the file"
    )


def by_line(problems: Iterable[str], where: str) -> list[str]:
    """Return problems in the order of their lines, those without one first."""
    begin = re.compile(rf"{re.escape(where)}:(\d+): ")
    return sorted(problems, key=lambda each: int(at[1]) if (at := begin.match(each)) else 0)


def line_of(text: str, path: str) -> int | None:
    """Return the line of ``a.b[2].c``, or of the nearest table around it; counted from 1."""
    lines = text.split("\n")
    longest = 5000  # lines: each that may be the one is parsed with all above it
    if len(lines) > longest or re.fullmatch(r"[\w-]+(\[\d+\]|\.[\w-]+)*", path) is None:
        return None
    steps = re.findall(r"[\w-]+|\[\d+\]", path)
    while steps and not _has(text, steps):  # a key that is missing
        steps.pop()
    if not steps:
        return None
    # Lines that may give the path: its last key with "=", or in a table's header.
    key = re.escape(next(step for step in reversed(steps) if not step.startswith("[")))
    begins = rf"(?<![\w-])[\"']?{key}[\"']?\s*=|^\s*\[.*(?<![\w-])[\"']?{key}[\"']?\s*\]"
    if steps[-1].startswith("["):
        begins += r"|\{"
    candidates = [n for n, line in enumerate(lines, 1) if re.search(begins, line)]
    proven = [
        n
        for n in candidates
        if _has("\n".join(lines[:n]), steps) and _has("\n".join(lines[: n - 1]), steps) is False
    ]
    return proven[0] if len(proven) == 1 else None


def _has(text: str, steps: Sequence[str]) -> bool | None:
    """Whether a text that may end within arrays has a path; None where it cannot be closed."""
    for closed_by in ("", "\n]", "\n]\n]"):
        try:
            values: Any = tomllib.loads(text + closed_by)
        except (ValueError, RecursionError):
            continue
        try:
            for step in steps:
                values = values[int(step[1:-1]) if step.startswith("[") else step]
        except (KeyError, IndexError, TypeError):
            return False
        return True
    return None


def _overlap(path: str, other: str) -> bool:
    """Whether one of two paths is the other, or holds it."""
    short, long = sorted((path, other), key=len)
    return long == short or long.startswith((f"{short}.", f"{short}["))
