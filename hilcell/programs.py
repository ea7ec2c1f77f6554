"""KRL programs on disk: ``NAME.src`` with its ``NAME.dat``, read and written as a pair.

Files are taken as latin-1, in which every byte is a character, so that what is not edited is
written back byte for byte. The trap: the two files belong together; both are written beside
their places before either is renamed.
"""

from __future__ import annotations

import os
from pathlib import Path

from hilcell.krl.program import Program, read_program
from hilcell.settings import SettingsError

ENCODING = "latin-1"
SOURCE, DATA = ".src", ".dat"


def is_program(path: Path) -> bool:
    """Whether the path names a KRL program's source."""
    return path.suffix.lower() == SOURCE


def load_program(path: Path) -> Program:
    """Read a program with the data list beside it; raises `SettingsError`."""
    data = _data_beside(path)
    return read_program(path.name, _text(path), (data.name, _text(data)) if data else None)


def write_program(texts: dict[str, str], source: Path, out: Path) -> list[Path]:
    """Write a program's texts, by their names at ``source``, under another stem; return the paths.

    ``out`` may end in ``.src``. Raises `SettingsError`; then no file has changed.
    """
    paths = {name: _sibling(out, Path(name).suffix) for name in texts}
    refuse_in_place(source, list(paths.values()))
    beside = {
        name: path.with_name(f"{path.name}.{os.getpid()}.part") for name, path in paths.items()
    }
    try:
        for name, path in beside.items():
            _refuse_folder(paths[name])
            path.write_bytes(texts[name].encode(ENCODING))
        for name, path in beside.items():
            path.replace(paths[name])
    except OSError as error:
        for path in beside.values():
            path.unlink(missing_ok=True)
        raise SettingsError(str(out), [f"cannot be written: {error}"]) from error
    return list(paths.values())


def refuse_in_place(source: Path, paths: list[Path]) -> None:
    """Refuse to replace the nominal targets: corrected again, they would be corrected twice."""
    if source.resolve() in [path.resolve() for path in paths]:
        raise SettingsError(str(source), ["is what is read; write the corrected one elsewhere"])


def _data_beside(path: Path) -> Path | None:
    try:
        found = [
            each for each in path.parent.iterdir()
            if each.stem == path.stem and each.suffix.lower() == DATA and each.is_file()
        ]  # fmt: skip
    except OSError as error:
        raise SettingsError(str(path), [f"cannot be read: {error}"]) from error
    if len(found) > 1:
        names = ", ".join(sorted(each.name for each in found))
        raise SettingsError(str(path), [f"several data lists beside it: {names}; leave one"])
    return found[0] if found else None


def _text(path: Path) -> str:
    try:
        text = path.read_bytes().decode(ENCODING)
    except OSError as error:
        raise SettingsError(str(path), [f"cannot be read: {error}"]) from error
    if "\0" in text:
        raise SettingsError(str(path), ["has NUL bytes: not a KRL text, or saved as UTF-16"])
    return text


def _sibling(out: Path, suffix: str) -> Path:
    stem = out.stem if out.suffix.lower() in (SOURCE, DATA) else out.name
    return out.with_name(stem + suffix)


def _refuse_folder(path: Path) -> None:
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder")
