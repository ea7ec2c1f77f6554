"""Which engine writes a run's journal now: a file beside it says where the engine listens."""

from __future__ import annotations

import socket
from pathlib import Path

import msgspec

from hilcell.journal.journal import is_there
from hilcell.typed import decoded

ENGINE = "engine.json"  # in the run's folder, while its engine lives
LARGEST = 2**16  # bytes
ANSWER_S = 5.0


class EngineFile(msgspec.Struct, frozen=True):
    """Where a live engine listens, and the folder of its run; "" is not known."""

    pid: int
    socket: str
    folder: str = ""


def read_engine_file(folder: Path) -> EngineFile | None:
    """Return where an engine of a run has listened last; None where the file says nothing.

    That of a copied folder speaks of the original's engine, which moves the machine.
    """
    engine = _stated(folder)
    return None if engine is None or _is_copied(engine, folder) else engine


def _stated(folder: Path) -> EngineFile | None:
    try:
        if not is_there(folder / ENGINE):
            return None  # opening a pipe may never end
        with (folder / ENGINE).open("rb") as file:
            return decoded(file.read(LARGEST), EngineFile)
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None


def _is_copied(engine: EngineFile, folder: Path) -> bool:
    """Whether the file belongs to another folder, which still has it; a moved one has not."""
    first = Path(engine.folder)
    try:
        return bool(engine.folder) and not first.samefile(folder) and _stated(first) == engine
    except (OSError, ValueError):  # a name that no file can have
        return False


def live_engine(folder: Path) -> EngineFile | None:
    """Return where the engine of a run listens, or None where none lives.

    One whose process stands still lives: it moves again as soon as it goes on.
    """
    engine = read_engine_file(folder)
    if engine is None:
        return None
    with socket.socket(socket.AF_UNIX) as link:
        link.settimeout(ANSWER_S)
        try:
            link.connect(engine.socket)
        except (BlockingIOError, TimeoutError):
            return engine  # it lives, and takes nobody any more
        except (OSError, ValueError):
            return None
    return engine
