"""Table of tables: the runs of the history, and the records of the event log."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import msgspec

from hilcell.journal.curve_record import CurveRecord
from hilcell.journal.index import RunRow
from hilcell.journal.journal import Record
from hilcell.tui.widgets import Column, Row

PROCEDURE = 13
NARROW = (
    Column("", 1),
    Column("begun UTC", 16),
    Column("procedure", PROCEDURE),
    Column("state", 16),
    Column("points", 6, right=True),
    Column("before", 6, right=True),
    Column("after", 6, right=True),
    Column("job", 6),
)
WIDE = (
    *NARROW[:-1],
    Column("max mm", 6, right=True),
    Column("job", 12),
    Column("operator", 12),
    Column("cell", 12),
    Column("kind", 9),
    Column("run", 36),
)
WIDE_FROM = 130
_RUN_TONES = {"finished": "", "aborted": "label", "faulted": "fault"}


def columns_for(width: int) -> tuple[Column, ...]:
    """Return the columns that fit; mean |e| before and after in mm."""
    return WIDE if width >= WIDE_FROM else NARROW


def history_row(run: RunRow, marked: Collection[str], width: int) -> Row:
    """Return the cells of one run; ``marked`` are those to be compared."""
    state = "LIVE " + run.state if run.live else "engine gone" if run.gone else run.condition
    if run.finished and not run.live:
        state = run.verdict.partition(";")[0]
    mark = "*" if run.name in marked else ""
    begun = run.begun[:16].replace("T", " ")
    tone = (
        "live" if run.live else "fault" if run.exit in (1, 3) else _RUN_TONES.get(run.state, "ask")
    )
    head = (
        mark,
        begun,
        run.procedure or run.name[-PROCEDURE:],
        state,
        str(run.points or ""),
        _mm(run.before_mean_mm),
        _mm(run.chosen_mean_mm),
    )
    if width < WIDE_FROM:
        return Row(run.name, (*head, run.job), tone)
    kind = "simulated" if run.simulated else "real"
    tail = (_mm(run.chosen_max_mm), run.job, run.operator, run.cell, kind, run.name)
    return Row(run.name, head + tail, tone)


def _mm(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"


COLUMNS = (
    Column("record", 6, right=True),
    Column("UTC", 12),
    Column("kind", 8),
    Column("what", 200),
)
_RECORD_TONES = {"faulted": "fault", "suspended": "ask", "aborted": "ask"}
_LONG = (
    "matrix",
    "pose",
    "xyz_mm",
    "covariance",
    "trace",
    "result",
    "cell",
    "joints_deg",
    "error",
    "errors",
)


def record_row(record: Record) -> Row:
    """Return one row of the event log."""
    body = record.body
    tone = _RECORD_TONES.get(str(body.get("to", "")), "") if record.kind == "state" else ""
    cells = (str(record.seq), record.t[11:23], record.kind, record_words(record))
    return Row(str(record.seq), cells, tone)


def _plan_words(body: dict[str, Any]) -> str:
    seed, machine = body.get("seed"), body.get("machine_seed")
    own = f", machine {machine}" if machine not in (None, seed) else ""
    return f"{body.get('procedure')}, {body.get('points')} points, seed {seed}{own}"


def record_words(record: Record) -> str:
    """Return a record as one short line."""
    body = record.body
    match record.kind:
        case "plan":
            return _plan_words(body)
        case "state":
            reason = f": {body['reason']}" if body.get("reason") else ""
            return f"{body.get('machine')} is {body.get('to')}{reason}".replace("\n", " ")
        case "point":
            station = f" at {body['station']}" if body.get("station") else ""
            again = ", re-measured" if body.get("retaken") else ""
            return f"{record.key}{station}{again}"
        case "intent":
            return " ".join(filter(None, (str(body.get("action", "")), record.key, _facts(body))))
        case "event" if body.get("what") == "curve":
            return f"curve of {msgspec.convert(body, CurveRecord).words}"
        case "event":
            return f"{body.get('what')} {_facts(body)}".strip()
        case "end":
            return f"{body.get('state')}, exit {body.get('exit')}"
    return f"{record.key} {_facts(body)}".strip()


def _facts(body: dict[str, Any]) -> str:
    shown = {
        k: v for k, v in body.items() if k not in (*_LONG, "what", "action") and v not in ({}, [])
    }
    return ", ".join(f"{name} {_value(value)}" for name, value in shown.items())


def _value(value: object) -> str:
    """Return a value without the punctuation of a data structure."""
    if isinstance(value, float):
        return f"{value:.3f}"
    if isinstance(value, dict):
        return " ".join(f"{name} {_value(each)}" for name, each in value.items())
    if isinstance(value, list):
        return "; ".join(_value(each) for each in value)
    return str(value)
