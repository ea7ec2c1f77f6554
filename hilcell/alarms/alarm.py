"""The alarms of a run, from its journal alone: the same for a live run, a past one, a crash.

A run is performed in sessions, and the fault that stopped an earlier one was dealt with. So only
the last session's events count, while verdicts, the room's temperature and sessions that a crash
cut off concern the whole run.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from shlex import quote
from typing import TYPE_CHECKING, Literal

from hilcell.alarms.catalogue import SEVERITIES, By, Severity, code_of_verdict, entry_of
from hilcell.decoding import Json
from hilcell.errors import EXIT_FAULT, EXIT_INTERNAL, EXIT_LOCKED, EXIT_REFUSED, EXIT_STORAGE
from hilcell.model import events
from hilcell.model.events import after
from hilcell.model.records import Change, StateChanged
from hilcell.sanitize import clean

if TYPE_CHECKING:
    from hilcell.journal.journal import Record
    from hilcell.journal.log import Log


# A text may come from a device, so nothing of it reaches a screen uncleaned.


@dataclass(frozen=True, slots=True)
class Finding:
    """The parts of a `hilcell.errors.DeviceError`; of other errors the code and ``found`` alone.

    ``at`` is its record, if one dates it; ``severity`` only where it is not the entry's.
    """

    code: str
    device: str
    operation: str
    found: str
    wanted: str = ""
    act: str = ""
    at: Record | Change | None = None
    severity: Severity | None = None
    cause: Cause = "over"
    origin: int = 0

    @property
    def where(self) -> str:
        return clean(": ".join(part for part in (self.device, self.operation) if part))

    @property
    def text(self) -> str:
        """Return the found and the wanted value, as one line."""
        expected = f", expected {line(self.wanted)}" if self.wanted else ""
        return line(self.found) + expected

    @property
    def advice(self) -> str:
        """Return ``act`` as a sentence."""
        text = line(self.act)
        end = "" if text.endswith((".", "?", "!")) else "."
        return f"{text[:1].upper()}{text[1:]}{end}" if text else ""

    def alarm(self, run: str, go_on: str, *, over: bool) -> Alarm:
        at, entry = self.at, entry_of(self.code, self.device)
        severity = self.severity or entry.severity
        # An entry that knows its fault advises better than the error itself.
        steps: list[tuple[str, By]] = [*zip(entry.do, entry.checked_by, strict=True)]
        if not entry.specific:
            steps.insert(0, (self.advice, "you"))
        name = quote(line(run))
        command = f", or `hilcell resume {name}`" if over else ""
        ways = {
            "resume": f"Continue: {go_on}{command}.",
            "new run": "Start a new run: `hilcell run`.",
        }
        then = "" if severity == "notice" else ways.get(entry.then, "")
        steps.append((then, "you"))
        # An entry, which knows no run, says last: by now that may be another.
        last, this = "`hilcell show last`", f"`hilcell show {name}`"
        steps = [(step.replace(last, this), by) for step, by in steps if step]
        return Alarm(
            entry.code,
            severity,
            entry.title,
            self.where,
            self.text,
            entry.means,
            tuple(step for step, _ in steps),
            "" if at is None else at.t,
            0 if at is None else at.seq,
            entry.then == "new run",
            entry.passes,
            self.cause,
            tuple(by for _, by in steps),
            bool(then),
            self.origin,
        )


def line(text: str) -> str:
    """Return a device's or an error's text as one clean line."""
    return clean("; ".join(" ".join(each.split()) for each in text.splitlines() if each.strip()))


def findings_of(error: Json) -> list[Finding]:
    """Return the findings of an error's facts; devices that failed together have one each."""
    if causes := error.get("causes"):
        return [finding for cause in causes for finding in findings_of(cause)]
    parts = ("code", "device", "operation", "found", "wanted", "act")
    code, device, operation, found, wanted, act = (str(error.get(name, "")) for name in parts)
    return [Finding(code, device, operation, found, wanted, act)]


DRIFT_LIMIT_K = 2.0
CONTINUE_KEY = "space"  # the usual key
Cause = Literal[
    "watched",  # looked at again and again: raised for as long as it is there
    "not watched",  # whether it is there is not known before the run goes on
    "over",  # it happened, and lasts no longer
]


@dataclass(frozen=True, slots=True)
class Alarm:
    """One alarm, ready to be shown: every text is one clean line; ``do`` are steps in order.

    ``by`` says for each step who knows that it is done. ``origin`` is the record by which it is the
    same alarm when it is raised again, where that is not ``seq``.
    """

    code: str
    severity: Severity
    title: str
    where: str
    found: str
    means: str
    do: tuple[str, ...]
    t: str
    seq: int
    ended: bool = False  # the run cannot go on: a new one is needed
    passes: bool = False  # it shows a condition: raised again, it is new
    cause: Cause = "over"
    by: tuple[By, ...] = ()
    goes_on: bool = False  # the last step is how work goes on
    origin: int = 0

    @property
    def mark(self) -> tuple[str, int, str]:
        """Return what an alarm that is raised again has as well."""
        return self.code, self.origin or self.seq, self.where


def alarms_of(
    log: Log, run: str, *, live: bool, go_on: str = CONTINUE_KEY, lost: bool = False
) -> list[Alarm]:
    """Return the alarms of a run, newest last; ``live``: its engine is at work.

    ``go_on`` is the key that lets a run continue, as the screen has it; ``lost`` tells that no
    calibration's file is there, which matters where the run has ended with one.

    Alarms that no record dates (verdicts, temperature) stand first.
    """
    if log.plan is None:
        return []
    raised = _Raised(log, [record for record in log.events if record.seq > log.began], live)
    found = [*raised.temperature(), *raised.verdicts(), *raised.happened(), *raised.points()]
    found += raised.strip()
    found += raised.devices() if live else []
    found += [*raised.cut_off(), *raised.end()]
    found += raised.lost() if lost and not live else []
    found.sort(key=lambda each: 0 if each.at is None else each.at.seq)
    over = not live or log.over
    return [each.alarm(run, go_on, over=over) for each in found]


# -- alarms of the journal's records --------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Raised:
    """The findings that a run's journal raises; ``session`` are the events of the last session."""

    log: Log
    session: list[Record]
    live: bool

    def temperature(self) -> Iterator[Finding]:
        """Yield the first point at which the air is too far from that of the run's first."""
        first_c = next(iter(self.log.celsius.values()), 0.0)
        for key, now_c in self.log.celsius.items():
            off_k = now_c - first_c
            if not abs(off_k) <= DRIFT_LIMIT_K:
                found = f"{now_c:.1f} C at {key}, {off_k:+z.1f} K from the start"
                wanted = f"within {DRIFT_LIMIT_K:.0f} K"
                yield Finding("HC-V04", "Cell", "temperature", found, wanted)
                return

    def verdicts(self) -> Iterator[Finding]:
        for key, record in self.log.judged.items():
            verdict = self.log.verdicts[key]
            if not verdict.holds:
                code = code_of_verdict(key, verdict.outcome)
                yield _cell(code, f"verdict {key}", verdict.why, record)

    def happened(self) -> Iterator[Finding]:
        back = max(
            (r.seq for r in self.session if isinstance(r.fact, events.ScreenBack)), default=0
        )
        for record in self.session:
            match record.fact:
                case events.NoReadingOf(error=error):
                    # Tried again at once; whether that helped is elsewhere.
                    yield from self._of_error(error, record, "notice")
                case events.SafeStopSent() | events.Closed() as closing:
                    code = "HC-C02" if isinstance(closing, events.SafeStopSent) else "HC-C03"
                    for name in closing.problems:
                        found = self._problem(name, closing)
                        yield _cell(code, closing.what, found, record, "not watched")
                case events.CommandRefused() as impossible:
                    yield _cell("HC-C06", "command", impossible.why, record)
                case events.ScreenLost() if record.seq > back:
                    found = "nobody watches any more"
                    yield _cell("HC-C08", "screen lost", found, record, "watched")
                case events.AnswerRefused() | events.RetakeRefused() as refused:
                    found = refused.subject + after(refused.why) if refused.subject else refused.why
                    code = "HC-C09" if isinstance(refused, events.AnswerRefused) else "HC-C14"
                    yield _cell(code, refused.what, found, record)
                case events.LinkCounted() if self.log.link is not None and self.log.link.warning:
                    yield _cell("HC-R12", "link", self.log.link.counts, record)

    def points(self) -> Iterator[Finding]:
        """Yield the points and sweeps that were not as they should be."""
        for record in self.session:
            match record.fact:
                case events.OutlierMeasuredAgain(key=key):
                    found = f"{key} stands out from its neighbours and was measured again"
                    yield _cell("HC-V05", "outlier", found, record)
                case events.CurveMeasured(holds=False) as sweep:
                    found = f"A{sweep.axis}: {sweep.reason}"
                    yield _cell("HC-V06", "axis sweep", found, record)

    def strip(self) -> Iterator[Finding]:
        """Yield the holds that took long, or at which drive and strip have moved apart."""
        rail, first_mm = self.log.cell.rail, dict[str, float]()
        for record in self.session:
            held = record.fact
            if not isinstance(held, events.StationHeld):
                continue
            name, tries = held.station, held.tries
            if tries > 0.5 * rail.max_approaches:
                allowed = f"{rail.max_approaches} are allowed"
                found = f"{name} held only after {tries} approaches, {allowed}"
                yield _cell("HC-S08", "strip approaches", found, record)
            apart_mm = held.rail_mm - held.strip_mm
            strayed_mm = apart_mm - first_mm.setdefault(name, apart_mm)
            if not abs(strayed_mm) <= 0.5 * rail.slip_limit_mm:
                found = f"{name}: drive and strip have moved {strayed_mm:+z.2f} mm apart"
                yield _cell("HC-S09", "strip apart", found, record)

    def devices(self) -> Iterator[Finding]:
        """Yield the devices that are lost while the run waits: the next motion would be refused."""
        lost: dict[str, tuple[Record, Json]] = {}
        for record in self.session if self.log.state in ("paused", "suspended") else ():
            match record.fact:
                case events.DeviceLost(device=device, error=error):
                    lost[device] = record, error
                case events.DeviceBack(device=device):
                    lost.pop(device, None)
        for record, error in lost.values():
            yield from self._of_error(error, record, cause="watched")

    def cut_off(self) -> Iterator[Finding]:
        """Yield the crashes of earlier sessions: a screen that comes later asks about them, too.

        A run that has finished since has proven the cell: there they are only worth a notice.
        """
        severity: Severity | None = "notice" if self.log.state == "finished" else None
        for cut in self.log.cut_off:
            found = self._crash(cut.state, cut.points)
            yield replace(found, at=cut.last, severity=severity, origin=cut.began)

    def end(self) -> Iterator[Finding]:
        """Yield why the run stands as it does, or why a session did not begin."""
        log, state, end = self.log, self.log.state, self.log.end
        none = Change(0, "", StateChanged(machine="run", to="idle"))
        newest = log.life[-1] if log.life else none
        reason, error = newest.change.reason, newest.change.error
        refused_has_end = log.life and not log.over
        if state == "faulted":
            yield from self._of_error(error, newest, "fault", "not watched")
        elif state == "suspended" and self.live and error:
            yield from self._of_error(error, newest, cause="watched")
        elif state == "aborted":
            yield _cell("HC-C05", "stopped", reason or "the run was stopped", newest)
        elif not self.live and (end is None or refused_has_end):
            crash = self._crash(state, log.counted)
            yield replace(crash, at=log.newest or newest, cause="watched", origin=log.began)
        failed = (EXIT_REFUSED, EXIT_FAULT, EXIT_INTERNAL, EXIT_LOCKED, EXIT_STORAGE)
        refused = end is not None and end.exit in failed and end.reason != reason
        if end is not None and end.error and refused:
            # Its end alone says so.
            yield from self._of_error(end.error, newest, "fault", "not watched")

    def lost(self) -> Iterator[Finding]:
        """Yield that the calibration's file is not there, where the run has ended with one."""
        if self.log.calibrates:
            newest = self.log.life[-1]
            yield _cell("HC-J11", "calibration", "it has no file", newest, "watched")

    @staticmethod
    def _of_error(
        error: Json, at: Record | Change, severity: Severity | None = None, cause: Cause = "over"
    ) -> Iterator[Finding]:
        """Yield the findings of a record's error."""
        for finding in findings_of(error):
            yield replace(finding, at=at, severity=severity, cause=cause)

    @staticmethod
    def _problem(name: str, closing: events.Closing) -> str:
        """Return the message of a device's error, with its name once and without its advice."""
        finding = findings_of(closing.errors[name])[0]
        text = f"{finding.where}: {finding.text}" if finding.where else finding.text
        return text if text.startswith(f"{name}: ") else f"{name}: {text}"

    @staticmethod
    def _crash(state: str, points: int) -> Finding:
        found = f"the journal ends while the run was {state}, with {points} points"
        return _cell("HC-J05", "crash", found)


def _cell(
    code: str, operation: str, found: str, at: Record | Change | None = None, cause: Cause = "over"
) -> Finding:
    return Finding(code, "Cell", operation, found, at=at, cause=cause)


# -- alarms that stand -----------------------------------------------------------------------------

# Alarms latch at their highest severity until their cause is gone and somebody acknowledged them.
# A cause is gone when the journal raises its alarm no more: the run that asked has gone on, the
# screen that was lost is back. Only then, and only acknowledged, the alarm is let go; a cause that
# lasted no longer than its record needs the acknowledgement alone. An alarm of a condition
# (`Entry.passes`) latches again when it is raised again. No clock: an alarm is new by the records
# that it comes from, so the same journal, read again, counts nothing twice.


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


class Latch:
    """The alarms that stand. Used by one thread."""

    def __init__(self) -> None:
        self._latched: dict[str, Latched] = {}
        self._seen: dict[tuple[str, int, str], Alarm] = {}

    def take(
        self, alarms: Iterable[Alarm], at: str = "", acknowledged: Mapping[str, int] | None = None
    ) -> None:
        """Latch those that were not seen before; ``alarms`` are all that the journal raises now.

        ``at`` is the time of its newest record, by which the causes of all others are gone; ""
        where it is not known: a run that is opened again has not tried its devices yet.
        ``acknowledged`` is what the journal says, as `acknowledged_in` returns it.
        """
        acknowledged = acknowledged or {}
        for code in acknowledged:
            self._acknowledge_until(code, acknowledged)
        raised = {alarm.mark: alarm for alarm in alarms}
        for mark, alarm in [*self._seen.items()]:
            if mark not in raised and alarm.passes:
                del self._seen[mark]
        for code, latched in [*self._latched.items()]:
            there = raised.get(latched.alarm.mark)
            gone = "" if there else latched.gone or at
            self._keep(code, replace(latched, alarm=there or latched.alarm, gone=gone))
        for mark, alarm in raised.items():
            if mark not in self._seen:
                self._seen[mark] = alarm
                self._add(alarm)
                self._acknowledge_until(alarm.code, acknowledged)

    def _keep(self, code: str, latched: Latched) -> None:
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
        if isinstance(record.fact, events.AlarmsAcknowledged):
            for code in record.fact.codes:
                until[code] = max(until.get(code, 0), record.fact.until)
    return until
