"""A run of a folder, found by its name, a beginning of it, or ``last``."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from hilcell.errors import HilcellError
from hilcell.journal.index import read_index
from hilcell.journal.journal import StorageError
from hilcell.journal.runs import FETCH, JOURNAL, is_run, run_folders


def find_run(runs: Path, name: str) -> Path:
    """Return the folder of one run; raises `HilcellError` where none or several are meant."""
    if name and is_run(Path(name)):
        return Path(name)
    folders = run_folders(runs)
    if name == "last" and folders:
        return runs / _newest(runs, 1)[0]
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
    newest = ", ".join(reversed(_newest(runs, 3))) or "none"
    raise HilcellError(
        f"run {name[:80]!r} is not in {runs}; newest there: {newest}",
        code="HC-J09",
    )


def _check_journal(folder: Path) -> None:
    """Raise `StorageError` where a run's folder has lost its journal."""
    journal = folder / JOURNAL
    if _is_folder(journal):
        raise StorageError(f"journal {journal}: it is a folder, wanted a file; {FETCH}")
    if folder.name and _is_folder(folder):
        raise StorageError(f"journal {journal}: no such file in the folder of the run; {FETCH}")


def _is_folder(path: Path) -> bool:
    with suppress(OSError):  # a name that no file can have
        return path.is_dir()
    return False


def _newest(runs: Path, count: int) -> list[str]:
    """Return the names of the runs that were last begun or resumed, the newest first: by their
    order, which no clock decides. A revocation writes later, and begins nothing.
    """
    return [row.name for row in read_index(runs)[:count]]
