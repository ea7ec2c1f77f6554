"""A file that is open for writing, and what others may do to it meanwhile.

The writer goes on without any error in a file that was deleted, replaced or cut short.
"""

from __future__ import annotations

import os
from pathlib import Path


class OpenFile:
    """A file that only grows while it is open."""

    def __init__(self, path: Path) -> None:
        """The file need not be there yet."""
        self.path = path
        self._name = os.fspath(path)
        self._found = self._look()

    def note(self) -> None:
        """Note how far the file was written, unless it was harmed: that is found later."""
        if not self.lost():
            self._found = self._look()

    def lost(self) -> str:
        """Return what somebody has done to the file since it was last noted; "" for nothing."""
        if self._found is None:
            return ""
        now = self._look()
        if now is None or now[:2] != self._found[:2]:
            return "taken away or replaced"
        return "cut short" if now[2] < self._found[2] else ""

    def _look(self) -> tuple[int, int, int] | None:
        """Return which file is at the path and its size in bytes, or None where none is."""
        try:
            found = os.stat(self._name)  # noqa: PTH116 - twice a record: a Path's takes longer
        except OSError:
            return None
        return found.st_dev, found.st_ino, found.st_size
