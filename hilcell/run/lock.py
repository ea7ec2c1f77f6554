"""Locks of a cell: two runs never command the same devices.

Locks are of the operating system (flock): they vanish with their process, however it dies.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import tempfile
from pathlib import Path
from types import TracebackType
from typing import IO

from hilcell.ports import HilcellError


class CellLocked(HilcellError):
    """Another run holds the cell."""


class CellLock:
    """Holds the cell's name in one runs folder, and each device address on this machine."""

    def __init__(self, runs: Path, cell: str, addresses: list[str], run: str) -> None:
        self._run, self._cell = run, cell
        shared = Path(tempfile.gettempdir()) / f"hilcell-locks-{os.getuid()}"
        self._paths = [runs / f".{cell}.lock"]
        self._paths += [shared / hashlib.sha256(a.encode()).hexdigest() for a in addresses]
        self._files: list[IO[str]] = []

    def __enter__(self) -> CellLock:
        """Take all locks or none; raises `CellLocked` naming the holder."""
        for path in self._paths:
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            file = path.open("a+", encoding="utf-8")
            self._files.append(file)
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                file.seek(0)
                holder = file.read().strip() or "an unknown run"
                self._release()
                raise CellLocked(
                    f"cell {self._cell} is locked by {holder}; wait for it, or "
                    "`hilcell stop` it, then start again"
                ) from None
        for file in self._files:
            file.truncate(0)
            file.write(f"run {self._run}, pid {os.getpid()}")
            file.flush()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Release the locks."""
        self._release()

    def _release(self) -> None:
        while self._files:
            self._files.pop().close()
