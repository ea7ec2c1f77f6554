"""The documents of a run's folder that are shipped with it: the calibration file.

The folder is another PC's, so nothing in it is trusted: a link is not followed, and a file whose
seal does not hold is refused rather than shipped.
"""

from __future__ import annotations

import hashlib
import stat
from pathlib import Path

import msgspec

from hilcell.calibration.file import seal_problems
from hilcell.journal.index import RunRow
from hilcell.journal.runs import CALIBRATION
from hilcell.plant.database import PlantError
from hilcell.plant.record import Document

MOST_BYTES = 64 * 2**20


class BadDocument(PlantError):
    """A document of a run's folder is not what the run wrote."""


def documents_of(folder: Path, row: RunRow) -> list[Document]:
    """Return the calibration file of a run that ended with one; raises `BadDocument`.

    A run whose file is not there has none: its journal still holds all that it was computed from.
    """
    path = folder / CALIBRATION
    if not row.calibrates or not (path.is_symlink() or path.exists()):
        return []
    content = _content(path)
    try:
        problems = seal_problems(msgspec.json.decode(content))
        text = content.decode()
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, LookupError, TypeError):
        problems = ["is no calibration file"]
    if problems:
        raise _bad(path, problems[0])
    return [Document(path.name, hashlib.sha256(content).hexdigest(), text)]


def _content(path: Path) -> bytes:
    try:
        found = path.lstat()
        if not stat.S_ISREG(found.st_mode):
            raise _bad(path, "is a link or no file")
        if found.st_size > MOST_BYTES:
            raise _bad(path, f"has {found.st_size} bytes, wanted at most {MOST_BYTES}")
        return path.read_bytes()
    except OSError as error:
        raise _bad(path, f"cannot be read: {error.strerror}") from error


def _bad(path: Path, why: str) -> BadDocument:
    act = "put the run's own file back, or move this one elsewhere, then ship again"
    return BadDocument(f"run {path.parent.name}: its {path.name} {why}; {act}")
