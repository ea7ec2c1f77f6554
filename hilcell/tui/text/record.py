"""A journal's record in one line."""

from __future__ import annotations

from typing import Any

from hilcell.journal.journal import Record
from hilcell.tui.text.columns import Column, Row

COLUMNS = (
    Column("record", 6, right=True),
    Column("UTC", 12),
    Column("kind", 8),
    Column("what", 200),
)
_TONES = {"faulted": "bad", "suspended": "warn", "aborted": "warn"}
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
    tone = _TONES.get(str(body.get("to", "")), "") if record.kind == "state" else ""
    cells = (str(record.seq), record.t[11:23], record.kind, record_words(record))
    return Row(str(record.seq), cells, tone)


def _plan_words(body: dict[str, Any]) -> str:
    seed, machine = body.get("seed"), body.get("machine_seed")
    own = f", machine {machine}" if machine not in (None, seed) else ""
    return f"{body.get('procedure')}, {body.get('points')} points, seed {seed}{own}"


def record_words(record: Record) -> str:
    """Return what a record says, shortly."""
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
