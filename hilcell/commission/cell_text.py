"""The text of a cell file, edited: a person's comments, order and values stay.

A value is written at its path, ``rail.options.counts_per_mm``, with a comment that says how it was
obtained. A list of tables (``station``, ``robot.joint``) becomes an array of tables, a list of
nests one inline table a line.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import tomlkit
import tomlkit.exceptions
from tomlkit.items import AoT, Item, Table

from hilcell.atomic_files import write_whole
from hilcell.cell.settings import SettingsError, read_text, unreadable
from hilcell.decoding import Json

IN_ONE_LINE = ("layout", "tracker")  # tables whose own tables are poses and nests


class CellText:
    """A cell file as text; `values` are its plain values."""

    def __init__(self, text: str = "", where: str = "cell file") -> None:
        """Raises `SettingsError` for a text that is no TOML."""
        try:
            self._document = tomlkit.parse(text)
        except (tomlkit.exceptions.TOMLKitError, RecursionError) as error:
            raise SettingsError(where, [f"not valid TOML: {error}"]) from error

    @classmethod
    def read(cls, path: Path) -> CellText:
        """Return the text of a file, empty where there is none; raises `SettingsError`."""
        try:
            return cls(read_text(path), str(path))
        except FileNotFoundError:
            return cls()
        except (OSError, UnicodeDecodeError) as error:
            raise unreadable(str(path), error, "cell file") from error

    def write(self, path: Path) -> None:
        """Replace the file as a whole; raises `NotWritten`."""
        write_whole(path, self.text.encode())

    @property
    def text(self) -> str:
        return tomlkit.dumps(self._document)

    @property
    def values(self) -> Json:
        plain: Json = self._document.unwrap()
        return plain

    def get(self, path: str) -> object:
        """Return the plain value at a path, None where there is none."""
        found: object = self.values
        for key in path.split("."):
            if isinstance(found, list) and key.isdecimal() and int(key) < len(found):
                found = found[int(key)]
            elif isinstance(found, Mapping) and key in found:
                found = found[key]
            else:
                return None
        return found

    def set(self, path: str, value: object, comment: str = "") -> None:
        """Write a value at its path, with a comment behind or above it.

        A value that is there already keeps its own comment and place.
        """
        *tables, key = path.split(".")
        table: Any = self._document
        for name, following in pairwise([*tables, key]):
            if isinstance(table, AoT):
                table = table[int(name)]
                continue
            if name not in table:
                table[name] = tomlkit.aot() if following.isdecimal() else tomlkit.table()
            table = table[name]
        if isinstance(table, AoT):
            _set_row(table, int(key), value, comment)
            return
        if key in table and table[key].unwrap() == value:
            return
        item = _item(value, inline=bool(tables) and tables[0] in IN_ONE_LINE)
        if comment and isinstance(item, AoT):
            next(iter(item[0].values())).comment(comment)
        elif comment and not isinstance(item, Table):
            item.comment(comment)
        table[key] = item


def _set_row(rows: AoT, number: int, values: Any, comment: str) -> None:
    """Write the values of one table of an array, which may be its next one."""
    if number == len(rows):
        rows.append(_flat(values).comment(comment))
        return
    for key, value in values.items():
        if key not in rows[number] or rows[number][key].unwrap() != value:
            rows[number][key] = _item(value, inline=True)


def _item(value: object, *, inline: bool) -> Item:
    match value:
        case Mapping() if inline:
            table = tomlkit.inline_table()
            table.update(value)
            return table
        case Mapping():
            table_of: Table = tomlkit.item(dict(value))
            return table_of
        case [Mapping(), *_] if inline:
            rows = tomlkit.array()
            for each in value:
                rows.append(_item(each, inline=True))
            return rows.multiline(True)
        case [Mapping(), *_]:
            tables = tomlkit.aot()
            for each in cast("Sequence[Mapping[str, object]]", value):
                tables.append(_flat(each))
            return tables
        case Sequence() if not isinstance(value, str):
            items: Item = tomlkit.item([*value])
            return items
    item: Item = tomlkit.item(value)
    return item


def _flat(values: Mapping[str, object]) -> Table:
    """Return a table whose own tables stand in one line each."""
    table = tomlkit.table()
    for key, value in values.items():
        table[key] = _item(value, inline=True)
    return table


def shown(value: object) -> str:
    """Return a value as a person reads it: a list of tables by their names."""
    if isinstance(value, Mapping):
        return str(value.get("name") or ", ".join(f"{key} {each}" for key, each in value.items()))
    if isinstance(value, list):
        return ", ".join(shown(each) for each in value)
    return str(value)
