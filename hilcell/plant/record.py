"""A run as a plant keeps it: a plain record, computed from its journal.

Two readings of one journal give the same record; the documents of the run's folder are a part of
it. ``run_key`` names the run by its first record, so runs of one name in two cells stay apart. A
journal only grows, so the number of its last record is the revision of a run that was opened again,
and ``head``, the hash of its chain, proves which journal that was.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from statistics import fmean
from typing import Any
from uuid import UUID

import msgspec
import numpy as np

from hilcell.alarms import alarms_of
from hilcell.calibration.frames import grid_of, measured_grid
from hilcell.errors import HilcellError
from hilcell.journal.index import RunRow, row_of_records
from hilcell.journal.journal import Record, chain
from hilcell.journal.log import Log
from hilcell.model.events import Asset
from hilcell.model.outcome import Figure
from hilcell.model.point import Point
from hilcell.model.verdicts import LengthsChecked
from hilcell.typed import typed

ROBOT, TRACKER = "robot", "tracker"
MONTH = 7  # letters of 2026-11


class NotOver(HilcellError):
    """The run has not come to an end of its own: it is shipped later."""

    code = "HC-J21"


class GridErrors(msgspec.Struct, frozen=True):
    """Errors (N, 3) of the robot at the vertices of its grid (N, 3), both mm in {B}."""

    places_mm: list[list[float]]
    errors_mm: list[list[float]]
    temperature_c: float | None


class FrameEntry(msgspec.Struct, frozen=True):
    """A frame (4, 4) and its covariance (6, 6), where it has one."""

    key: str
    matrix: list[list[float]]
    covariance: list[list[float]] | None


class PointEntry(msgspec.Struct, frozen=True):
    """A point with the number and the time of its record.

    One that is ``superseded`` does not count: it was measured again, or its tracker had moved.
    """

    seq: int
    t: str
    point: Point
    superseded: bool = False


class VerdictEntry(msgspec.Struct, frozen=True):
    """A verdict; the figures of those that judge a place by its mean error."""

    key: str
    holds: bool
    body: dict[str, Any]
    mean_mm: float | None = None
    mean_U_mm: float | None = None
    mean_tolerance_mm: float | None = None


class AlarmEntry(msgspec.Struct, frozen=True):
    """An alarm of the run's last session; one that no record dates has the time of its end."""

    t: str
    code: str
    severity: str
    title: str
    place: str
    found: str


class LengthEntry(msgspec.Struct, frozen=True):
    """A certified length as the tracker found it."""

    nests: str
    wanted_mm: float
    found_mm: float
    U_mm: float


class StreamEntry(msgspec.Struct, frozen=True):
    """A stream that counts. Its samples stay with the run; the digest proves which they were."""

    key: str
    file: str
    sha256: str
    samples: int
    joint_samples: int


class Document(msgspec.Struct, frozen=True):
    """A file of the run's folder, whole, with its SHA-256."""

    name: str
    sha256: str
    text: str


class RunRecord(msgspec.Struct, frozen=True, kw_only=True):
    """The whole record. ``month`` is that in which the run began: the key of the partition."""

    run_key: UUID
    revision: int
    head: str
    month: str
    row: RunRow
    versions: dict[str, str]
    devices: list[Asset]
    frames: list[FrameEntry]
    points: list[PointEntry]
    verdicts: list[VerdictEntry]
    alarms: list[AlarmEntry]
    lengths: list[LengthEntry]
    grid: GridErrors | None
    streams: list[StreamEntry]
    documents: list[Document]

    def serial(self, kind: str) -> str:
        """Return the serial number of the device of a kind; "" where none answered."""
        return next((each.serial for each in self.devices if each.kind == kind), "")


def heads(records: Sequence[Record]) -> list[str]:
    """Return the hash of the journal's chain after each record."""
    found: list[str] = []
    before = b""
    for record in records:
        before = chain(before, record)
        found.append(before.hex())
    return found


def key_of(run: str, records: Sequence[Record]) -> tuple[UUID, int]:
    """Return the key of a run, and the revision that its journal has reached."""
    first = chain(b"", records[0]).hex()
    return short(f"{run}\n{first}".encode()), records[-1].seq


def record_of(run: str, records: Sequence[Record], documents: Sequence[Document] = ()) -> RunRecord:
    """Return the record of a run that is over, with the documents of its folder.

    Raises `NotOver`, and `msgspec.ValidationError`, `KeyError` where the journal is none of a run.
    """
    row, log = row_of_records(run, records), Log(records)
    if not log.over or log.end is None:
        raise NotOver(f"run {run}: it is {row.condition}; `hilcell resume {run}` ends it")
    chained = heads(records)
    first, last = records[0], records[-1]
    run_key, revision = key_of(run, records)
    record = RunRecord(
        run_key=run_key,
        revision=revision,
        head=chained[-1],
        month=f"{first.t[:MONTH]}-01",
        row=row,
        versions=log.inputs.versions,
        devices=log.assets,
        frames=[
            FrameEntry(key, frame.matrix, frame.covariance or None)
            for key, frame in log.frames.items()
        ],
        points=list(_points(log, records)),
        verdicts=list(_verdicts(log)),
        alarms=[
            AlarmEntry(
                each.t or last.t, each.code, each.severity, each.title, each.where, each.found
            )
            for each in alarms_of(log, run, live=False)
        ],
        lengths=list(_lengths(log)),
        grid=_grid(log),
        streams=[
            StreamEntry(key, each.file, each.sha256, each.samples, each.joint_samples)
            for key, each in log.streams.items()
        ],
        documents=list(documents),
    )
    if b"\\u0000" not in msgspec.json.encode(record):
        return record
    return typed(_without_nul(msgspec.to_builtins(record)), RunRecord)


def _points(log: Log, records: Sequence[Record]) -> Iterator[PointEntry]:
    """Yield all points in the order of their records."""
    counting = {log.recorded(point): point for point in log.points.values()}
    for record in records:
        if record.kind == "point":
            superseded = record.seq not in counting
            point = log.read(record) if superseded else counting[record.seq]
            plain = Point(**msgspec.structs.asdict(point))  # the log's own are packed
            yield PointEntry(record.seq, record.t, plain, superseded)


def _verdicts(log: Log) -> Iterator[VerdictEntry]:
    for key, record in log.judged.items():
        verdict = log.verdicts[key]
        mean = next((each for each in verdict.figures if each.name == "mean"), Figure("", None))
        entry = VerdictEntry(key, verdict.holds, record.body, mean.value, mean.U, mean.limit)
        yield entry


def _lengths(log: Log) -> Iterator[LengthEntry]:
    checked = log.verdict(LengthsChecked)
    for each in () if checked is None else checked.lengths:
        yield LengthEntry("-".join(each.nests), each.wanted_mm, each.found_mm, each.U_mm)


def _grid(log: Log) -> GridErrors | None:
    """Return the errors at the vertices of a grid that was measured whole."""
    points = log.select("grid")
    if not points or not {"world", "base"} <= log.frames.keys():
        return None
    errors_mm = measured_grid(log).errors_mm.reshape(-1, 3)
    if not np.isfinite(errors_mm).all():
        return None
    places_mm = grid_of(log.cell).vertices_mm().reshape(-1, 3)
    celsius = [point.temperature_c for point in points if point.temperature_c is not None]
    return GridErrors(places_mm.tolist(), errors_mm.tolist(), fmean(celsius) if celsius else None)


def _without_nul(value: Any) -> Any:
    """Return plain values without the one character that no text of a database may hold."""
    if isinstance(value, str):
        return value.replace("\0", "\N{REPLACEMENT CHARACTER}")
    if isinstance(value, dict):
        return {_without_nul(key): _without_nul(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_without_nul(each) for each in value]
    return value


def short(content: bytes) -> UUID:
    """Return the first 128 bits of a SHA-256."""
    return UUID(bytes=hashlib.sha256(content).digest()[:16])
