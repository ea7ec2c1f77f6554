"""The journal of every run is judged by the product's checker, from its events alone."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from hilcell.invariants import check_invariants as validation_verdicts
from hilcell.journal.journal import Record

HEAD = ("run", "seq", "t", "kind")  # of an event; the rest is the record's body, and its key


def judge(events: Iterable[dict[str, Any]]) -> list[str]:
    """Return the invariants that the events of a journal break, one line each."""
    verdicts = validation_verdicts(map(record_of, events))
    return [
        f"{name} at record {each.seq}: {each.what}"
        for name, verdict in verdicts.items()
        for each in verdict.broken
    ]


def record_of(event: dict[str, Any]) -> Record:
    """Return the record that an event was printed from."""
    body = {name: value for name, value in event.items() if name not in HEAD}
    key = "" if event["kind"] == "event" else body.pop("key", "")  # an event's is in its body
    return Record(event["seq"], event["t"], event["kind"], key, body)
