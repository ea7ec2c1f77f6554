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
from dataclasses import dataclass
from datetime import date, datetime
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
from hilcell.model.point import Point
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

ROBOT, TRACKER = "robot", "tracker"
MONTH = 7  # letters of 2026-11

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
    head: str
    row: RunRow
    rows: Mapping[Table, Sequence[Values]]


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

    Raises `NotOver`, and `msgspec.ValidationError`, `KeyError`, `ValueError` where the journal is
    none of a run.
    """
    row, log = row_of_records(run, records), Log(records)
    if not log.over or log.end is None:
        raise NotOver(f"run {run}: it is {row.condition}; `hilcell resume {quote(run)}` ends it")
    head, (run_key, revision) = heads(records)[-1], key_of(run, records)
    month = date.fromisoformat(f"{records[0].t[:MONTH]}-01")
    made = _Rows(log)
    points = [{"month": month, **each} for each in made.points(records)]
    whole: dict[Table, Sequence[Values]] = {
        FRAME: [
            {"key": key, "matrix": each.matrix, "covariance": each.covariance or None}
            for key, each in log.frames.items()
        ],
        VERDICT: [made.verdict(record) for record in log.judged.values()],
        DEVICE: _numbered(
            {name: getattr(each, name) for name in each.__struct_fields__ if name in DEVICE.c}
            for each in log.assets
        ),
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
        LENGTH: _numbered(made.lengths()),
        GRID: list(made.grid()),
        STREAM: [
            {of.name: getattr(each, of.name) for of in STREAM.columns if of.name != "digest"}
            for each in log.streams.values()
        ],
        DOCUMENT: [msgspec.to_builtins(each) for each in documents],
        POINT: points,
    }
    serials = {each.kind: each.serial for each in log.assets}
    whole[RUN] = [
        {
            "run_key": run_key,
            "revision": revision,
            "head": head,
            "month": month,
            "cell_key": short(msgspec.json.encode((row.cell, row.serial, _machine(row)))),
            "name": row.name,
            "cell": row.cell,
            "serial": row.serial,
            "simulated": row.simulated,
            "machine": _machine(row),
            "procedure": row.procedure,
            "state": row.state,
            "exit": row.exit,
            "begun": _moment(row.begun),
            "ended": _moment(row.ended),
            "points": sum(not each["superseded"] for each in points),
            "proven": _proven(row),
            "robot": serials.get(ROBOT, ""),
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
    return RunRecord(
        run_key,
        revision,
        head,
        row,
        {table: [own | dict(each) for each in rows] for table, rows in whole.items()},
    )


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


@dataclass(frozen=True, eq=False)
class _Rows:
    """The rows of one run."""

    log: Log

    def points(self, records: Sequence[Record]) -> Iterator[Values]:
        """Yield all points in the order of their records.

        One that is superseded does not count: it was measured again, or its tracker had moved.
        """
        counting = {self.log.recorded(point): point for point in self.log.points.values()}
        for record in records:
            if record.kind == "point":
                superseded = record.seq not in counting
                point = self.log.read(record) if superseded else counting[record.seq]
                yield _point(record, point) | {"superseded": superseded}

    def verdict(self, record: Record) -> Values:
        """Return a verdict's row, with the mean error where it judges one."""
        verdict = self.log.verdicts[record.key]
        mean = next((each for each in verdict.figures if each.name == "mean"), Figure("", None))
        return {
            "key": record.key,
            "holds": verdict.holds,
            "body": record.body,
            "mean_mm": mean.value,
            "mean_U_mm": mean.U,
            "mean_tolerance_mm": mean.limit,
        }

    def lengths(self) -> Iterator[Values]:
        checked = self.log.verdict(LengthsChecked)
        for each in () if checked is None else checked.lengths:
            yield msgspec.to_builtins(each) | {"nests": "-".join(each.nests)}

    def grid(self) -> Iterator[Values]:
        """Yield the errors at the vertices of a grid that was measured whole."""
        points = self.log.select("grid")
        if not points or not {"world", "base"} <= self.log.frames.keys():
            return
        errors_mm = measured_grid(self.log).errors_mm.reshape(-1, 3)
        if not np.isfinite(errors_mm).all():
            return
        places_mm = grid_of(self.log.cell).vertices_mm().reshape(-1, 3)
        celsius = [point.temperature_c for point in points if point.temperature_c is not None]
        yield {
            "places_mm": places_mm.tolist(),
            "errors_mm": errors_mm.tolist(),
            "temperature_c": fmean(celsius) if celsius else None,
        }


def _point(record: Record, point: Point) -> dict[str, object]:
    nominal_mm = point.nominal_mm or (None, None, None)
    return {
        "seq": record.seq,
        "t": _moment(record.t),
        "key": point.key,
        "kind": point.group,
        "station": point.station,
        "frame": point.frame,
        "reflector": point.reflector,
        **dict(zip(("x_mm", "y_mm", "z_mm"), point.xyz_mm, strict=True)),
        **dict(zip(("std_x_mm", "std_y_mm", "std_z_mm"), point.std_mm, strict=True)),
        "samples": point.samples,
        "session": point.session,
        "set_up": point.set_up,
        "retaken": point.retaken,
        "temperature_c": point.temperature_c,
        "pressure_mbar": point.pressure_mbar,
        "humidity_percent": point.humidity_percent,
        "strip_mm": point.strip_mm,
        "rail_mm": point.rail_mm,
        **dict(zip(("nominal_x_mm", "nominal_y_mm", "nominal_z_mm"), nominal_mm, strict=True)),
        "commanded_deg": point.commanded_deg,
        "joints_deg": point.joints_deg,
    }


def _moment(t: str) -> datetime:
    """Return a time; raises `ValueError` where no clock of a cell can have said it."""
    found = datetime.fromisoformat(t)
    years = (1980, 2200)  # a PC whose battery is empty begins with the first
    if not years[0] <= found.year < years[1]:
        raise ValueError(f"it says the time {t}, wanted are years of {years[0]} to {years[1]}")
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
