"""KRL programs on disk: ``NAME.src`` with its ``NAME.dat``, which are one program."""

from __future__ import annotations

from pathlib import Path

from drivers.kuka.program_krl.program import DATA, Program
from drivers.kuka.program_krl.reader import read_program
from drivers.program_text import source_text
from hilcell.cell.settings import SettingsError, unreadable


def load_program(path: Path) -> Program:
    """Read a program with the data list beside it; raises `SettingsError`."""
    data = _data_beside(path)
    return read_program(
        path.name, source_text(path, "KRL"), (data.name, source_text(data, "KRL")) if data else None
    )


def _data_beside(path: Path) -> Path | None:
    try:
        found = [
            each
            for each in path.parent.iterdir()
            if each.stem.lower() == path.stem.lower()
            and each.suffix.lower() == DATA
            and each.is_file()
        ]
    except OSError as error:
        raise unreadable(str(path), error) from error
    if len(found) > 1:
        names = ", ".join(sorted(each.name for each in found))
        raise SettingsError(str(path), [f"several data lists beside it: {names}; leave one"])
    return found[0] if found else None
