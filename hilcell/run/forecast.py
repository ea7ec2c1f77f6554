"""The remaining duration of a run, from its plan and its journal.

The plan states durations in the cell's time, and a simulated cell's speed is known. Additional time
of controllers and computing is learnt from the intervals between points, separately for each kind
of measurement. Pauses and the time between sessions do not count, nor does the motion to the first
point of a kind, which differs from those between points.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from datetime import datetime
from typing import NamedTuple

from hilcell.decoding import typed
from hilcell.journal.journal import Record
from hilcell.model.events import StepBegun, StreamRecorded
from hilcell.model.plan import PlannedStep, PlanRecord, Span
from hilcell.model.point import CONTROL, Point
from hilcell.model.records import WORKING, Ended, RunState, StateChanged

FLANGE, READINGS = "flange", " readings"  # kinds of spans: flange points, nests


@dataclass(frozen=True, slots=True)
class RemainingSpan:
    """The rest of one span of a step: its measurements, or a motion, and its time."""

    step: int  # its number, from 1
    kind: str
    measured: int
    takes_s: float


class SpanProgress(NamedTuple):
    """Measurements of the current span: taken, planned, and whether they are of nests."""

    taken: int
    planned: int
    of_nests: bool


class _StepProgress:
    """One step of the plan and how far it got."""

    def __init__(self, plan: PlannedStep) -> None:
        self.spans = plan.spans or (Span(plan.name, plan.points, plan.duration_s),)
        self.counts_control = bool(plan.spans)
        self.at = 0  # the current span
        self.taken = [0] * len(self.spans)  # measurements of each
        self.since_s = 0.0  # working time since the last measurement or the step's begin
        self.alike = False  # whether the next interval is representative
        self.done = False

    def measure(self, *, again: bool, unlike: str = "") -> tuple[Span, float] | None:
        """Count one measurement; return its span and interval where that is representative.

        ``unlike`` is the suffix of kinds to which it cannot belong. A tracker verification within
        many points counts for one that is planned after them and does not end their span.
        """
        interval_s, self.since_s = self.since_s, 0.0
        alike, self.alike = self.alike and not again, True
        found = None if again else self._open_span(unlike)
        if found is None:
            return None
        self.taken[found] += 1
        alike = alike and found == self.at
        if unlike != FLANGE:
            self.at = found
        while self.at < found and self._full(self.at):
            self.at += 1
        self.alike = found == self.at
        return (self.spans[found], interval_s) if alike else None

    def _full(self, number: int) -> bool:
        return self.taken[number] >= self.spans[number].measured

    def _open_span(self, unlike: str) -> int | None:
        """Return the number of the first span that is not full, or None."""
        for number in range(self.at, len(self.spans)):
            kind = self.spans[number].kind
            if not self._full(number) and not (unlike and kind.endswith(unlike)):
                return number
        return None

    def left(self) -> list[tuple[Span, int]]:
        ahead = [*zip(self.spans, self.taken, strict=True)][self.at :]
        return [(span, span.measured - taken) for span, taken in ahead]


class _Pace:
    """Converts planned to real seconds: the cell's speed, and extra time as measured."""

    def __init__(self, share: float) -> None:
        self.share = share  # real per planned seconds; 0 without a speed limit
        self._counts: defaultdict[str, int] = defaultdict(int)
        self._extra_s: defaultdict[str, float] = defaultdict(float)
        self._all_planned_s = self._all_extra_s = 0.0

    @property
    def known(self) -> bool:
        return self.share > 0 or self._all_planned_s > 0

    def learn(self, span: Span, real_s: float) -> None:
        extra_s = real_s - self.share * span.each_s
        self._counts[span.kind] += 1
        self._extra_s[span.kind] += extra_s
        self._all_planned_s += span.each_s
        self._all_extra_s += extra_s

    def each_s(self, span: Span) -> float:
        """Return the real seconds of one measurement or motion of a span."""
        count = self._counts.get(span.kind, 0) if span.measured else 0
        if count:
            extra_s = self._extra_s[span.kind] / count
        elif self._all_planned_s > 0:
            extra_s = self._all_extra_s / self._all_planned_s * span.each_s
        else:
            extra_s = 0.0
        return max(0.0, self.share * span.each_s + extra_s)


class Forecast:
    """Takes a run's records in sequence. ``now`` is the caller's time, UTC; durations are real
    seconds.
    """

    CLOSING_S = 0.35  # real seconds: the devices are released, the result is computed

    def __init__(self) -> None:
        self._steps: list[_StepProgress] = []
        self._number = 0  # of the current step
        self._pace = _Pace(1.0)
        self._latest: datetime | None = None
        self._worked_s = 0.0
        self._working = False

    def take(self, record: Record) -> None:
        fact, moment = record.fact, datetime.fromisoformat(record.t)
        begins = isinstance(fact, StateChanged) and fact.to == "checking"
        if not begins and record.kind != "end":  # a session may end without having begun
            passed_s = self._since_latest_s(moment)
            self._worked_s += passed_s
            if (step := self._step) is not None:
                step.since_s += passed_s
        self._latest = moment
        match fact:
            case PlanRecord() as plan:
                self._steps = [_StepProgress(step) for step in plan.steps]
                if plan.simulated:
                    self._pace = _Pace(1.0 / plan.speed if plan.speed else 0.0)
            case StateChanged(machine="run", to=to):
                self._enter(typed(to, RunState))
            case StepBegun(number=number):
                self._begin(number)
            case StreamRecorded():
                self._measure("sweep", again=False)
            case Point(group=group, retaken=again, commanded_deg=joints):
                self._measure(group, again=again, joints=joints is not None)
            case Ended():
                self._working = False

    def elapsed_s(self, now: datetime) -> float:
        return self._worked_s + self._since_latest_s(now)

    def remaining_s(self, now: datetime) -> float | None:
        """Return the remaining working time, or None while it is unknown."""
        if not self._steps or not self._pace.known:
            return None
        ahead = [step for step in self._steps if not step.done]
        here, passed_s = self._step, self._since_latest_s(now)
        rests_s = [self._rest_s(step, passed_s if step is here else 0.0) for step in ahead]
        return sum(rests_s) + (self.CLOSING_S if ahead else 0.0)

    def ahead(self, now: datetime) -> list[RemainingSpan]:
        """Return the remaining spans in real seconds; none while that is unknown."""
        if not self._steps or not self._pace.known:
            return []
        passed_s = self._since_latest_s(now)
        found = []
        for number, step in enumerate(self._steps, start=1):
            if step.done or number < self._number:
                continue
            gone_s = step.since_s + (passed_s if step is self._step else 0.0)
            for span, count in step.left():
                takes_s = self._pace.each_s(span) * (count if span.measured else 1)
                found.append(RemainingSpan(number, span.kind, count, max(takes_s - gone_s, 0.0)))
                gone_s = max(gone_s - takes_s, 0.0)
        return found

    @property
    def span(self) -> SpanProgress | None:
        """Return the progress of the current span; None where nothing in it is measured."""
        step = self._step
        if step is None or not step.counts_control:
            return None
        found = step.spans[step.at]
        of_nests = found.kind.endswith(READINGS)
        return (
            SpanProgress(step.taken[step.at], found.measured, of_nests) if found.measured else None
        )

    # -- the records ------------------------------------------------------------------------

    @property
    def _step(self) -> _StepProgress | None:
        return self._steps[self._number - 1] if 0 < self._number <= len(self._steps) else None

    def _enter(self, state: RunState) -> None:
        self._working = state in WORKING
        if not self._working and (step := self._step) is not None:
            step.alike = False  # the current measurement may end during the pause
        if state == "finished":
            for step in self._steps:
                step.done = True

    def _begin(self, number: int) -> None:
        """Begin a step; the one before is done. A new session begins with the first."""
        before = self._step
        if before is not None and number > self._number:
            before.done = True
        self._number = number
        if (step := self._step) is not None:
            step.since_s, step.alike = 0.0, False

    def _measure(self, group: str, *, again: bool, joints: bool = False) -> None:
        """Count a measurement; ``joints``: the robot moved to it."""
        step = self._step
        if step is None or step.done or (group == CONTROL and not step.counts_control):
            return
        unlike = READINGS if joints else FLANGE if group == CONTROL else ""
        if (learnt := step.measure(again=again, unlike=unlike)) is not None:
            self._pace.learn(*learnt)

    def _since_latest_s(self, now: datetime) -> float:
        if not self._working or self._latest is None:
            return 0.0
        return max(0.0, (now - self._latest).total_seconds())

    # -- the rest ----------------------------------------------------------------------

    def _rest_s(self, step: _StepProgress, passed_s: float) -> float:
        """Return the rest of a step less the time since its last measurement."""
        left_s, next_s, leading = 0.0, 0.0, True
        for span, count in step.left():
            each_s = self._pace.each_s(span)
            left_s += each_s * (count if span.measured else 1)
            if leading and (count or not span.measured):
                next_s += each_s
                leading = not count
        return left_s - min(step.since_s + passed_s, next_s)
