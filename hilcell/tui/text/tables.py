"""Table of tables: the runs of the history, and the records of the event log."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from itertools import accumulate
from operator import attrgetter
from typing import NamedTuple

from hilcell.journal.index import RunRow
from hilcell.journal.journal import Record
from hilcell.journal.labels import in_zone
from hilcell.model.events import Closing, Connected, Event, LinkCounted, OtherEvent, after
from hilcell.model.frame import Frame
from hilcell.model.plan import PlanRecord
from hilcell.model.point import Point
from hilcell.model.records import Ended, Fact, Intended, StateChanged
from hilcell.model.verdicts import Verdict
from hilcell.present.table import Column as Shown
from hilcell.tui.widgets import Column, Row

_ALWAYS = 63  # columns of date with time, procedure, verdict and operator, and of the edges


class _Column(NamedTuple):
    """One column of the history: its width, and its rank where there is little room."""

    width: int
    shown: Shown[RunRow]
    rank: int = 0  # 0: always there; the highest goes first


def _outcome(run: RunRow) -> str:
    """Return the verdict of a run that has ended, the state of every other."""
    if run.live:
        return "LIVE " + run.state
    return run.verdict.partition(";")[0] or ("engine gone" if run.gone else run.condition)


def _local(run: RunRow) -> str:
    with suppress(ValueError):  # "", or what a journal of anybody's has in its place
        return f"{in_zone(run.begun):%H:%M %Z}"
    return ""


def _kind(run: RunRow) -> str:
    return ("SIM" if run.simulated else "real") if run.readable else ""


_COLUMNS = (
    _Column(13, Shown("procedure", lambda run: run.procedure or run.name[-13:])),
    _Column(16, Shown("verdict or state", _outcome)),
    _Column(10, Shown("operator", attrgetter("operator"))),
    _Column(4, Shown("kind", _kind), 1),
    _Column(10, Shown("cell", attrgetter("cell")), 2),
    _Column(6, Shown("points", lambda run: run.points or None, form="d"), 6),
    _Column(6, Shown("before", attrgetter("before_mean_mm"), form=".3f"), 4),
    _Column(6, Shown("after", attrgetter("chosen_mean_mm"), form=".3f"), 3),
    _Column(6, Shown("max", attrgetter("chosen_max_mm"), "mm", ".3f"), 8),
    _Column(10, Shown("local time", _local), 5),
    _Column(12, Shown("job", attrgetter("job")), 7),
    _Column(36, Shown("run", attrgetter("name")), 9),
)


def _columns_in(width: int) -> list[_Column]:
    ranked = sorted((each for each in _COLUMNS if each.rank), key=attrgetter("rank"))
    taken = accumulate(each.width + 1 for each in ranked)
    kept = ranked[: sum(columns <= width - _ALWAYS for columns in taken)]
    return [each for each in _COLUMNS if not each.rank or each in kept]


def columns_for(width: int) -> tuple[Column, ...]:
    """Return the columns that fit; mean |e| before and after in mm."""
    begun = Column("begun UTC", 16) if width >= _ALWAYS else Column("begun", 10)
    found = (
        Column(shown.header, each, right=bool(shown.form)) for each, shown, _ in _columns_in(width)
    )
    return Column("", 1), begun, *found


def history_row(run: RunRow, marked: Collection[str], width: int) -> Row:
    """Return the cells of one run; ``marked`` are those to be compared."""
    tones = {"finished": "", "aborted": "label", "faulted": "fault"}
    tone = "live" if run.live else "fault" if run.exit in (1, 3) else tones.get(run.state, "ask")
    begun = run.begun.replace("T", " ")[: columns_for(width)[1].width]
    texts = (each.shown.text(each.shown.of(run)) for each in _columns_in(width))
    return Row(run.name, ("*" if run.name in marked else "", begun, *texts), tone)


def log_columns(t: str) -> tuple[Column, ...]:
    """Return the columns of the event log; ``t``, a time in it, says whether local time is UTC."""
    moment = in_zone(t)
    time = Column(f"{moment:%Z} (UTC)", 19) if moment.utcoffset() else Column("UTC", 12)
    what = Column("what", 20, grows=True)
    return Column("record", 6, right=True), time, Column("kind", 8), what


def record_row(record: Record) -> Row:
    """Return one row of the event log, of a record that a log has taken."""
    tones = {"faulted": "fault", "suspended": "ask", "aborted": "ask"}
    fact = record.fact
    tone = tones.get(fact.to, "") if isinstance(fact, StateChanged) else ""
    moment = in_zone(record.t)
    time = f"{moment:%H:%M:%S} ({record.t[11:19]})" if moment.utcoffset() else record.t[11:23]
    what = record_words(record.key, fact).replace("\n", " ")
    return Row(str(record.seq), (str(record.seq), time, record.kind, what), tone)


def record_words(key: str, fact: Fact) -> str:
    """Return the content of a record in words, points by their keys."""
    match fact:
        case PlanRecord(seed=seed, machine_seed=machine):
            own = f", machine {machine}" if machine not in (None, seed) else ""
            return f"{fact.procedure}, {fact.points} points, seed {seed}{own}"
        case StateChanged():
            return f"{fact.machine} is {fact.to}{after(fact.reason)}"
        case Point():
            station = f" at {fact.station}" if fact.station else ""
            again = ", re-measured" if fact.retaken else ""
            return f"{key}{station}{again}"
        case Intended(position_mm=position_mm):
            place = "" if position_mm is None else f"to {position_mm:.3f} mm"
            axis = f"axis {fact.axis}" if fact.axis else ""
            return " ".join(filter(None, (fact.action, key, fact.station, axis, place)))
        case Frame():
            by = f"by {len(fact.points)} points" if fact.points else ""
            taken_over = f"of calibration {fact.calibration}" if fact.calibration else ""
            return " ".join(filter(None, (key, by, taken_over)))
        case Verdict():
            return f"{key} {fact.outcome.words}{after(fact.words)}"
        case Ended():
            return f"{fact.state}, exit {fact.exit}"
        case _:
            return _event_words(fact)


def _event_words(event: Event | OtherEvent) -> str:
    """Return an event's own words, and such facts of it as they leave out."""
    match event:
        case Connected(devices=devices):
            return event.text + after("; ".join(each.text for each in devices))
        case Closing(problems=problems):
            return event.text + after("; ".join(problems.values()))
        case LinkCounted():
            return f"rail's wire: {event.counts}"
        case OtherEvent():
            facts = ", ".join(f"{name} {value}" for name, value in event.fields.items())
            return f"{event.what} {facts}".strip()
    return event.text or event.what
