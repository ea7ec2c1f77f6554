"""The folder of runs: one folder a run with its journal.

While an engine writes a run's journal, a file beside it has that engine's address.
"""

from __future__ import annotations

import re
import secrets
import socket
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from hilcell.decoding import decoded
from hilcell.errors import HilcellError, one_line
from hilcell.journal.journal import (
    RESTORE_ADVICE,
    NeverBegan,
    Record,
    StorageError,
    is_regular_file,
    read_journal,
)

if TYPE_CHECKING:
    from hilcell.journal.log import Log


JOURNAL = "journal.sqlite"
CALIBRATION = "calibration.json"
ENGINE = "engine.json"  # while the run's engine lives
ANSWER_S = 5.0  # of an engine


def new_run(procedure: str) -> str:
    """Return a new run's name: time, procedure, and four characters against collisions."""
    return f"{datetime.now(UTC):%Y%m%d-%H%M%S}-{procedure}-{secrets.token_hex(2)}"


def short_run(run: str) -> str:
    """Return a run's given name, or the last four characters of a name by `new_run`."""
    given = re.fullmatch(r"\d{8}-\d{6}-.+-[0-9a-f]{4}", run)
    return run[-4:] if given else run


def make_folder(folder: Path) -> None:
    """Make the folder of a run with an empty journal; raises `StorageError`."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / JOURNAL).touch(mode=0o644)
    except OSError as error:
        raise StorageError(f"run folder {folder} cannot be used: {error.strerror}") from error


def remove_unbegun(folder: Path) -> None:
    """Remove the journal of a run that never began, and its folder if empty."""
    for suffix in ("", "-wal", "-shm"):
        (folder / f"{JOURNAL}{suffix}").unlink(missing_ok=True)
    with suppress(OSError):
        folder.rmdir()


def run_folders(runs: Path) -> list[Path]:
    """Return the folders with a journal, oldest first; raises `StorageError`."""
    try:
        folders = list(runs.iterdir())
    except FileNotFoundError:
        return []  # no run yet
    except OSError as error:
        raise unusable(runs, error) from error
    return sorted(filter(is_run, folders))


def unusable(runs: Path, error: OSError) -> HilcellError:
    if isinstance(error, NotADirectoryError):
        return HilcellError(f"runs folder {runs} is a file: name the folder of runs")
    return StorageError(f"runs folder {runs} cannot be used: {error.strerror}")


def is_run(folder: Path) -> bool:
    """Whether a folder has a journal, or may: one without read permission counts."""
    try:
        return is_regular_file(folder / JOURNAL)
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
    except Exception as error:  # invalid records of any kind
        raise StorageError(
            f"journal {folder / JOURNAL}: invalid records: {one_line(error)}; another version "
            f"of hilcell wrote it, or it was changed; {RESTORE_ADVICE}",
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
            f"{RESTORE_ADVICE}",
            code="HC-J02",
        )
    raise NeverBegan(
        f"run {folder.name} never began: it died before the first record of {journal}; "
        "start a new run with `hilcell run`"
    )


# -- the engine of a run ---------------------------------------------------------------------------


class EngineFile(msgspec.Struct, frozen=True):
    """The address of a live engine and the folder of its run, "" if unknown."""

    pid: int
    socket: str
    folder: str = ""


def read_engine_file(folder: Path) -> EngineFile | None:
    """Return the last engine of a run; None without one.

    The file of a copied folder is the original's engine, which moves the machine.
    """
    engine = _engine_file_in(folder)
    if engine is None or not engine.folder:
        return engine
    first = Path(engine.folder)  # exists if the folder was copied, not moved
    try:
        return None if not first.samefile(folder) and _engine_file_in(first) == engine else engine
    except (OSError, ValueError):  # not a valid file name
        return engine


def _engine_file_in(folder: Path) -> EngineFile | None:
    try:
        if not is_regular_file(folder / ENGINE):
            return None  # opening a pipe may block
        with (folder / ENGINE).open("rb") as file:
            return decoded(file.read(2**16), EngineFile)  # a longer one is invalid
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None


def live_engine(folder: Path) -> EngineFile | None:
    """Return the live engine of a run, or None.

    A suspended process counts as alive: it moves again once it continues.
    """
    engine = read_engine_file(folder)
    if engine is None:
        return None
    with socket.socket(socket.AF_UNIX) as link:
        link.settimeout(ANSWER_S)
        try:
            link.connect(engine.socket)
        except (BlockingIOError, TimeoutError):
            return engine  # alive, but accepts no connection
        except (OSError, ValueError):
            return None
    return engine
