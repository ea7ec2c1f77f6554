"""Rules of a run's life: I6, I7, I8, I9, I10, I12, I13, I17 at its states and its end."""

from __future__ import annotations

from collections import Counter
from typing import Any

import msgspec

from hilcell.alarms.acknowledged import Acknowledged
from hilcell.invariants.bodies import Ended, Life
from hilcell.invariants.scene import Scene
from hilcell.invariants.tally import Tally
from hilcell.journal.journal import Record
from hilcell.journal.states import OVER, WAITING

TEARDOWN_S = 15.0
HELD_DEVICES = ("Rail", "Robot")
GOES_ON = {  # by what a waiting run may: a good look is an unattended one's, after a failed reading
    "paused": ("command",),
    "suspended": ("command", "answer", "look"),
}


class LifeRules:
    """Judges states, teardowns and ends."""

    def __init__(self, tally: Tally, scene: Scene) -> None:
        self._tally, self._scene = tally, scene
        self._check = tally.check
        self._seq = 0
        self._state = "idle"
        self._closings: list[dict[str, Any]] = []  # of this session
        self._reason = ""  # the first of this session's fault
        self._failed: set[str] = set()  # the keys of verdicts that do not hold now

    def take(self, record: Record) -> None:
        """Judge a record."""
        gap = f"record {self._seq} came before"
        self._check("I8", record, record.seq == self._seq + 1, gap)
        self._seq = record.seq
        match record.kind:
            case "state" if record.body.get("machine") == "run":
                self._life(record, msgspec.convert(record.body, Life))
            case "verdict":
                (self._failed.discard if record.body["holds"] else self._failed.add)(record.key)
            case "event":
                self._event(record)
            case "end":
                self._end(record, msgspec.convert(record.body, Ended))

    def _event(self, record: Record) -> None:
        match record.body.get("what"):
            case "closed":
                self._closings.append(record.body)
                took_s = record.body["took_s"]
                what = f"the teardown took {took_s:.1f} s, at most {TEARDOWN_S:g} s"
                self._check("I7", record, 0.0 <= took_s <= TEARDOWN_S, what)
            case "safe stop" if record.body.get("cause"):
                self._reason = self._reason or record.body["cause"]
            case "acknowledged":
                until = msgspec.convert(record.body, Acknowledged).until
                unseen = f"alarms up to record {until} were acknowledged before it was written"
                self._check("I17", record, until < record.seq, unseen)

    def _life(self, record: Record, life: Life) -> None:
        what = f"state was {self._state}, not {life.before}"
        self._check("I9", record, life.before == self._state, what)
        if life.to == "running" and self._state in WAITING:
            found = f"{self._state} went on by {life.by or 'nobody'}"
            self._check("I13", record, life.by in GOES_ON[self._state], found)
        if life.to == "checking":
            self._closings, self._reason = [], ""
        self._state = life.to
        if life.to in OVER:
            count = len(self._closings)
            self._check("I7", record, count == 1, f"teardown ran {count} times")
        if life.to in ("aborted", "faulted"):
            self._held(record)
        if life.to == "faulted":
            self._first_reason(record, life.reason)

    def _held(self, record: Record) -> None:
        """Judge that slide and robot were left held: a device that cannot tell is no proof."""
        problems = self._closings[-1].get("problems", {}) if self._closings else {}
        for device in HELD_DEVICES:
            if device in problems:
                self._tally.unproven("I12", record, f"{device}: {problems[device]}")
            else:
                self._check("I12", record, bool(self._closings), f"{device} was not closed")

    def _first_reason(self, record: Record, reason: str) -> None:
        self._reason = self._reason or reason
        kept = f"the reason became {reason!r}, first it was {self._reason!r}"
        self._check("I6", record, bool(reason) and reason == self._reason, kept)

    def _end(self, record: Record, end: Ended) -> None:
        if end.state == "faulted":
            self._first_reason(record, end.reason)
        if end.state == "finished":
            failed = ", ".join(sorted(self._failed))
            what = f"exit {end.exit}, and {failed} does not hold"
            self._check("I17", record, not (self._failed and end.exit == 0), what)
            if isinstance(counts := end.result.get("points"), dict):
                self._counts(record, counts)

    def _counts(self, record: Record, counts: dict[str, int]) -> None:
        """Judge that the result counts each valid point once."""
        points, dropped = self._scene.points, self._scene.dropped
        valid = Counter(point.group for point in points.values())
        more = {
            group
            for group in {point.group for point in dropped.values()}
            if counts.get(group, 0) > valid[group]
        }
        what = f"the result counts points that are not valid: {', '.join(sorted(more))}"
        self._check("I10", record, not more, what)
        wrong = [g for g in sorted({*valid, *counts}) if counts.get(g, 0) != valid[g]]
        figures = ", ".join(f"{g} {counts.get(g, 0)} of {valid[g]}" for g in wrong)
        self._check("I8", record, not wrong, f"the result counts {figures}")
