"""The timeline of a run: its steps, every start and stop of an engine, its events."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

from hilcell.journal.journal import Record
from hilcell.journal.labels import event_label, in_zone, point_label, step_label, with_labels
from hilcell.journal.log import Log
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
    SlideVerified,
    StepBegun,
    StreamRecorded,
    TrackerVerified,
    after,
)
from hilcell.model.frame import Frame
from hilcell.model.point import BACK, CONTROL, Point
from hilcell.model.records import Fact, StateChanged
from hilcell.model.verdicts import Verdict
from hilcell.present.table import Column, Table
from hilcell.report.facts import Facts
from hilcell.sanitize import counted


@dataclass(slots=True)
class Line:
    """One line of the timeline: its time, its text, and whether the run stopped there.

    Every session goes through all steps again, past what is measured already: such an ``idle`` step
    is listed only where something was measured, moved at its beginning, or ``computed`` again.
    """

    t: str
    words: str
    stop: bool = False
    points: int = 0  # of the step that begins here
    idle: bool = False
    computed: bool = False

    @property
    def text(self) -> str:
        """Return the line as it is shown; "" of a step that did nothing."""
        if self.idle:
            return f"{self.words} Computed again, nothing measured." if self.computed else ""
        return f"{self.words} {counted(self.points, 'point')}." if self.points else self.words

    def take(self, record: Record, log: Log) -> None:
        """Take a record of the step in progress; ``log`` is without it."""
        match fact := record.fact:
            case Point():  # a control point is no point of the step
                if fact.group != CONTROL or fact.id.kind == BACK:
                    self.idle, self.points = False, self.points + 1
            case StreamRecorded() | CurveMeasured():
                self.idle = False
            case Frame():
                self.computed |= log.frames.get(record.key) != fact
            case Verdict():
                self.computed |= log.verdicts.get(record.key) != fact


@dataclass(frozen=True, eq=False)
class _Timeline:
    facts: Facts

    def lines(self) -> list[Line]:
        """Return each line with its time in the journal; a step says how many points it gave."""
        log, last, known, lines = Log(), "", set[str](), list[Line]()
        step: Line | None = None  # in progress
        # of the next session, and written before it
        carried = {
            each.name for each in self.facts.log.inputs.steps if each.note and not each.points
        }
        before_it_goes_on = (SessionOrdered, ChangesAccepted)
        for record in self.facts.records:
            fact, starts = record.fact, self._starts(record.fact)
            if starts and log.session and not log.over:
                lines.append(Line(last, self._cut_off(log), stop=True))
            lines += [Line(record.t, each, self._stops(fact)) for each in self._words(log, fact)]
            if isinstance(fact, StepBegun):
                step, moves = lines[-1], fact.name == "home"  # at every start
                # a plan may leave it out, a re-calibration carries what it yields
                optional = fact.name.startswith("two-face") or fact.name in carried
                step.idle = optional or (fact.name in known and not moves)
                known.add(fact.name)
            step = None if starts else step
            if record.kind == "point" and record.key in log.retakes:  # whatever step is in progress
                again = point_label(record.key, self.facts.log)
                lines.append(Line(record.t, f"Measured again: {again}."))
            elif step is not None:
                step.take(record, log)
            if not isinstance(fact, before_it_goes_on):
                last = record.t
            log.take(record)
        return [line for line in lines if line.text]

    def _words(self, log: Log, fact: Fact) -> list[str]:
        """Return a record as sentences; the state of the calibration follows from the steps."""
        if self._starts(fact):
            return [self._start(log)]
        # Routine, or in a table of its own: counted, not listed.
        routine = (
            Connected, Closed, TrackerVerified, SlideVerified, StreamRecorded, LinkCounted,
            SessionOrdered,
        )  # fmt: skip
        states = {
            "paused": "Paused", "suspended": "Suspended", "stopping": "Stopping",
            "aborted": "Aborted", "faulted": "Stopped by a fault", "finished": "Run finished",
        }  # fmt: skip
        at_work = ("checking", "running")
        match fact:
            case StateChanged(machine="run", to=to, reason=why):
                reason = after(with_labels(why, self.facts.log))
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
        return f"Goes on in session {log.session + 1}, {len(log.points)} points are stored."

    def _happened(self, event: Event | OtherEvent) -> str:
        """Return an event as a sentence, in the screen's words."""
        match event:
            case StepBegun(name=name):
                words = step_label(name, has_rail=self.facts.cell.has_rail)
            case PosesChosen():
                words = f"poses chosen: {self._chosen_poses(event)}"
            case _:
                words = event_label(event, self.facts.log).replace("urad", "µrad")
        return f"{words[:1].upper()}{words[1:]}."

    @staticmethod
    def _stops(fact: Fact) -> bool:
        stops = ("paused", "suspended", "aborted", "faulted")  # states whose lines are bold
        return isinstance(fact, StateChanged) and fact.machine == "run" and fact.to in stops

    @staticmethod
    def _starts(fact: Fact) -> bool:
        return isinstance(fact, StateChanged) and fact.machine == "run" and fact.to == "checking"

    @staticmethod
    def _cut_off(log: Log) -> str:
        """Return how the session before ended, which did not end by itself."""
        newest = [*log.points][-1:]
        since = f"after {point_label(newest[0], log)}" if newest else "before its first point"
        how = "Engine lost without notice (killed, or power lost)"
        return f"{how} {since}, while the run was {log.state}."

    def _chosen_poses(self, chosen: PosesChosen) -> str:
        plan, count, bounds_mm = self.facts.cell.plan, len(chosen.joints_deg), chosen.bounds_mm
        if not bounds_mm:
            return "none"
        progress = f"{bounds_mm[-1]:.3f} mm"
        if count and not plan.recalibrates:
            progress = f"{bounds_mm[0]:.3f} mm to {progress}"
        if plan.tilt_deg:
            turned = f"targets that turn by {plan.tilt_deg:g}° (plan.tilt_poses)"
            why = f"{count} are measured for {turned}"
        elif bounds_mm[-1] <= plan.bound_mm:
            why = f"{plan.bound_mm:g} mm are reached"
        elif count >= plan.most_poses:
            why = f"{plan.most_poses} are the most (plan.most_poses)"
        else:
            why = f"more would gain little towards {plan.bound_mm:g} mm"
        poses = f"{count} poses: predicted mean 95 % bound in the cube {progress}"
        return f"{poses}; no more, because {why}"


def timeline(facts: Facts) -> Table:
    counts = Counter(r.fact.what for r in facts.records if isinstance(r.fact, Event | OtherEvent))
    slide = f", {counts['slide proven']} of the slide" if facts.cell.has_rail else ""
    note = (
        f"{counted(facts.log.session, 'start')} of an engine. Not listed: "
        f"{counts['tracker proven']} verifications of the tracker{slide}."
    )
    name = facts.zone.tzname(None)  # UTC in brackets where that is another
    columns: tuple[Column[Line], ...] = (
        Column(f"{name} (UTC)" if facts.inputs.utc_offset_min else "UTC", attrgetter("t")),
        Column("event", attrgetter("text")),
    )
    lines = _dated(_Timeline(facts).lines(), facts)
    title = "Timeline of the run"
    return Table(columns, lines, title, note, lambda row: "stop" if row.stop else "")


def _dated(lines: Sequence[Line], facts: Facts) -> Iterator[Line]:
    """Yield lines by the time of day; with the date where it changes."""
    date = None
    for line in lines:
        moment = in_zone(line.t, facts.zone)
        time = f"{moment:%H:%M:%S}" if moment.date() == date else f"{moment:%Y-%m-%d %H:%M:%S}"
        yield replace(line, t=f"{time} ({line.t[11:19]})" if moment.utcoffset() else time)
        date = moment.date()
