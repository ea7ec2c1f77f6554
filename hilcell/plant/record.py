"""A run in the plant's database: its rows, computed from its journal and attachments.

``run_key`` identifies the run by its first record, so runs of one name in two cells are distinct. A
journal only grows: the number of its last record is the run's revision, and ``head``, the hash of
its chain, identifies that journal.

The digest depends on the rows alone, so it is the same for rows to be written and rows read back
from either database, and shows changes since they were shipped.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime
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
from hilcell.model.verdicts import AxesJudged, LengthsChecked
from hilcell.plant.tables import (
    ADJUSTMENT,
    ALARM,
    DEVICE,
    DOCUMENT,
    FRAME,
    GRID,
    LENGTH,
    OUTCOME,
    POINT,
    RUN,
    SERVER_COLUMNS,
    STREAM,
    TRACKER,
    VERDICT,
    Utc,
)

Values = Mapping[str, object]  # of a row, by column


class RunNotFinished(HilcellError):
    """The run has not ended yet: it is shipped later."""

    code = "HC-J21"


class Document(msgspec.Struct, frozen=True):
    """A file of the run's folder with its SHA-256."""

    name: str
    sha256: str
    text: str


class RunRecord(NamedTuple):
    """A run's rows by table, each with the run's digest."""

    run_key: UUID
    revision: int
    row: RunRow
    rows: Mapping[Table, Sequence[Values]]


def heads(records: Sequence[Record]) -> list[str]:
    """Return the hash of the journal's chain after each record."""
    return [each.hex() for each in accumulate(records, chain, initial=b"")][1:]


def run_key_of(run: str, records: Sequence[Record]) -> tuple[UUID, int]:
    first = chain(b"", records[0]).hex()
    return first_128_bits(f"{run}\n{first}".encode()), records[-1].seq


def cell_key_of(row: RunRow) -> UUID:
    """Return the key of a run's cell, which the server computes as well."""
    names = [_replace_nul(each) for each in (row.cell, row.serial, _machine(row))]
    return first_128_bits(json.dumps(names, ensure_ascii=False).encode())


def run_record(
    run: str, records: Sequence[Record], documents: Sequence[Document] = ()
) -> RunRecord:
    """Return the record of an ended run, with its attachments.

    Raises `RunNotFinished`, and `msgspec.ValidationError`, `KeyError`, `ValueError` where the
    journal is not one of a run.
    """
    row, log = row_of_records(run, records), Log(records)
    if not log.over or log.end is None:
        raise RunNotFinished(
            f"run {run}: it is {row.condition}; `hilcell resume {quote(run)}` ends it"
        )
    head, (run_key, revision) = heads(records)[-1], run_key_of(run, records)
    points = list(_points(log, records))
    checked, axes = log.verdict(LengthsChecked), log.verdict(AxesJudged)
    first_end = next(each for each in records if each.kind == "end")
    whole: dict[Table, Sequence[Values]] = {
        OUTCOME: [{"row": msgspec.to_builtins(row)}],
        FRAME: [
            {"key": key, "matrix": each.matrix, "covariance": each.covariance or None}
            for key, each in log.frames.items()
        ],
        VERDICT: [_verdict(log, record) for record in log.verdict_records.values()],
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
        ADJUSTMENT: [] if axes is None else [_columns(ADJUSTMENT, axes)],
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
            "cell_key": cell_key_of(row),
            "machine": _machine(row),
            "begun": _moment(row.begun),
            "first_ended": _moment(first_end.t).replace(microsecond=0),  # as the others
            "ended": _moment(row.ended),
            "points": sum(not each["superseded"] for each in points),
            "proven": _is_valid_calibration(row),
            "robot": serials.get("robot", ""),
            "tracker": serials.get(TRACKER, ""),
            "devices": first_128_bits(msgspec.json.encode(whole[DEVICE])),
            "version": log.inputs.versions.get("hilcell", ""),
        }
    ]
    whole = {
        table: [{name: _replace_nul(value) for name, value in each.items()} for each in rows]
        for table, rows in whole.items()
    }
    own = {"digest": rows_digest(whole)}
    rows = {table: [own | dict(each) for each in every] for table, every in whole.items()}
    return RunRecord(run_key, revision, row, rows)


def rows_digest(rows: Mapping[Table, Iterable[Values]]) -> UUID:
    """Return the digest of a run's rows, in any order."""
    lines = sorted(line for table, every in rows.items() for line in _lines(table, every))
    return first_128_bits("\n".join(lines).encode())


def _lines(table: Table, rows: Iterable[Values]) -> Iterator[str]:
    """Yield each row as a line: its values by column, floats to the last digit."""
    numbers = {each.name for each in table.columns if isinstance(each.type, Double)}
    moments = {each.name for each in table.columns if isinstance(each.type, Utc)}
    encode = json.JSONEncoder(sort_keys=True, default=str).encode
    excluded = {"digest", *SERVER_COLUMNS}
    for row in rows:
        values = {name: value for name, value in row.items() if name not in excluded}
        for name, value in values.items():
            if name in numbers and isinstance(value, int | float):
                values[name] = float(value) + 0.0  # SQLite stores no -0.0
            elif name in moments and isinstance(value, datetime):
                values[name] = Utc.in_utc(value)
        yield f"{table.name} {encode(values)}"


def _machine(row: RunRow) -> str:
    """Return the simulated machine, each a cell of its own; "" for a real cell."""
    if not row.simulated:
        return ""
    return "simulated" if row.machine_seed is None else f"simulated {row.machine_seed}"


def _is_valid_calibration(row: RunRow) -> bool:
    """Whether the run made a calibration that supersedes those before it."""
    made = row.facts.kind == "made" and row.calibrates
    return made and row.facts.validated and row.exit == 0 and not row.facts.revoked


def _numbered(rows: Iterable[Values]) -> list[Values]:
    return [{"n": n, **each} for n, each in enumerate(rows)]


def _columns(table: Table, part: msgspec.Struct) -> dict[str, object]:
    """Return the fields of ``part`` that are columns of its table."""
    return {name: getattr(part, name) for name in part.__struct_fields__ if name in table.c}


def _points(log: Log, records: Sequence[Record]) -> Iterator[Values]:
    """Yield all points in the order of their records, with those superseded by later ones."""
    valid = {log.recorded(point): point for point in log.points.values()}
    for record in records:
        if record.kind == "point":
            superseded = record.seq not in valid
            point = log.read(record) if superseded else valid[record.seq]
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
    """Return a verdict's row, with its mean error if it has one."""
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
    points = log.select("grid")
    if not points or not {"world", "base"} <= log.frames.keys():
        return
    errors_mm = measured_grid(log).errors_mm.reshape(-1, 3)
    places_mm = np.ascontiguousarray(grid_of(log.cell).vertices_mm().reshape(-1, 3), dtype="<f8")
    base, arm_mm = log.matrix("base"), 1000.0
    base_mm = base[:3, 3] + arm_mm * np.vstack([np.zeros(3), base[:3, :2].T])
    if np.isfinite(errors_mm).all():
        celsius = [point.temperature_c for point in points if point.temperature_c is not None]
        yield {
            "layout": first_128_bits(places_mm.tobytes()),
            "places_mm": places_mm.tolist(),
            "errors_mm": errors_mm.tolist(),
            "base_mm": base_mm.tolist(),
            "mean_mm": fmean(np.linalg.norm(errors_mm, axis=1)),
            "temperature_c": fmean(celsius) if celsius else None,
        }


def _moment(t: str) -> datetime:
    """Return a time; raises `ValueError` for an implausible one."""
    moment = datetime.fromisoformat(t)
    if not 1980 <= moment.year < 2200:  # a PC with an empty battery starts in 1980
        raise ValueError(f"expected a time of the years 1980 to 2199, got {t}")
    return moment


def _replace_nul(value: object) -> object:
    """Return plain values without NUL, which databases refuse in text."""
    if isinstance(value, str):
        return value.replace("\0", "\N{REPLACEMENT CHARACTER}")
    if isinstance(value, dict):
        return {_replace_nul(key): _replace_nul(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_replace_nul(each) for each in value]
    return value


def first_128_bits(content: bytes) -> UUID:
    """Return the first 128 bits of a SHA-256."""
    return UUID(bytes=hashlib.sha256(content).digest()[:16])
