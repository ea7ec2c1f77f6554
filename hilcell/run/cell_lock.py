"""Locks of a cell: two runs never command the same devices.

Locks are of the operating system (flock): they vanish with their process, however it dies.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from hilcell.journal.journal import StorageError
from hilcell.ports import HilcellError


class CellLocked(HilcellError):
    """Another run holds the cell."""

    code = "HC-C04"


def lock_of_name(runs: Path, cell: str) -> Path:
    """Return the lock of a cell's name among the runs of one folder."""
    return runs / f".{cell}.lock"


def lock_of_device(known_by: str) -> Path:
    """Return the lock, on this machine, of a device known by its place or by its identity."""
    return _locks() / hashlib.sha256(known_by.encode()).hexdigest()


def _locks() -> Path:
    """Return the same folder for all runs of a user, whatever their TMPDIR."""
    try:
        fixed = Path("/tmp")  # noqa: S108 - the folder in it is the user's alone
        base = fixed if fixed.is_dir() else Path(tempfile.gettempdir())
        return base / f"hilcell-locks-{os.getuid()}"
    except OSError as error:
        raise StorageError(f"locks folder cannot be used: {error.strerror}") from error


@contextmanager
def locked(path: Path, what: str, run: str) -> Iterator[None]:
    """Hold the lock at ``path``; raises `CellLocked` with its holder, and `StorageError`."""
    with _opened(path) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.seek(0)
            holder = file.read().decode(errors="replace").strip() or "another run"
            raise CellLocked(
                f"{what} is locked by {holder}; wait for its end or `hilcell stop` it"
            ) from None
        with _storage_errors(path.parent):
            file.truncate(0)
            file.write(f"run {run} (pid {os.getpid()})".encode(errors="replace"))
        yield


def _opened(path: Path) -> BinaryIO:
    with _storage_errors(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        return path.open("a+b", buffering=0)  # what a full disk refuses is not tried again later


@contextmanager
def _storage_errors(folder: Path) -> Iterator[None]:
    """Raise `StorageError` where a folder cannot be used."""
    try:
        yield
    except OSError as error:
        kind = "locks" if folder == _locks() else "runs"
        raise StorageError(f"{kind} folder {folder} cannot be used: {error.strerror}") from error
