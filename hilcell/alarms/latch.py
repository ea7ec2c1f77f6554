"""Alarms latch at their highest severity until their cause is gone and somebody acknowledged them.

A cause is gone when the journal raises its alarm no more: the run that asked has gone on, the
screen that was lost is back. Only then, and only acknowledged, the alarm is let go; a cause that
lasted no longer than its record needs the acknowledgement alone. An alarm of a condition
(`Entry.passes`) latches again when it is raised again. No clock: an alarm is new by the records
that it comes from, so the same journal, read again, counts nothing twice.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from hilcell.alarms.alarm import Alarm
from hilcell.alarms.catalogue import SEVERITIES, Severity
from hilcell.model.events import AlarmsAcknowledged

if TYPE_CHECKING:
    from hilcell.journal.log import Log


@dataclass(frozen=True, slots=True)
class Latched:
    """An alarm that stands: the newest of its code, and how many came.

    ``gone`` is when its cause was seen to be gone, as an ISO time; "" where it is not known to be.
    """

    alarm: Alarm
    severity: Severity
    count: int
    gone: str = ""
    acknowledged: bool = False

    @property
    def settled(self) -> bool:
        """Whether nobody has to know of it any more."""
        return self.acknowledged and (bool(self.gone) or self.alarm.cause == "over")


def _mark(alarm: Alarm) -> tuple[str, int, str]:
    return alarm.code, alarm.origin or alarm.seq, alarm.where


class Latch:
    """The alarms that stand. Used by one thread."""

    def __init__(self) -> None:
        self._latched: dict[str, Latched] = {}
        self._seen: dict[tuple[str, int, str], Alarm] = {}

    def take(
        self,
        alarms: Iterable[Alarm],
        at: str = "",
        acknowledged: Mapping[str, int] | None = None,
    ) -> None:
        """Latch those that were not seen before; ``alarms`` are all that the journal raises now.

        ``at`` is the time of its newest record, by which the causes of all others are gone; ""
        where it is not known: a run that is opened again has not tried its devices yet.
        ``acknowledged`` is what the journal says, as `acknowledged_in` returns it.
        """
        acknowledged = acknowledged or {}
        for code in acknowledged:
            self._acknowledge_until(code, acknowledged)
        raised = {_mark(alarm): alarm for alarm in alarms}
        for mark, alarm in [*self._seen.items()]:
            if mark not in raised and alarm.passes:
                del self._seen[mark]
        for code, latched in [*self._latched.items()]:
            there = raised.get(_mark(latched.alarm))
            gone = "" if there else latched.gone or at
            self._keep(code, replace(latched, alarm=there or latched.alarm, gone=gone))
        for mark, alarm in raised.items():
            if mark not in self._seen:
                self._seen[mark] = alarm
                self._add(alarm)
                self._acknowledge_until(alarm.code, acknowledged)

    def _keep(self, code: str, latched: Latched) -> None:
        """Keep one as it stands now, or let go of it."""
        if latched.settled:
            del self._latched[code]
        else:
            self._latched[code] = latched

    def _add(self, alarm: Alarm) -> None:
        before = self._latched.pop(alarm.code, None)
        if before is None:
            self._latched[alarm.code] = Latched(alarm, alarm.severity, 1)
            return
        severity = max(before.severity, alarm.severity, key=SEVERITIES.index)
        self._latched[alarm.code] = Latched(alarm, severity, before.count + 1)

    def _acknowledge_until(self, code: str, acknowledged: Mapping[str, int]) -> None:
        """Acknowledge an alarm that somebody has seen, on whichever screen."""
        latched, until = self._latched.get(code), acknowledged.get(code)
        if latched is not None and until is not None and latched.alarm.seq <= until:
            self._keep(code, replace(latched, acknowledged=True))

    def standing(self) -> list[Latched]:
        """Return the latched alarms: the most severe first, of those the newest first."""
        newest = list(reversed(self._latched.values()))
        return sorted(newest, key=lambda each: -SEVERITIES.index(each.severity))

    def waits(self) -> bool:
        """Whether one of them waits for its acknowledgement."""
        return not all(each.acknowledged for each in self._latched.values())

    def acknowledge(self, code: str = "") -> None:
        """Acknowledge one code, or all; later ones latch again."""
        for each in [code] if code else [*self._latched]:
            if each in self._latched:
                self._keep(each, replace(self._latched[each], acknowledged=True))


def acknowledged_in(log: Log) -> dict[str, int]:
    """Return, by code, up to which record the alarms of a run were acknowledged."""
    until: dict[str, int] = {}
    for record in log.events:
        if isinstance(record.fact, AlarmsAcknowledged):
            for code in record.fact.codes:
                until[code] = max(until.get(code, 0), record.fact.until)
    return until
