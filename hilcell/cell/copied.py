"""A cell file that was copied from a built-in cell, and not yet made one's own.

Runs, locks and calibrations are kept apart by the cell's name and serial number: a real cell
that still has those of a simulated one would mix its calibrations with simulated ones.
"""

from __future__ import annotations

from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import SettingsError
from hilcell.cell.source import built_in_cells


def check_copied(where: str, cell: Cell) -> str:
    """Return a warning for a simulated cell that has the name or serial of a built-in one, and for
    a real one whose lengths are certified by nobody.

    Raises `SettingsError` for a real cell with such a name or serial.
    """
    if where in built_in_cells():
        return ""
    problems = [
        f"{key}: {found!r} is that of the built-in cell {name}; give this cell one of its own"
        for name in built_in_cells()
        for key, found, taken in _kept(cell, load_cell(name))
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


def _kept(cell: Cell, built_in: Cell) -> list[tuple[str, str, str]]:
    """Return the values that must differ, of both cells; nothing where the cells are the same."""
    if cell.simulation is not None and cell.digest == built_in.digest:
        return []
    return [("name", cell.name, built_in.name), ("serial", cell.serial, built_in.serial)]
