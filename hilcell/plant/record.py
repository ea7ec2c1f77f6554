"""A run as a plant keeps it: its rows in the plant's tables, computed from its journal.

Two readings of one journal give the same rows; the documents of the run's folder are a part of
them. ``run_key`` names the run by its first record, so runs of one name in two cells stay apart. A
journal only grows, so the number of its last record is the revision of a run that was opened again,
and ``head``, the hash of its chain, proves which journal that was.

The digest follows from the rows alone: it is the same of those that are about to be written and of
those that were read back, from either store. So it shows whether they are as they were shipped.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import date, datetime
from itertools import accumulate
from shlex import quote
from statistics import fmean
from typing import NamedTuple
from uuid import UUID

import msgspec
import numpy as np
from sqlalchemy import Double, Table

from hilcell.alarms import alarms_of
from hilcell.calibration.grid import grid_of, measured_grid
from hilcell.errors import HilcellError
from hilcell.journal.index import RunRow, row_of_records
from hilcell.journal.journal import Record, chain
from hilcell.journal.log import Log
from hilcell.model.outcome import Figure
from hilcell.model.verdicts import LengthsChecked
from hilcell.plant.tables import (
    ALARM,
    DEVICE,
    DOCUMENT,
    FRAME,
    GRID,
    LENGTH,
    POINT,
    RUN,
    STREAM,
    VERDICT,
    Utc,
)

TRACKER = "tracker"
Values = Mapping[str, object]  # of a row, by column


class NotOver(HilcellError):
    """The run has not come to an end of its own: it is shipped later."""

    code = "HC-J21"


class Document(msgspec.Struct, frozen=True):
    """A file of the run's folder, whole, with its SHA-256."""

    name: str
    sha256: str
    text: str


class RunRecord(NamedTuple):
    """A run's rows by their table, each with their digest; the run's own is that of `RUN`."""

    run_key: UUID
    revision: int
    row: RunRow
    rows: Mapping[Table, Sequence[Values]]


def heads(records: Sequence[Record]) -> list[str]:
    """Return the hash of the journal's chain after each record."""
    return [each.hex() for each in accumulate(records, chain, initial=b"")][1:]


def key_of(run: str, records: Sequence[Record]) -> tuple[UUID, int]:
    """Return the key of a run, and the revision that its journal has reached."""
    first = chain(b"", records[0]).hex()
    return short(f"{run}\n{first}".encode()), records[-1].seq


def record_of(run: str, records: Sequence[Record], documents: Sequence[Document] = ()) -> RunRecord:
    """Return the record of a run that is over, with the documents of its folder.

    Raises `NotOver`, and `msgspec.ValidationError`, `KeyError`, `ValueError` where the journal is
    none of a run.
    """
    row, log = row_of_records(run, records), Log(records)
    if not log.over or log.end is None:
        raise NotOver(f"run {run}: it is {row.condition}; `hilcell resume {quote(run)}` ends it")
    head, (run_key, revision) = heads(records)[-1], key_of(run, records)
    month = date.fromisoformat(f"{records[0].t[:7]}-01")
    points = [{"month": month, **each} for each in _points(log, records)]
    checked = log.verdict(LengthsChecked)
    whole: dict[Table, Sequence[Values]] = {
        FRAME: [
            {"key": key, "matrix": each.matrix, "covariance": each.covariance or None}
            for key, each in log.frames.items()
        ],
        VERDICT: [_verdict(log, record) for record in log.judged.values()],
        DEVICE: _numbered(_columns(DEVICE, each) for each in log.assets),
        ALARM: _numbered(
            {
                "t": _moment(each.t or records[-1].t),
                "code": each.code,
                "severity": each.severity,
                "title": each.title,
                "place": each.where,
                "found": each.found,
            }
            for each in alarms_of(log, run, live=False)
        ),
        LENGTH: _numbered(
            _columns(LENGTH, each) | {"nests": "-".join(each.nests)}
            for each in (() if checked is None else checked.lengths)
        ),
        GRID: list(_grid(log)),
        STREAM: [_columns(STREAM, each) for each in log.streams.values()],
        DOCUMENT: [_columns(DOCUMENT, each) for each in documents],
        POINT: points,
    }
    serials = {each.kind: each.serial for each in log.assets}
    whole[RUN] = [
        _columns(RUN, row)
        | {
            "run_key": run_key,
            "revision": revision,
            "head": head,
            "month": month,
            "cell_key": short(msgspec.json.encode((row.cell, row.serial, _machine(row)))),
            "machine": _machine(row),
            "begun": _moment(row.begun),
            "ended": _moment(row.ended),
            "points": sum(not each["superseded"] for each in points),
            "proven": _proven(row),
            "robot": serials.get("robot", ""),
            "tracker": serials.get(TRACKER, ""),
            "version": log.inputs.versions.get("hilcell", ""),
            "row": msgspec.to_builtins(row),
        }
    ]
    whole = {
        table: [{name: _without_nul(value) for name, value in each.items()} for each in rows]
        for table, rows in whole.items()
    }
    own = {"digest": digest_of(whole)}
    rows = {table: [own | dict(each) for each in every] for table, every in whole.items()}
    return RunRecord(run_key, revision, row, rows)


def digest_of(rows: Mapping[Table, Iterable[Values]]) -> UUID:
    """Return the digest of a run's rows, in any order."""
    lines = sorted(line for table, every in rows.items() for line in _lines(table, every))
    return short("\n".join(lines).encode())


def _lines(table: Table, rows: Iterable[Values]) -> Iterator[str]:
    """Yield a line of each row: its values by column, floats to their last digit."""
    numbers = {each.name for each in table.columns if isinstance(each.type, Double)}
    moments = {each.name for each in table.columns if isinstance(each.type, Utc)}
    encode = json.JSONEncoder(sort_keys=True, default=str).encode
    own = {"digest", "shipped"}  # columns that the digest is not of: itself, and the server's clock
    for row in rows:
        values = {name: value for name, value in row.items() if name not in own}
        for name, value in values.items():
            if name in numbers and isinstance(value, int | float):
                values[name] = float(value) + 0.0  # SQLite keeps no -0.0
            elif name in moments and isinstance(value, datetime):
                values[name] = Utc.in_utc(value)
        yield f"{table.name} {encode(values)}"


def _machine(row: RunRow) -> str:
    """Return which simulated machine it was: each is a cell of its own; "" for a real one."""
    if not row.simulated:
        return ""
    return "simulated" if row.machine_seed is None else f"simulated {row.machine_seed}"


def _proven(row: RunRow) -> bool:
    """Whether the run made a calibration that supersedes those before it."""
    made = row.facts.kind == "made" and row.calibrates
    return made and row.facts.validated and row.exit == 0 and not row.facts.revoked


def _numbered(rows: Iterable[Values]) -> list[Values]:
    return [{"n": n, **each} for n, each in enumerate(rows)]


def _columns(table: Table, part: msgspec.Struct) -> dict[str, object]:
    """Return the fields of a part of a run that are columns of its table."""
    return {name: getattr(part, name) for name in part.__struct_fields__ if name in table.c}


def _points(log: Log, records: Sequence[Record]) -> Iterator[Values]:
    """Yield all points in the order of their records.

    One that is superseded does not count: it was measured again, or its tracker had moved.
    """
    counting = {log.recorded(point): point for point in log.points.values()}
    for record in records:
        if record.kind == "point":
            superseded = record.seq not in counting
            point = log.read(record) if superseded else counting[record.seq]
            places_mm = [*point.xyz_mm, *point.std_mm, *(point.nominal_mm or (None, None, None))]
            names = [f"{of}{axis}_mm" for of in ("", "std_", "nominal_") for axis in "xyz"]
            yield {
                **_columns(POINT, point),
                **dict(zip(names, places_mm, strict=True)),
                "seq": record.seq,
                "t": _moment(record.t),
                "kind": point.group,
                "superseded": superseded,
            }


def _verdict(log: Log, record: Record) -> Values:
    """Return a verdict's row, with the mean error where it judges one."""
    verdict = log.verdicts[record.key]
    mean = next((each for each in verdict.figures if each.name == "mean"), Figure("", None))
    return {
        "key": record.key,
        "holds": verdict.holds,
        "body": record.body,
        "mean_mm": mean.value,
        "mean_U_mm": mean.U,
        "mean_tolerance_mm": mean.limit,
    }


def _grid(log: Log) -> Iterator[Values]:
    """Yield the errors at the vertices of a grid that was measured whole."""
    points = log.select("grid")
    if not points or not {"world", "base"} <= log.frames.keys():
        return
    errors_mm = measured_grid(log).errors_mm.reshape(-1, 3)
    if np.isfinite(errors_mm).all():
        celsius = [point.temperature_c for point in points if point.temperature_c is not None]
        yield {
            "places_mm": grid_of(log.cell).vertices_mm().reshape(-1, 3).tolist(),
            "errors_mm": errors_mm.tolist(),
            "temperature_c": fmean(celsius) if celsius else None,
        }


def _moment(t: str) -> datetime:
    """Return a time; raises `ValueError` where no clock of a cell can have said it."""
    found = datetime.fromisoformat(t)
    if not 1980 <= found.year < 2200:  # a PC whose battery is empty begins with the first
        raise ValueError(f"expected a time of the years 1980 to 2199, got {t}")
    return found


def _without_nul(value: object) -> object:
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
