"""The folder of runs: one folder a run, with a journal in it."""

from __future__ import annotations

import re
import secrets
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from hilcell.errors import HilcellError, one_line
from hilcell.journal.engine_file import ENGINE
from hilcell.journal.journal import (
    NeverBegan,
    Record,
    StorageError,
    is_there,
    read_journal,
)

if TYPE_CHECKING:
    from hilcell.journal.log import Log

JOURNAL = "journal.sqlite"
CALIBRATION = "calibration.json"
_GIVEN = re.compile(r"\d{8}-\d{6}-.+-[0-9a-f]{4}")  # by `new_run`
FETCH = "fetch the run's folder from the backup, or start a new run with `hilcell run`"


def new_run(procedure: str) -> str:
    """Return a new run's name: when, what, and four characters against collisions."""
    return f"{datetime.now(UTC):%Y%m%d-%H%M%S}-{procedure}-{secrets.token_hex(2)}"


def short_run(run: str) -> str:
    """Return the part of a run's name that tells it from others: its own name, or the end of one
    that `new_run` gave.
    """
    return run[-4:] if _GIVEN.fullmatch(run) else run


def make_folder(folder: Path) -> None:
    """Make the folder of a run, with an empty journal; raises `StorageError`.

    A folder without one is that of a run whose journal was lost.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / JOURNAL).touch(mode=0o644)
    except OSError as error:
        raise StorageError(f"run folder {folder} cannot be used: {error.strerror}") from error


def forget(folder: Path) -> None:
    """Remove the journal of a run that never began, and its folder where nothing else is in it."""
    for suffix in ("", "-wal", "-shm"):
        (folder / f"{JOURNAL}{suffix}").unlink(missing_ok=True)
    with suppress(OSError):
        folder.rmdir()


def run_folders(runs: Path) -> list[Path]:
    """Return the folders that hold a journal, oldest first; raises `StorageError`."""
    try:
        folders = list(runs.iterdir())
    except FileNotFoundError:
        return []  # no run was ever made there
    except OSError as error:
        raise unusable(runs, error) from error
    return sorted(filter(is_run, folders))


def unusable(runs: Path, error: OSError) -> HilcellError:
    """Return the error of a folder of runs that cannot be read; another name mends a file."""
    if isinstance(error, NotADirectoryError):
        return HilcellError(f"runs folder {runs} is a file: name the folder of runs")
    return StorageError(f"runs folder {runs} cannot be used: {error.strerror}")


def is_run(folder: Path) -> bool:
    """Whether a folder holds a journal, or may: one that must not be looked into counts."""
    try:
        return is_there(folder / JOURNAL)
    except OSError:
        return True


def read_log(folder: Path) -> Log:
    """Return a run's log; raises `StorageError`."""
    from hilcell.journal.log import Log  # loads arrays, which a list of runs does without

    records = read_records(folder)
    try:
        return Log(records)
    except HilcellError:
        raise
    except Exception as error:
        raise StorageError(
            f"journal {folder / JOURNAL}: its records are no run's: {one_line(error)}; another "
            "version of hilcell wrote it, or somebody has changed it",
            code="HC-J02",
        ) from error


def read_records(folder: Path) -> list[Record]:
    """Return the records of a run that has begun; raises `NeverBegan`, `StorageError`."""
    journal = folder / JOURNAL
    if records := read_journal(journal):
        return records
    later = [name for name in (CALIBRATION, ENGINE) if (folder / name).exists()]
    if later:
        raise StorageError(
            f"journal {journal}: it is empty, although {later[0]} is there: its records are lost; "
            f"{FETCH}",
            code="HC-J02",
        )
    raise NeverBegan(
        f"run {folder.name} never began: it died before the first record of {journal}; "
        "start a new run with `hilcell run`"
    )
