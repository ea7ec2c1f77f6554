"""A run as its journal proves it, with its result recomputed.

A report must be the same from the same journal, today and in a year, so nothing here asks for the
time, for a live engine or for this machine. Only how the calibration status is asked of the runs
beside it: a later one may have revoked or superseded it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import tzinfo
from pathlib import Path
from typing import TypeVar

from hilcell.calibration.file import read_calibration
from hilcell.calibration.lookup import calibration_status
from hilcell.cell.devices import load_entry
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError, read_bytes
from hilcell.decoding import Json, typed
from hilcell.identity import Identity
from hilcell.journal.calibration_status import CalibrationStatus
from hilcell.journal.journal import Record, chain
from hilcell.journal.labels import in_zone, zone_of
from hilcell.journal.log import Log
from hilcell.journal.runs import CALIBRATION, read_records
from hilcell.language import tr
from hilcell.model.events import CalibrationRevoked
from hilcell.model.outcome import Outcome
from hilcell.model.plan import PlanRecord
from hilcell.model.point import Sent
from hilcell.model.verdicts import suspected_in
from hilcell.ports import Array, HilcellError
from hilcell.run.procedure import Procedure
from hilcell.sanitize import encodable, harmless

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Facts:
    """One run: its records, its log, and the result where the run has finished."""

    run: str
    records: Sequence[Record]
    log: Log
    cell: Cell
    procedure: Procedure
    result: Json
    fingerprint: str
    file_digest: str = ""  # SHA-256 of its sound calibration file
    status: CalibrationStatus | None = None  # its calibration, among the runs of its folder

    def part(self, key: str, kind: type[T]) -> T | None:
        """Return a part of the result as its type; None where the run has none."""
        return typed(self.result[key], kind) if key in self.result else None

    def asset(self, kind: str) -> Identity | None:
        return next((each for each in self.log.assets if each.kind == kind), None)

    @property
    def inputs(self) -> PlanRecord:
        return self.log.inputs

    @property
    def finished(self) -> bool:
        return self.log.state == "finished"

    @property
    def revoked(self) -> str:
        reasons = [r.fact.reason for r in self.records if isinstance(r.fact, CalibrationRevoked)]
        if reasons:
            return reasons[-1]
        status = self.status
        if status is None or status.state != "revoked":
            return ""
        return f"by {status.by}: {status.reason}" if status.by else status.reason

    @property
    def superseded(self) -> str:
        status = self.status
        return status.by if status is not None and status.state == "superseded" else ""

    @property
    def suspected(self) -> str:
        """Return the causes that the run suspects, "" where there is none, or that is cleared."""
        if self.status is not None and self.status.state == "current":
            return ""
        if not self.log.facts.suspected:
            return ""
        return "; ".join(each.text for each in suspected_in(self.result))

    @property
    def last(self) -> Record:
        """Return the last record of the run itself, not of a resume that never began."""
        states = [n for n, each in enumerate(self.records) if each.kind == "state"]
        after = self.records[states[-1] if states else 0 :]
        ended = (each for each in after if each.kind == "end")
        return next(ended, None) or next(
            each for each in reversed(after) if not isinstance(each.fact, CalibrationRevoked)
        )

    @property
    def zone(self) -> tzinfo:
        """Return the zone of the clock on the wall where the run was made."""
        return zone_of(self.inputs.utc_offset_min)

    @property
    def date(self) -> str:
        """Return the day on which the run ended, there."""
        return in_zone(self.last.t, self.zone).date().isoformat()

    @property
    def tracker_mm(self) -> Array:
        """Return the tracker's place (3,) in {W}: measured, else that of the cell file."""
        if "world" in self.log.frames:
            return self.log.matrix("world")[:3, 3]
        return self.cell.tracker.pose.matrix()[:3, 3]

    @property
    def is_paper(self) -> bool:
        """Whether the run repeats the paper: only its report speaks of the paper's figures."""
        return self.inputs.procedure == "paper"

    def of_paper(self, words: str) -> str:
        """Return words that only the report of the paper's run has."""
        return words if self.is_paper else ""

    def series_name(self, how: Sent) -> str:
        match how:
            case Sent.BEFORE:
                return "before"
            case Sent.IDW:
                return "after, IDW" + self.of_paper(" (paper)")
        return f"after, {harmless(self.log.method) or 'chosen'}"

    def outcome_text(self, outcome: Outcome | None, none: str = "") -> str:
        """Return an outcome as the first page says it: of a simulated cell in brackets.

        ``none`` is returned where nothing was judged.
        """
        if outcome is None:
            return none
        return f"({tr(outcome.short)})" if self.inputs.simulated else tr(outcome.short)


def read_facts(folder: Path) -> Facts:
    """Read a run's folder; raises `StorageError` where the journal is not sound."""
    records = read_records(folder)
    log, run = Log(records), encodable(folder.resolve().name)
    procedure: Procedure = load_entry("procedures", log.inputs.procedure)
    result = _result(run, procedure, log)
    digest = b""
    for record in records:
        digest = chain(digest, record)
    return Facts(run, records, log, log.cell, procedure, result, digest.hex(),
                 file_digest_of(folder, log), calibration_status(folder))  # fmt: skip


def file_digest_of(folder: Path, log: Log) -> str:
    """Return the SHA-256 of a run's calibration file, as `sha256sum` gives it.

    "" where there is none, or one that was changed, or is not this cell's: none is vouched for.
    """
    path = folder / CALIBRATION
    try:
        content = read_bytes(path)
        sound = read_calibration(path).provenance.digest == log.inputs.digest
    except (OSError, SettingsError):
        return ""
    return hashlib.sha256(content).hexdigest() if sound else ""


def _result(run: str, procedure: Procedure, log: Log) -> Json:
    if log.state != "finished":
        return {}
    try:
        return procedure.result(log)
    except LookupError as error:
        wrote = log.inputs.versions.get("hilcell", "unknown")
        raise HilcellError(
            f"run {run}: its journal, of hilcell {wrote}, lacks {error} that this version's "
            f"{procedure.name} needs for its result; open it with the version that wrote it",
            code="HC-J03",
        ) from error
