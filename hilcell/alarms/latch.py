"""Alarms latch at their highest severity until somebody has acknowledged them.

A notice latches too, but is let go when it is raised no more: the screen that was lost is back, the
run that was stopped goes on. So is an alarm of a condition (`Entry.passes`), which latches again
when it is raised again. No clock: an alarm is new by the records that it comes from, so the same
journal, read again, counts nothing twice.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from hilcell.alarms.alarm import Alarm
from hilcell.alarms.catalogue import SEVERITIES, Severity


@dataclass(frozen=True, slots=True)
class Latched:
    """An alarm that waits for its acknowledgement: the newest of its code, and how many came."""

    alarm: Alarm
    severity: Severity
    count: int


Mark = tuple[str, int, str]


def _mark(alarm: Alarm) -> Mark:
    return alarm.code, alarm.seq, alarm.where


class Latch:
    """The alarms that nobody has acknowledged yet. Used by one thread."""

    def __init__(self) -> None:
        self._latched: dict[str, Latched] = {}
        self._seen: dict[Mark, Alarm] = {}

    def take(self, alarms: Iterable[Alarm]) -> None:
        """Latch those that were not seen before; ``alarms`` are all that the journal raises now."""
        raised = {_mark(alarm): alarm for alarm in alarms}
        for mark, alarm in [*self._seen.items()]:
            if mark not in raised:
                self._let_go(mark, alarm)
        for mark, alarm in raised.items():
            if mark not in self._seen:
                self._seen[mark] = alarm
                self._add(alarm)

    def _let_go(self, mark: Mark, alarm: Alarm) -> None:
        """Let go of alarms that are raised no more, where their kind goes by itself."""
        latched = self._latched.get(alarm.code)
        if latched is not None and _mark(latched.alarm) != mark:
            latched = None  # a newer one of its code stands
        if alarm.passes or (latched is not None and latched.severity == "notice"):
            del self._seen[mark]
            if latched is not None:
                del self._latched[alarm.code]

    def _add(self, alarm: Alarm) -> None:
        before = self._latched.pop(alarm.code, None)
        if before is None:
            self._latched[alarm.code] = Latched(alarm, alarm.severity, 1)
            return
        severity = max(before.severity, alarm.severity, key=SEVERITIES.index)
        self._latched[alarm.code] = replace(
            before, alarm=alarm, severity=severity, count=before.count + 1
        )

    def standing(self) -> list[Latched]:
        """Return the latched alarms: the most severe first, of those the newest first."""
        newest = list(reversed(self._latched.values()))
        return sorted(newest, key=lambda each: -SEVERITIES.index(each.severity))

    def acknowledge(self, code: str = "") -> None:
        """Let go of one code, or of all; later ones latch again."""
        if code:
            self._latched.pop(code, None)
        else:
            self._latched.clear()
