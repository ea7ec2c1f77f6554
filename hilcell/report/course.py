"""The course of a run in words: its states, every start of an engine, and events on the way."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from operator import itemgetter
from typing import Any

import msgspec

from hilcell.journal.curve_record import CurveRecord
from hilcell.journal.log import Log
from hilcell.report.columns import Column, Sheet, sheet
from hilcell.report.facts import Facts
from hilcell.report.method import chosen_poses_words
from hilcell.report.wording import facts_of

# Routine, or in a table of its own: counted, not listed.
ROUTINE = ("connected", "closed", "tracker proven", "slide proven", "stream", "link")
Line = tuple[str, str, str]

COURSE: tuple[Column[Line], ...] = (
    Column("UTC", itemgetter(0)),
    Column("what", itemgetter(1)),
    Column("why, how", itemgetter(2)),
)


def course(facts: Facts) -> Sheet | None:
    """Return how the run went."""
    counts = Counter(record.body["what"] for record in facts.records if record.kind == "event")
    note = (
        f"{facts.log.session} start{'s' if facts.log.session != 1 else ''} of an engine. Not "
        f"listed: {counts['tracker proven']} proofs that the tracker stood still, "
        f"{counts['slide proven']} that the slide did."
    )
    return sheet("Course of the run", COURSE, _lines(facts), note)


def _lines(facts: Facts) -> Iterator[Line]:
    log, previous = Log(), ""
    for record in facts.records:
        time = record.t[:19].replace("T", " ")
        if record.kind == "state":
            body = record.body
            if body["machine"] == "run" and body["to"] == "checking":
                yield time, f"engine started, session {log.session + 1}", _before(log, previous)
            else:
                to = body["to"].replace("_", " ")
                yield time, f"{body['machine']}: {to}", str(body.get("reason", ""))
        elif record.kind == "event" and record.body["what"] not in ROUTINE:
            yield time, *_happened(facts, record.body)
        elif record.kind == "point":
            previous = f"{record.key}, {time}"
        log.take(record)


def _before(log: Log, previous: str) -> str:
    """Return how the session before a start ended."""
    if not log.session:
        return ""
    kept = f"{len(log.points)} points are kept"
    if log.over:
        return f"after the run was {log.state}; {kept}"
    after = f" after {previous}" if previous else " before its first point"
    return (
        f"the engine before stopped without notice (killed, or power lost){after}, while the run "
        f"was {log.state}; {kept}"
    )


def _happened(facts: Facts, body: Mapping[str, Any]) -> tuple[str, str]:
    """Return an event in words: what, and why or how."""
    if body["what"] == "curve":
        return "curve", msgspec.convert(body, CurveRecord).words
    if body["what"] == "poses chosen":
        return "poses chosen", chosen_poses_words(facts, body)
    return body["what"], facts_of(body)
