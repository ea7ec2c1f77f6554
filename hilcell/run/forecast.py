"""How long a run will still take, from its plan and its journal.

Every step has its planned duration in the cell's time. What was done tells the pace: real seconds
to a planned one. Pauses, and the time between the sessions of a resumed run, count for nothing.
The trap: a pace learnt where only the rail moved says little about points, so each kind of step
learns its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any

from hilcell.run.journal import Record

AT_WORK = ("checking", "running", "stopping")
TRUST_S = 60.0  # planned seconds for which a stated speed counts as if it had been observed


@dataclass(slots=True)
class _Step:
    """One step of the plan and what was seen of it."""

    points: int
    planned_s: float
    taken: int = 0
    spent_s: float = 0.0
    since_point_s: float = 0.0
    done: bool = False

    @property
    def share(self) -> float:
        """Return which share of its points was taken, 0 to 1."""
        return min(1.0, self.taken / self.points) if self.points else 0.0


class Forecast:
    """Takes a run's records in their order; keeps no time of its own.

    ``now`` is what the caller's clock says, in UTC; a clock that runs back counts as standing.
    Durations are real seconds: a simulated cell that runs faster takes less of them.
    """

    def __init__(self) -> None:
        self._steps: list[_Step] = []
        self._current: _Step | None = None
        self._number = 0
        self._given: float | None = 1.0  # real to planned seconds, as far as it is known at first
        self._latest: datetime | None = None
        self._worked_s = 0.0
        self._working = False

    def take(self, record: Record) -> None:
        """Add one record."""
        moment = datetime.fromisoformat(record.t)
        body = record.body
        resumed = record.kind == "state" and body.get("to") == "checking"
        if not resumed:  # from a session's last record to the next session nobody worked
            self._pass(moment)
        self._latest = max(moment, self._latest or moment)
        match record.kind:
            case "plan":
                self._take_plan(body)
            case "state" if body["machine"] == "run":
                self._working = body["to"] in AT_WORK
                if body["to"] == "finished":
                    self._finish()
            case "event" if body["what"] == "step":
                self._begin(int(body["number"]))
            case "point" if body["group"] != "control" and self._current is not None:
                self._current.taken += 1
                self._current.since_point_s = 0.0
            case "end":
                self._working = False

    def elapsed_s(self, now: datetime) -> float:
        """Return how long the run has worked."""
        return self._worked_s + self._under_way_s(now)

    def remaining_s(self, now: datetime) -> float | None:
        """Return how long it has still to work, or None while nothing tells."""
        if not self._steps:
            return None
        rests = [self._rest_s(step, now) for step in self._steps if not step.done]
        return None if any(rest is None for rest in rests) else sum(filter(None, rests))

    def total_s(self, now: datetime) -> float | None:
        """Return how long it will have worked in the end, or None while nothing tells."""
        remaining_s = self.remaining_s(now)
        return None if remaining_s is None else self.elapsed_s(now) + remaining_s

    # -- what happened ------------------------------------------------------------------------

    def _take_plan(self, body: dict[str, Any]) -> None:
        self._steps = [_Step(each["points"], each["duration_s"]) for each in body["steps"]]
        if body["simulated"]:
            self._given = 1.0 / body["speed"] if body["speed"] else None
        self._working = True

    def _begin(self, number: int) -> None:
        """Begin a step; what a later one follows is done, what a new session repeats is not."""
        if self._current is not None and number > self._number:
            self._current.done = True
        self._number = number
        self._current = self._steps[number - 1] if number <= len(self._steps) else None

    def _finish(self) -> None:
        for step in self._steps:
            step.done = True

    def _pass(self, moment: datetime) -> None:
        passed_s = self._under_way_s(moment)
        self._worked_s += passed_s
        if self._current is not None and not self._current.done:
            self._current.spent_s += passed_s
            self._current.since_point_s += passed_s

    def _under_way_s(self, now: datetime) -> float:
        if not self._working or self._latest is None:
            return 0.0
        return max(0.0, (now - self._latest).total_seconds())

    # -- what is to come ----------------------------------------------------------------------

    def _rest_s(self, step: _Step, now: datetime) -> float | None:
        """Return the rest of a step: at first by its plan, towards its end by its points."""
        pace = self._pace(step)
        if pace is None:
            return None
        whole_s = step.planned_s * pace
        passed_s = self._under_way_s(now) if step is self._current else 0.0
        by_plan_s = max(0.0, whole_s - step.spent_s - passed_s)
        if not step.points:
            return by_plan_s
        point_s = whole_s / step.points
        since_s = min(point_s, step.since_point_s + passed_s)
        by_points_s = max(0.0, (1.0 - step.share) * whole_s - since_s)
        return (1.0 - step.share) * by_plan_s + step.share * by_points_s

    def _pace(self, wanted: _Step) -> float | None:
        """Return real seconds to a planned one, learnt from steps of the same kind."""
        planned_s, real_s = 0.0, 0.0
        if self._given is not None:
            planned_s, real_s = TRUST_S, TRUST_S * self._given
        for step in self._steps:
            if bool(step.points) == bool(wanted.points):
                # Points of a step need not be alike: only its end says what they took.
                weight = 1.0 if step.done else step.share
                planned_s += weight * step.planned_s * (1.0 if step.done else step.share)
                real_s += weight * step.spent_s
        return real_s / planned_s if planned_s > 0 else None
