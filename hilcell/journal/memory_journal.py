"""The records of a run in memory alone: for studies, whose runs are computed again, not resumed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hilcell.journal.journal import Kind, Record, plain_body
from hilcell.journal.log import Log


class MemoryJournal:
    """Satisfies `hilcell.journal.run_journal.Records`."""

    def __init__(self, folder: Path, moment: str) -> None:
        """``folder`` takes the streams; every record has the one time ``moment``, ISO 8601."""
        self.log = Log(packed=False)  # a study's run ends in seconds, and asks for them all
        self.path = folder / "journal"
        self._moment, self._seq = moment, 0

    def append(self, kind: Kind, key: str, body: dict[str, Any]) -> Record:
        """Apply one record to the log and return it; raises `NotFinite`."""
        plain, _ = plain_body(body, f"record {self._seq + 1} ({kind} {key or '-'})")
        self._seq += 1
        record = Record(self._seq, self._moment, kind, key, plain)
        self.log.take(record)
        return record
