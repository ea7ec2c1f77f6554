"""Keys in which a cell differs from itself at another time, or does not from a built-in cell.

Runs, locks and calibrations are kept apart by the cell's name and serial number: a real cell copied
from a built-in one that still has those would mix its calibrations with simulated ones.
"""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import SettingsError
from hilcell.cell.source import built_in_cells


def differences(before: Cell, now: Cell, *, without: str = "") -> str:
    """Return the keys that differ, each with both values; the table ``without`` is left out."""
    frozen, given = msgspec.to_builtins(before), msgspec.to_builtins(now)
    for values in (frozen, given):
        values.pop(without, None)
    keys = list(_different(frozen, given))
    named = 3  # the others are counted
    more = f", and {len(keys) - named} more" if len(keys) > named else ""
    return ", ".join(keys[:named]) + more


def _different(before: object, now: object, key: str = "") -> Iterator[str]:
    if isinstance(before, dict) and isinstance(now, dict):
        for name in sorted(before.keys() | now.keys()):
            inner = f"{key}.{name}" if key else str(name)
            yield from _different(before.get(name), now.get(name), inner)
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        for number, (one, other) in enumerate(zip(before, now, strict=True), 1):
            yield from _different(one, other, f"{key}[{number}]")
    elif before != now:
        one, other = (
            text if len(text) <= 40 else f"{text[:37]}..." for text in (f"{before}", f"{now}")
        )
        yield f"{key} {one} -> {other}"


def check_copied(where: str, cell: Cell) -> str:
    """Return a warning for a simulated cell that has the name or serial of a built-in one, and for
    a real one whose lengths are certified by nobody.

    Raises `SettingsError` for a real cell with such a name or serial.
    """
    if where in built_in_cells():
        return ""
    built_in = {name: load_cell(name) for name in built_in_cells()}
    problems = [
        f"{key}: {found!r} is that of the built-in cell {name}; give this cell one of its own"
        for name, other in built_in.items()
        if cell.simulation is None or cell.digest != other.digest
        for key, found, taken in (
            ("name", cell.name, other.name),
            ("serial", cell.serial, other.serial),
        )
        if found == taken
    ]
    simulated = "simulated"  # the certificate of each length in the built-in cells
    if cell.simulation is None:
        if problems:
            raise SettingsError(where, problems)
        problems = [
            f"layout.length {' to '.join(each.nests)}: the certificate is {simulated!r}, expected "
            "the number of the bar's own; state its length and u_mm, too"
            for each in cell.layout.length
            if each.certificate == simulated
        ]
    return "\n".join(f"{where}: {problem}" for problem in problems)
