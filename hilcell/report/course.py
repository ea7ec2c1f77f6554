"""The course of a run in words: its steps, every start and stop of an engine, events on the way."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple

from hilcell.clean import counted
from hilcell.journal.journal import Record
from hilcell.journal.log import Log
from hilcell.journal.words import happened_words, in_words, in_zone, key_words, step_words
from hilcell.model.events import (
    ChangesAccepted,
    Closed,
    Connected,
    CurveMeasured,
    Event,
    LinkCounted,
    OtherEvent,
    PosesChosen,
    SessionOrdered,
    SlideProven,
    StepBegun,
    StreamRecorded,
    TrackerProven,
    after,
)
from hilcell.model.frame import Frame
from hilcell.model.point import BACK, CONTROL, Point
from hilcell.model.records import Fact, StateChanged
from hilcell.model.verdicts import Verdict
from hilcell.present.table import Column, Table
from hilcell.report.facts import Facts


class Line(NamedTuple):
    """One line of the course: its time, its words, and whether the run stopped there."""

    t: str
    words: str
    stop: bool = False


@dataclass(frozen=True, eq=False)
class _Course:
    facts: Facts

    def lines(self) -> Iterator[Line]:
        """Yield each line with its time in the journal; a step says how many points it gave."""
        log, last, steps, found = Log(), "", _Steps(), list[Line]()
        # of the next session, and written before it
        before_it_goes_on = (SessionOrdered, ChangesAccepted)
        for record in self.facts.records:
            starts = self._starts(record.fact)
            if starts and log.session and not log.over:
                found.append(Line(last, self._cut_off(log), stop=True))
            for words in self._words(log, record.fact):
                found.append(Line(record.t, words, self._stops(record)))
                if isinstance(record.fact, StepBegun):
                    steps.begin(len(found) - 1, record.fact.name)
            if starts:
                steps.leave()
            if record.kind == "point" and record.key in log.retakes:  # whatever step is under way
                again = key_words(record.key, self.facts.log)
                found.append(Line(record.t, f"Measured again: {again}."))
            else:
                steps.take(record, log)
            if not isinstance(record.fact, before_it_goes_on):
                last = record.t
            log.take(record)
        shown = (line._replace(words=steps.words(n, line.words)) for n, line in enumerate(found))
        yield from (line for line in shown if line.words)

    def _words(self, log: Log, fact: Fact) -> list[str]:
        """Return a record as sentences; the state of the calibration follows from the steps."""
        if self._starts(fact):
            return [self._start(log)]
        # Routine, or in a table of its own: counted, not listed.
        routine = (
            Connected, Closed, TrackerProven, SlideProven, StreamRecorded, LinkCounted,
            SessionOrdered,
        )  # fmt: skip
        states = {
            "paused": "Paused", "suspended": "Suspended", "stopping": "Stopping",
            "aborted": "Aborted", "faulted": "Stopped by a fault", "finished": "Run finished",
        }  # fmt: skip
        at_work = ("checking", "running")
        match fact:
            case StateChanged(machine="run", to=to, reason=why):
                reason = after(in_words(why, self.facts.log))
                if to in states:
                    return [f"{states[to]}{reason}."]
                return [f"Goes on{reason}."] if log.state not in ("idle", *at_work) else []
            case Event() | OtherEvent() as event if not isinstance(event, routine):
                return [self._happened(event)]
        return []

    def _start(self, log: Log) -> str:
        operator = self.facts.inputs.operator or "The operator"
        how = "unattended" if self.facts.inputs.unattended else "attended"
        if not log.session:
            job = f", job {self.facts.inputs.job}" if self.facts.inputs.job else ""
            return f"{operator} starts the run{job}, {how}: session 1."
        return f"Goes on in session {log.session + 1}, {len(log.points)} points are kept."

    def _happened(self, event: Event | OtherEvent) -> str:
        """Return an event as a sentence, in the screen's words."""
        match event:
            case StepBegun(name=name):
                words = step_words(name, has_rail=self.facts.cell.has_rail)
            case PosesChosen():
                words = f"poses chosen: {self._chosen_poses_words(self.facts, event)}"
            case _:
                words = happened_words(event, self.facts.log).replace("urad", "µrad")
        return f"{words[:1].upper()}{words[1:]}."

    @staticmethod
    def _stops(record: Record) -> bool:
        change = record.fact
        stops = ("paused", "suspended", "aborted", "faulted")  # states whose lines are bold
        return isinstance(change, StateChanged) and change.machine == "run" and change.to in stops

    @staticmethod
    def _starts(fact: Fact) -> bool:
        return isinstance(fact, StateChanged) and fact.machine == "run" and fact.to == "checking"

    @staticmethod
    def _cut_off(log: Log) -> str:
        """Return how the session before ended, which did not end by itself."""
        newest = [*log.points][-1:]
        since = f"after {key_words(newest[0], log)}" if newest else "before its first point"
        how = "Engine gone without notice (killed, or power lost)"
        return f"{how} {since}, while the run was {log.state}."

    @staticmethod
    def _chosen_poses_words(facts: Facts, chosen: PosesChosen) -> str:
        """Return how many poses were chosen beside the grid, and why no more."""
        plan, count, bounds_mm = facts.cell.plan, len(chosen.joints_deg), chosen.bounds_mm
        if not bounds_mm:
            return "none"
        course = f"{bounds_mm[0]:.3f} mm"
        if count:
            course += f" to {bounds_mm[-1]:.3f} mm"
        if plan.tilt_deg:
            turned = f"targets that turn by {plan.tilt_deg:g}° (plan.tilt_poses)"
            why = f"{count} are measured for {turned}"
        elif bounds_mm[-1] <= plan.bound_mm:
            why = f"{plan.bound_mm:g} mm are reached"
        elif count >= plan.most_poses:
            why = f"{plan.most_poses} are the most (plan.most_poses)"
        else:
            why = f"more would gain little towards {plan.bound_mm:g} mm"
        return (
            f"{count} poses: predicted mean 95 % bound in the cube {course}; no more, because {why}"
        )


def course(facts: Facts) -> Table:
    counts = Counter(r.fact.what for r in facts.records if isinstance(r.fact, Event | OtherEvent))
    slide = f", {counts['slide proven']} that the slide did" if facts.cell.has_rail else ""
    note = (
        f"{counted(facts.log.session, 'start')} of an engine. Not listed: "
        f"{counts['tracker proven']} proofs that the tracker stood still{slide}."
    )
    name = facts.zone.tzname(None)  # UTC in brackets where that is another
    columns: tuple[Column[Line], ...] = (
        Column(f"{name} (UTC)" if facts.inputs.utc_offset_min else "UTC", attrgetter("t")),
        Column("course in words", attrgetter("words")),
    )
    lines = _dated(_Course(facts).lines(), facts)
    return Table(columns, lines, "Course of the run", note, lambda row: "stop" if row.stop else "")


def _dated(lines: Iterator[Line], facts: Facts) -> Iterator[Line]:
    """Yield lines by the time of day; the date stands where it changes."""
    date = None
    for t, words, stop in lines:
        moment = in_zone(t, facts.zone)
        time = f"{moment:%H:%M:%S}" if moment.date() == date else f"{moment:%Y-%m-%d %H:%M:%S}"
        yield Line(f"{time} ({t[11:19]})" if moment.utcoffset() else time, words, stop)
        date = moment.date()


class _Steps:
    """The lines of steps in the course, by their numbers, with the count of points of each.

    Every session goes through all steps again, past what is measured already: there a step is
    listed only where something was measured, moved at its beginning, or computed again.
    """

    def __init__(self) -> None:
        self._now = -1  # the line of the step under way
        self._known = set[str]()
        self._counts: Counter[int] = Counter()  # of points
        self._idle, self._computed = set[int](), set[int]()

    def begin(self, line: int, name: str) -> None:
        self._now = line
        moving = {"home"}  # at every start
        optional = {"two-face", "two-face-closing"}  # a plan may leave them out
        if name in self._known - moving | optional:
            self._idle.add(line)
        self._known.add(name)

    def leave(self) -> None:
        self._now = -1

    def take(self, record: Record, log: Log) -> None:
        """Take a record of the step under way; ``log`` is without it."""
        if self._is_measured(record):
            self._idle.discard(self._now)
            self._counts[self._now] += record.kind == "point"
        elif self._is_computed(record, log):
            self._computed.add(self._now)

    def words(self, line: int, text: str) -> str:
        """Return the words of a line; "" of a step that did nothing."""
        if line not in self._idle:
            count = self._counts[line]
            return f"{text} {counted(count, 'point')}." if count else text
        return f"{text} Computed again, nothing measured." if line in self._computed else ""

    @staticmethod
    def _is_measured(record: Record) -> bool:
        """Whether a record is of a reading that is no proof of nests."""
        fact = record.fact
        if isinstance(fact, Point):
            return fact.group != CONTROL or fact.id.kind == BACK
        return isinstance(fact, StreamRecorded | CurveMeasured)

    @staticmethod
    def _is_computed(record: Record, log: Log) -> bool:
        """Whether a record is of a frame or a verdict that was not known as it is now."""
        match record.fact:
            case Frame() as frame:
                return log.frames.get(record.key) != frame
            case Verdict() as verdict:
                return log.verdicts.get(record.key) != verdict
        return False
