"""KRL programs on disk: ``NAME.src`` with its ``NAME.dat``, read and written as a pair.

Files are taken as latin-1, in which every byte is a character, so that what is not edited is
written back byte for byte. The trap: the two files belong together, read and written.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from hilcell.cell.settings import SettingsError, unreadable
from hilcell.krl.program import Program, read_program
from hilcell.writing import NotWritten, write_together

ENCODING = "latin-1"
SOURCE, DATA = ".src", ".dat"


def is_program(path: Path) -> bool:
    """Whether the path names a KRL program's source."""
    return path.suffix.lower() == SOURCE


def load_program(path: Path) -> Program:
    """Read a program with the data list beside it; raises `SettingsError`."""
    data = _data_beside(path)
    return read_program(path.name, _text(path), (data.name, _text(data)) if data else None)


def write_program(
    texts: dict[str, str], source: Path, out: Path, *, inputs: Iterable[Path] = ()
) -> list[Path]:
    """Write a program's texts, by their names at ``source``, under another stem; return the paths.

    ``out`` may end in ``.src``. Raises `NotWritten` as `write_together` does; the nominal program
    is an input as well: corrected again, it would be corrected twice.
    """
    if os.path.isdir(out):  # noqa: PTH112 - Path.is_dir raises for a name too long
        raise NotWritten(f"{out} is a folder; name a program in it")
    contents = {
        _sibling(out, Path(name).suffix): text.encode(ENCODING) for name, text in texts.items()
    }
    read = [source, *(source.with_name(name) for name in texts), *inputs]
    write_together(contents, inputs=read)
    return list(contents)


def _data_beside(path: Path) -> Path | None:
    try:
        found = [
            each
            for each in path.parent.iterdir()
            if each.stem == path.stem and each.suffix.lower() == DATA and each.is_file()
        ]
    except OSError as error:
        raise unreadable(str(path), error) from error
    if len(found) > 1:
        names = ", ".join(sorted(each.name for each in found))
        raise SettingsError(str(path), [f"several data lists beside it: {names}; leave one"])
    return found[0] if found else None


def _text(path: Path) -> str:
    try:
        text = path.read_bytes().decode(ENCODING)
    except OSError as error:
        raise unreadable(str(path), error) from error
    if "\0" in text:
        raise SettingsError(str(path), ["has NUL bytes: not a KRL text, or saved as UTF-16"])
    return text


def _sibling(out: Path, suffix: str) -> Path:
    stem = out.stem if out.suffix.lower() in (SOURCE, DATA) else out.name
    return out.with_name(stem + suffix)
