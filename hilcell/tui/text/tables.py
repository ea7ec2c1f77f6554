"""Table of tables: the runs of the history, and the records of the event log."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from operator import attrgetter
from typing import Any, NamedTuple

from hilcell.journal.index import RunRow
from hilcell.journal.journal import Record
from hilcell.journal.times import in_zone
from hilcell.model.events import CurveMeasured
from hilcell.present.table import Column as Fact
from hilcell.tui.widgets import Column, Row
from hilcell.typed import typed

_ALWAYS = 63  # columns of date with time, procedure, verdict and operator, and of the edges


class _Shown(NamedTuple):
    """One column of the history: its width, and its rank where there is little room."""

    width: int
    fact: Fact[RunRow]
    rank: int = 0  # 0: always there; the highest goes first

    @property
    def column(self) -> Column:
        return Column(self.fact.header, self.width, right=bool(self.fact.form))


def _outcome(run: RunRow) -> str:
    """Return the verdict of a run that has ended, the state of every other."""
    if run.live:
        return "LIVE " + run.state
    return run.verdict.partition(";")[0] or ("engine gone" if run.gone else run.condition)


def _local(run: RunRow) -> str:
    with suppress(ValueError):  # "", or what a journal of anybody's has in its place
        return f"{in_zone(run.begun):%H:%M %Z}"
    return ""


_SHOWN: tuple[_Shown, ...] = (
    _Shown(13, Fact("procedure", lambda run: run.procedure or run.name[-13:])),
    _Shown(16, Fact("verdict or state", _outcome)),
    _Shown(10, Fact("operator", attrgetter("operator"))),
    _Shown(
        4, Fact("kind", lambda run: ("SIM" if run.simulated else "real") if run.readable else ""), 1
    ),
    _Shown(10, Fact("cell", attrgetter("cell")), 2),
    _Shown(6, Fact("points", lambda run: run.points or None, form="d"), 6),
    _Shown(6, Fact("before", attrgetter("before_mean_mm"), form=".3f"), 4),
    _Shown(6, Fact("after", attrgetter("chosen_mean_mm"), form=".3f"), 3),
    _Shown(6, Fact("max", attrgetter("chosen_max_mm"), "mm", ".3f"), 8),
    _Shown(10, Fact("local time", _local), 5),
    _Shown(12, Fact("job", attrgetter("job")), 7),
    _Shown(36, Fact("run", attrgetter("name")), 9),
)


def _shown_in(width: int) -> list[_Shown]:
    """Return the columns that fit, in their order."""
    free = width - _ALWAYS
    left_out = False
    kept = {0}
    for each in sorted(_SHOWN, key=attrgetter("rank")):
        if each.rank and not left_out:
            free -= each.width + 1
            left_out = free < 0
            kept |= set() if left_out else {each.rank}
    return [each for each in _SHOWN if each.rank in kept]


def columns_for(width: int) -> tuple[Column, ...]:
    """Return the columns that fit; mean |e| before and after in mm."""
    begun = Column("begun UTC", 16) if width >= _ALWAYS else Column("begun", 10)
    return Column("", 1), begun, *(each.column for each in _shown_in(width))


def history_row(run: RunRow, marked: Collection[str], width: int) -> Row:
    """Return the cells of one run; ``marked`` are those to be compared."""
    tones = {"finished": "", "aborted": "label", "faulted": "fault"}
    tone = "live" if run.live else "fault" if run.exit in (1, 3) else tones.get(run.state, "ask")
    begun = run.begun.replace("T", " ")[: columns_for(width)[1].width]
    texts = (each.fact.text(each.fact.of(run)) for each in _shown_in(width))
    return Row(run.name, ("*" if run.name in marked else "", begun, *texts), tone)


def log_columns(t: str) -> tuple[Column, ...]:
    """Return the columns of the event log; ``t``, a time in it, says whether local time is UTC."""
    moment = in_zone(t)
    time = Column(f"{moment:%Z} (UTC)", 19) if moment.utcoffset() else Column("UTC", 12)
    what = Column("what", 20, grows=True)
    return Column("record", 6, right=True), time, Column("kind", 8), what


_LEFT_OUT = {  # long, or said already
    "matrix", "pose", "xyz_mm", "covariance", "trace", "result", "cell", "joints_deg", "error",
    "errors", "what", "action",
}  # fmt: skip


def record_row(record: Record) -> Row:
    """Return one row of the event log."""
    body = record.body
    tones = {"faulted": "fault", "suspended": "ask", "aborted": "ask"}
    tone = tones.get(str(body.get("to", "")), "") if record.kind == "state" else ""
    moment = in_zone(record.t)
    time = f"{moment:%H:%M:%S} ({record.t[11:19]})" if moment.utcoffset() else record.t[11:23]
    cells = (str(record.seq), time, record.kind, record_words(record))
    return Row(str(record.seq), cells, tone)


def record_words(record: Record) -> str:
    """Return a record as one short line."""
    body = record.body
    match record.kind:
        case "plan":
            seed, machine = body.get("seed"), body.get("machine_seed")
            own = f", machine {machine}" if machine not in (None, seed) else ""
            return f"{body.get('procedure')}, {body.get('points')} points, seed {seed}{own}"
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
            return f"curve of {typed(body, CurveMeasured).words}"
        case "event":
            return f"{body.get('what')} {_facts(body)}".strip()
        case "end":
            return f"{body.get('state')}, exit {body.get('exit')}"
    return f"{record.key} {_facts(body)}".strip()


def _facts(body: dict[str, Any]) -> str:
    shown = ((k, v) for k, v in body.items() if k not in _LEFT_OUT and v not in ({}, []))
    return ", ".join(f"{name} {_value(value)}" for name, value in shown)


def _value(value: object) -> str:
    """Return a value without the punctuation of a data structure."""
    if isinstance(value, float):
        return f"{value:.3f}"
    if isinstance(value, dict):
        return " ".join(f"{name} {_value(each)}" for name, each in value.items())
    if isinstance(value, list):
        return "; ".join(_value(each) for each in value)
    return str(value)
