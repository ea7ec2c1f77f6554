"""The alarms of a run, from its journal alone: the same for a live run, a past one, a crash.

The fault that stopped an earlier session was dealt with, so only the last session's events count;
verdicts, ambient temperature and crashed sessions concern the whole run.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from shlex import quote
from typing import TYPE_CHECKING, Literal

from hilcell.alarms.catalogue import SEVERITIES, By, Severity, code_of_verdict, entry_of
from hilcell.decoding import Json
from hilcell.errors import EXIT_FAULT, EXIT_INTERNAL, EXIT_LOCKED, EXIT_REFUSED, EXIT_STORAGE
from hilcell.language import tr
from hilcell.model import events
from hilcell.model.events import after
from hilcell.model.records import Change, StateChanged
from hilcell.sanitize import clean

if TYPE_CHECKING:
    from hilcell.journal.journal import Record
    from hilcell.journal.log import Log


# Text from devices is untrusted: it is cleaned before it is shown.


@dataclass(frozen=True, slots=True)
class Finding:
    """The fields of a `hilcell.errors.DeviceError`; other errors have code and ``found`` only.

    ``at`` is its record, if any; ``severity`` replaces the entry's.
    """

    code: str
    device: str
    operation: str
    found: str
    expected: str = ""
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
        """Return actual and expected value, as one line."""
        expected = tr(", expected {what}", what=line(self.expected)) if self.expected else ""
        return line(self.found) + expected

    @property
    def advice(self) -> str:
        text = line(self.act)
        end = "" if text.endswith((".", "?", "!")) else "."
        return f"{text[:1].upper()}{text[1:]}{end}" if text else ""

    def alarm(self, run: str, go_on: str, *, over: bool) -> Alarm:
        at, entry = self.at, entry_of(self.code, self.device)
        severity = self.severity or entry.severity
        # The advice of a specific entry replaces the error's own.
        steps: list[tuple[str, By]] = [*zip(map(tr, entry.do), entry.checked_by, strict=True)]
        if not entry.specific:
            steps.insert(0, (self.advice, "you"))
        name = quote(line(run))
        command = tr(", or {command}", command=f"`hilcell resume {name}`") if over else ""
        following = {
            "resume": tr("Continue: {key}{command}.", key=go_on, command=command),
            "new run": tr("Start a new run: {command}.", command="`hilcell run`"),
        }
        then = "" if severity == "notice" else following.get(entry.then, "")
        steps.append((then, "you"))
        # Entries have `last`, which may be another run by now.
        last, this = "`hilcell show last`", f"`hilcell show {name}`"
        steps = [(step.replace(last, this), by) for step, by in steps if step]
        return Alarm(
            entry.code,
            severity,
            tr(entry.title),
            self.where,
            self.text,
            tr(entry.means),
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
    """Return the findings of an error; devices that failed together have one each."""
    if causes := error.get("causes"):
        return [finding for cause in causes for finding in findings_of(cause)]
    names = ("code", "device", "operation", "found", "wanted", "act")
    code, device, operation, found, expected, act = (str(error.get(name, "")) for name in names)
    return [Finding(code, device, operation, found, expected, act)]


DRIFT_LIMIT_K = 2.0
CONTINUE_KEY = "space"  # the usual key
Cause = Literal[
    "watched",  # polled: raised as long as it lasts
    "not watched",  # unknown until the run continues
    "over",  # momentary
]


@dataclass(frozen=True, slots=True)
class Alarm:
    """One alarm for display: every text is one clean line; ``do`` are the steps in order.

    ``by`` is who verifies each step. ``origin`` is the record that identifies the alarm when it is
    raised again, if not ``seq``.
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
    ended: bool = False  # a new run is needed
    passes: bool = False  # a condition: a new alarm when raised again
    cause: Cause = "over"
    by: tuple[By, ...] = ()
    continues: bool = False  # the last step continues the work
    origin: int = 0

    @property
    def mark(self) -> tuple[str, int, str]:
        return self.code, self.origin or self.seq, self.where


def alarms_of(
    log: Log, run: str, *, live: bool, go_on: str = CONTINUE_KEY, lost: bool = False
) -> list[Alarm]:
    """Return the alarms of a run, newest last; ``live``: its engine is at work.

    ``go_on`` is the screen's key to continue; ``lost``: the run's calibration file is missing.
    Alarms without a record's time (temperature) come first.
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
    """The findings of a run's journal; ``session`` are the events of the last session."""

    log: Log
    session: list[Record]
    live: bool

    def temperature(self) -> Iterator[Finding]:
        """Yield the first point whose temperature is too far from that of the first point."""
        first_c = next(iter(self.log.celsius.values()), 0.0)
        for key, now_c in self.log.celsius.items():
            off_k = now_c - first_c
            if not abs(off_k) <= DRIFT_LIMIT_K:
                found = f"{now_c:.1f} C at {key}, {off_k:+z.1f} K from the start"
                expected = f"within {DRIFT_LIMIT_K:.0f} K"
                yield Finding("HC-V04", "Cell", "temperature", found, expected)
                return

    def verdicts(self) -> Iterator[Finding]:
        for key, record in self.log.verdict_records.items():
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
                    # A retry follows.
                    yield from self._of_error(error, record, "notice")
                case events.SafeStopSent() | events.Closed() as closing:
                    code = "HC-C02" if isinstance(closing, events.SafeStopSent) else "HC-C03"
                    for name in closing.problems:
                        found = self._problem(name, closing)
                        yield _cell(code, closing.what, found, record, "not watched")
                case events.CommandRefused() as impossible:
                    yield _cell("HC-C06", "command", impossible.why, record)
                case events.ScreenLost() if record.seq > back:
                    found = "no screen is connected"
                    yield _cell("HC-C08", "screen lost", found, record, "watched")
                case events.AnswerRefused() | events.RemeasureRefused() as refused:
                    found = refused.subject + after(refused.why) if refused.subject else refused.why
                    code = "HC-C09" if isinstance(refused, events.AnswerRefused) else "HC-C14"
                    yield _cell(code, refused.what, found, record)
                case events.LinkCounted() if self.log.link is not None and self.log.link.warning:
                    yield _cell("HC-R12", "link", self.log.link.counts, record)

    def points(self) -> Iterator[Finding]:
        for record in self.session:
            match record.fact:
                case events.OutlierRemeasured(key=key):
                    found = f"{key} stands out from its neighbours and was measured again"
                    yield _cell("HC-V05", "outlier", found, record)
                case events.CurveMeasured(holds=False) as sweep:
                    found = f"A{sweep.axis}: {sweep.reason}"
                    yield _cell("HC-V06", "axis sweep", found, record)

    def strip(self) -> Iterator[Finding]:
        """Yield holds with many approaches, or with a drift between drive and strip."""
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
        """Yield the devices that are lost while the run waits."""
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
        """Yield the crashes of earlier sessions; of a finished run as notices."""
        severity: Severity | None = "notice" if self.log.state == "finished" else None
        for cut in self.log.cut_off:
            found = self._crash(cut.state, cut.points)
            yield replace(found, at=cut.last, severity=severity, origin=cut.began)

    def end(self) -> Iterator[Finding]:
        """Yield the reason of the run's state, or why a session did not begin."""
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
            # Only the end has the error.
            yield from self._of_error(end.error, newest, "fault", "not watched")

    def lost(self) -> Iterator[Finding]:
        if self.log.calibrates:
            newest = self.log.life[-1]
            yield _cell("HC-J11", "calibration", "it has no file", newest, "watched")

    @staticmethod
    def _of_error(
        error: Json, at: Record | Change, severity: Severity | None = None, cause: Cause = "over"
    ) -> Iterator[Finding]:
        for finding in findings_of(error):
            yield replace(finding, at=at, severity=severity, cause=cause)

    @staticmethod
    def _problem(name: str, closing: events.Closing) -> str:
        """Return a device's error with its name once and without its advice."""
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


# -- latched alarms -------------------------------------------------------------------------------

# Alarms latch at their highest severity until their cause is gone and they are acknowledged. A
# cause is gone once the journal no longer raises its alarm; a momentary cause needs only the
# acknowledgement. An alarm of a condition (`Entry.passes`) latches again when it is raised again.
# Alarms are identified by their records, so a journal that is read again counts nothing twice.


@dataclass(frozen=True, slots=True)
class Latched:
    """The newest latched alarm of its code and their number.

    ``gone`` is the ISO time at which its cause was gone, "" if it may last.
    """

    alarm: Alarm
    severity: Severity
    count: int
    gone: str = ""
    acknowledged: bool = False

    @property
    def settled(self) -> bool:
        return self.acknowledged and (bool(self.gone) or self.alarm.cause == "over")


class Latch:
    """The latched alarms. Used by one thread."""

    def __init__(self) -> None:
        self._latched: dict[str, Latched] = {}
        self._known: dict[tuple[str, int, str], Alarm] = {}

    def take(
        self, alarms: Iterable[Alarm], at: str = "", acknowledged: Mapping[str, int] | None = None
    ) -> None:
        """Latch new ones; ``alarms`` are all that the journal raises now.

        ``at`` is the time of its newest record, when the causes of all others are gone; "" if
        unknown, as in a resumed run before its devices connect. ``acknowledged`` is as from
        `acknowledged_in`.
        """
        acknowledged = acknowledged or {}
        for code in acknowledged:
            self._acknowledge_until(code, acknowledged)
        raised = {alarm.mark: alarm for alarm in alarms}
        for mark, alarm in [*self._known.items()]:
            if mark not in raised and alarm.passes:
                del self._known[mark]
        for code, latched in [*self._latched.items()]:
            there = raised.get(latched.alarm.mark)
            gone = "" if there else latched.gone or at
            self._keep(code, replace(latched, alarm=there or latched.alarm, gone=gone))
        for mark, alarm in raised.items():
            if mark not in self._known:
                self._known[mark] = alarm
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
        latched, until = self._latched.get(code), acknowledged.get(code)
        if latched is not None and until is not None and latched.alarm.seq <= until:
            self._keep(code, replace(latched, acknowledged=True))

    def standing(self) -> list[Latched]:
        """Return the latched alarms: the most severe first, of those the newest first."""
        newest = list(reversed(self._latched.values()))
        return sorted(newest, key=lambda each: -SEVERITIES.index(each.severity))

    def waits(self) -> bool:
        """Whether an alarm is not acknowledged."""
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
