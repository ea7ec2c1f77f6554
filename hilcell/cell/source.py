"""The text of a cell file: a built-in cell by its name, or a file by its path."""

from __future__ import annotations

import re
import tomllib
from copy import deepcopy
from functools import lru_cache
from importlib import resources
from pathlib import Path
from unicodedata import normalize

from hilcell.cell.settings import SettingsError, did_you_mean, read_text, unreadable
from hilcell.typed import Json


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
    """Return the names of the cells that come with hilcell."""
    folder = resources.files("hilcell.cells")
    return sorted(
        p.name.removesuffix(".toml") for p in folder.iterdir() if p.name.endswith(".toml")
    )
