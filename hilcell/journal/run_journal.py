"""A run's journal and its log, which are one: each appended record is applied to the log.

The log has what the file held before, so a resumed run is set up as a new one is.
"""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from hilcell.journal.journal import Body, Journal, Record
from hilcell.journal.log import Log
from hilcell.model.records import Kind


class Records(Protocol):
    """Takes the records of a run; ``path`` is in the folder that takes its streams."""

    log: Log
    path: Path

    def append(self, kind: Kind, key: str, body: Body) -> Record:
        """Keep one record, apply it to the log and return it; raises `NotFinite`."""


class RunJournal(Journal):
    """The journal of a run, open for writing, with the log of all its records."""

    def __init__(self, path: Path, run: str, *, create: bool, again: str = "") -> None:
        self.log = Log()
        super().__init__(path, run, create=create, again=again)

    def _take(self, record: Record) -> None:
        self.log.take(record)
        super()._take(record)
