"""The folder of runs: one folder a run, found by its name, a beginning of it, or ``last``."""

from __future__ import annotations

import math
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
    session_began_s,
)

if TYPE_CHECKING:
    from hilcell.journal.log import Log

JOURNAL = "journal.sqlite"
CALIBRATION = "calibration.json"
_GIVEN = re.compile(r"\d{8}-\d{6}-.+-[0-9a-f]{4}")  # by `new_run`
CLOCKS_APART_S = 1.0  # a disk's times are coarser than those of records
_FETCH = "fetch the run's folder from the backup, or start a new run with `hilcell run`"


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


def find_run(runs: Path, name: str) -> Path:
    """Return the folder of one run; raises `HilcellError` where none or several are meant."""
    if name and is_run(Path(name)):
        return Path(name)
    folders = run_folders(runs)
    if name == "last" and folders:
        return _last_begun(runs)
    meant = [folder for folder in folders if folder.name == name]
    meant = meant or [folder for folder in folders if name and folder.name.startswith(name)]
    if len(meant) == 1:
        return meant[0]
    if meant:
        raise HilcellError(
            f"run {name!r} is one of {', '.join(f.name for f in meant)}; say which",
            code="HC-J09",
        )
    if Path(name).parts:  # neither "" nor "."
        _check_journal(runs / name)
    newest = ", ".join(each.name for each in reversed(newest_first(runs)[:3])) or "none"
    raise HilcellError(
        f"run {name[:80]!r} is not in {runs}; newest there: {newest}",
        code="HC-J09",
    )


def _check_journal(folder: Path) -> None:
    """Raise `StorageError` where a run's folder has lost its journal."""
    journal = folder / JOURNAL
    if _is_folder(journal):
        raise StorageError(f"journal {journal}: it is a folder, wanted a file; {_FETCH}")
    if folder.name and _is_folder(folder):
        raise StorageError(f"journal {journal}: no such file in the folder of the run; {_FETCH}")


def _is_folder(path: Path) -> bool:
    with suppress(OSError):  # a name that no file can have
        return path.is_dir()
    return False


def newest_first(runs: Path) -> list[Path]:
    """Return the folders that hold a journal, the one that was last written first."""
    return sorted(run_folders(runs), key=_written_s, reverse=True)


def _last_begun(runs: Path) -> Path:
    """Return the run that was last started or resumed; a revocation writes later than that.

    No session began after its journal was last written, so few of many journals are opened.
    """
    last, last_s = Path(), -math.inf
    for folder in newest_first(runs):
        written_s = _written_s(folder)
        if written_s < last_s - CLOCKS_APART_S:
            break
        if (begun_s := session_began_s(folder / JOURNAL, written_s)) > last_s:
            last, last_s = folder, begun_s
    return last


def _written_s(folder: Path) -> float:
    """Return when a journal was last written; of one that must not be looked at, long ago."""
    written_s = 0.0
    for name in (JOURNAL, f"{JOURNAL}-wal"):
        with suppress(OSError):  # there is no second file where the engine has ended by itself
            written_s = max(written_s, (folder / name).stat().st_mtime)
    return written_s


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
            f"{_FETCH}",
            code="HC-J02",
        )
    raise NeverBegan(
        f"run {folder.name} never began: it died before the first record of {journal}; "
        "start a new run with `hilcell run`"
    )
