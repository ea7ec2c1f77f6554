"""The text of a cell file, built in or at a path, and the line of each value."""

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
            "cell", [f"expected a built-in cell ({known}) or the path of a cell file, got ''"]
        )
    if where in built_in_cells():
        return (resources.files("hilcell.cells") / f"{where}.toml").read_text("utf-8")
    try:
        return normalize("NFC", read_text(Path(where)))  # one encoding of each letter
    except FileNotFoundError:
        names = built_in_cells()
        hint = f"; built in: {', '.join(names)}{did_you_mean(where, names)}"
        raise SettingsError(where, [f"no such file or built-in cell{hint}"]) from None
    except (OSError, UnicodeDecodeError) as error:
        raise unreadable(where, error, "cell file") from error


def cell_folder(where: str) -> Path:
    """Return the folder of the files to which a cell file refers."""
    return Path() if where in built_in_cells() else Path(where).parent


def parsed(text: str, where: str) -> Json:
    """Return the tables of a cell file; raises `SettingsError`."""
    at_line = re.compile(r"\(at line (\d+)")  # in the message of tomllib
    try:
        return deepcopy(_tables(text))
    except RecursionError:
        raise SettingsError(where, ["nested too deeply"]) from None
    except ValueError as error:  # also too many digits of an integer
        place = at_line.search(str(error))
        line = f"{where}:{place[1]}: " if place else ""
        raise SettingsError(where, [f"{line}not valid TOML: {error}"]) from error


@lru_cache(maxsize=8)
def _tables(text: str) -> Json:
    """Return the tables of a text; cached, for a study reads one cell many times."""
    return tomllib.loads(text)


def built_in_cells() -> list[str]:
    folder = resources.files("hilcell.cells")
    return sorted(
        p.name.removesuffix(".toml") for p in folder.iterdir() if p.name.endswith(".toml")
    )


# -- lines of values -------------------------------------------------------------------------------

# `tomllib` has no line numbers. A line is the value's if the text above it, parsed, lacks the path
# and the text with it has the path; text that ends within an array is closed first.


def with_lines(problems: Iterable[str], text: str, where: str, changed: Iterable[str]) -> list[str]:
    """Return problems, which begin with a path and ": ", with file and line, in that order.

    The line is omitted if it is unknown, or if the path is in ``changed``, the overrides.
    """
    located = []
    for problem in problems:
        path = problem.partition(": ")[0]
        line = None if any(_overlap(path, each) for each in changed) else line_of(text, path)
        located.append(problem if line is None else f"{where}:{line}: {problem}")
    return by_line(located, where)


def explain_exchange(problem: str, exchanged: Mapping[str, tuple[str, str]]) -> str:
    """Return a problem of options, with an explanation if their driver was replaced."""
    table, _, rest = problem.partition(".options: ")
    if not rest or table not in exchanged:
        return problem
    then, now = exchanged[table]
    return (
        f"{problem}; the options of {then!r} in the cell file do not apply to {now!r}: "
        f"set them by --set {table}.options.KEY=VALUE, or driver and options in the file"
    )


def by_line(problems: Iterable[str], where: str) -> list[str]:
    """Return problems in the order of their lines, those without one first."""
    begin = re.compile(rf"{re.escape(where)}:(\d+): ")
    return sorted(problems, key=lambda each: int(at[1]) if (at := begin.match(each)) else 0)


def line_of(text: str, path: str) -> int | None:
    """Return the line of ``a.b[2].c``, or of the nearest table around it; counted from 1."""
    lines = text.split("\n")
    longest = 5000  # lines: each candidate is parsed with all lines above it
    if len(lines) > longest or re.fullmatch(r"[\w-]+(\[\d+\]|\.[\w-]+)*", path) is None:
        return None
    steps = re.findall(r"[\w-]+|\[\d+\]", path)
    while steps and not _has(text, steps):  # a key that is missing
        steps.pop()
    if not steps:
        return None
    # Candidates: the last key with "=", or in a table's header.
    key = re.escape(next(step for step in reversed(steps) if not step.startswith("[")))
    begins = rf"(?<![\w-])[\"']?{key}[\"']?\s*=|^\s*\[.*(?<![\w-])[\"']?{key}[\"']?\s*\]"
    if steps[-1].startswith("["):
        begins += r"|\{"
    candidates = [n for n, line in enumerate(lines, 1) if re.search(begins, line)]
    matches = [
        n
        for n in candidates
        if _has("\n".join(lines[:n]), steps) and _has("\n".join(lines[: n - 1]), steps) is False
    ]
    return matches[0] if len(matches) == 1 else None


def _has(text: str, steps: Sequence[str]) -> bool | None:
    """Whether a text that may end within arrays has a path; None if it cannot be closed."""
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
    short, long = sorted((path, other), key=len)
    return long == short or long.startswith((f"{short}.", f"{short}["))
