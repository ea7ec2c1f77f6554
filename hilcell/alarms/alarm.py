"""The alarms of a run, from its journal alone: the same for a live run, a past one, a crash.

A run is performed in sessions, and the fault that stopped an earlier one was dealt with. So only
the last session's events count, while verdicts, the room's temperature and sessions that a crash
cut off concern the whole run.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from shlex import quote
from typing import TYPE_CHECKING, Literal

from hilcell.alarms.catalogue import By, Entry, Severity, code_of_verdict, entry_of
from hilcell.clean import clean
from hilcell.model.events import (
    AnswerRefused,
    Closed,
    Closing,
    CommandRefused,
    CurveMeasured,
    DeviceBack,
    DeviceLost,
    LinkCounted,
    NoReadingOf,
    OutlierMeasuredAgain,
    RetakeRefused,
    SafeStopSent,
    ScreenBack,
    ScreenLost,
    StationHeld,
    after,
)
from hilcell.model.records import Change, StateChanged
from hilcell.typed import Json

if TYPE_CHECKING:
    from hilcell.journal.journal import Record
    from hilcell.journal.log import Log


# A text may come from a device, so nothing of it reaches a screen uncleaned.

PARTS = ("code", "device", "operation", "found", "wanted", "act")


@dataclass(frozen=True, slots=True)
class Finding:
    """The parts of a `hilcell.errors.DeviceError`; of other errors the code and ``found`` alone."""

    code: str
    device: str
    operation: str
    found: str
    wanted: str = ""
    act: str = ""

    @property
    def where(self) -> str:
        """Return the device and its operation."""
        return clean(": ".join(part for part in (self.device, self.operation) if part))

    @property
    def text(self) -> str:
        """Return the found and the wanted value, as one line."""
        wanted = f", wanted {line(self.wanted)}" if self.wanted else ""
        return line(self.found) + wanted

    @property
    def advice(self) -> str:
        """Return ``act`` as a sentence."""
        text = line(self.act)
        end = "" if text.endswith((".", "?", "!")) else "."
        return f"{text[:1].upper()}{text[1:]}{end}" if text else ""


def line(text: str) -> str:
    """Return a device's or an error's text as one clean line."""
    return clean("; ".join(" ".join(each.split()) for each in text.splitlines() if each.strip()))


def findings_of(error: Json) -> list[Finding]:
    """Return the findings of an error's facts; devices that failed together have one each."""
    if causes := error.get("causes"):
        return [finding for cause in causes for finding in findings_of(cause)]
    return [Finding(*(str(error.get(name, "")) for name in PARTS))]


DRIFT_LIMIT_K = 2.0
MANY_APPROACHES = 0.5  # of those that the cell file allows
STRAYED = 0.5  # of rail.slip_limit_mm: drive against strip, from one hold to the next
REFUSED_EXITS = (2, 3, 5, 6, 7)
PROBLEMS = {"safe stop": "HC-C02", "closed": "HC-C03"}
REFUSALS = {"answer refused": "HC-C09", "retake refused": "HC-C14"}
GO_ON = "space"  # the usual key
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


SHOW_LAST = "`hilcell show last`"  # as an entry says it, which knows no run


@dataclass(frozen=True, slots=True)
class _Moment:
    """A finding and its record; ``severity`` only where it is not the entry's."""

    finding: Finding
    t: str = ""
    seq: int = 0
    severity: Severity | None = None
    cause: Cause = "over"
    origin: int = 0


def alarms_of(
    log: Log, run: str, *, live: bool, go_on: str = GO_ON, lost: bool = False
) -> list[Alarm]:
    """Return the alarms of a run, newest last; ``live``: its engine is at work.

    ``go_on`` is the key that lets a run continue, as the screen has it; ``lost`` tells that no
    calibration's file is there, which matters where the run has ended with one.

    Alarms that no record dates (verdicts, temperature) stand first.
    """
    if log.plan is None:
        return []
    session = [record for record in log.events if record.seq > log.began]
    raised = _Raised(log, session, live)
    moments = [*raised.temperature(), *raised.verdicts(), *raised.events(), *raised.points()]
    moments += raised.strip()
    moments += raised.devices() if live else []
    moments += [*raised.cut_off(), *raised.end()]
    moments += raised.lost() if lost and not live else []
    moments.sort(key=lambda moment: moment.seq)
    over = not live or log.over
    return [_alarm(moment, run, go_on, over=over) for moment in moments]


def _alarm(moment: _Moment, run: str, go_on: str, *, over: bool) -> Alarm:
    finding = moment.finding
    entry = entry_of(finding.code, finding.device)
    severity = moment.severity or entry.severity
    # An entry that knows its fault advises better than the error itself.
    steps: list[tuple[str, By]] = [*zip(entry.do, entry.checked_by, strict=True)]
    if not entry.specific:
        steps.insert(0, (finding.advice, "you"))
    then = "" if severity == "notice" else _then(entry, run, go_on, over=over)
    steps.append((then, "you"))
    of_run = f"`hilcell show {quote(line(run))}`"  # the newest may be another by now
    steps = [(step.replace(SHOW_LAST, of_run), by) for step, by in steps if step]
    return Alarm(
        entry.code,
        severity,
        entry.title,
        finding.where,
        finding.text,
        entry.means,
        tuple(step for step, _ in steps),
        moment.t,
        moment.seq,
        entry.then == "new run",
        entry.passes,
        moment.cause,
        tuple(by for _, by in steps),
        bool(then),
        moment.origin,
    )


def _then(entry: Entry, run: str, go_on: str, *, over: bool) -> str:
    match entry.then:
        case "resume":
            command = f", or `hilcell resume {quote(line(run))}`" if over else ""
            return f"Continue: {go_on}{command}."
        case "new run":
            return "Start a new run: `hilcell run`."
        case _:
            return ""


# -- alarms of the journal's records --------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Raised:
    """The moments that a run's journal raises; ``session`` are the events of the last session."""

    log: Log
    session: list[Record]
    live: bool

    def temperature(self) -> Iterator[_Moment]:
        """Yield the first point at which the air is too far from that of the run's first."""
        first_c = next(iter(self.log.celsius.values()), 0.0)
        for key, now_c in self.log.celsius.items():
            off_k = now_c - first_c
            if not abs(off_k) <= DRIFT_LIMIT_K:
                found = f"{now_c:.1f} C at {key}, {off_k:+z.1f} K from the start"
                wanted = f"within {DRIFT_LIMIT_K:.0f} K"
                yield _Moment(_cell("HC-V04", "temperature", found, wanted))
                return

    def verdicts(self) -> Iterator[_Moment]:
        for key, record in self.log.judged.items():
            verdict = self.log.verdicts[key]
            if not verdict.holds:
                code = code_of_verdict(key, verdict.outcome)
                yield _Moment(_cell(code, f"verdict {key}", verdict.why), record.t, record.seq)

    def events(self) -> Iterator[_Moment]:
        back = max((r.seq for r in self.session if isinstance(r.fact, ScreenBack)), default=0)
        for record in self.session:
            t, seq = record.t, record.seq
            match record.fact:
                case NoReadingOf(error=error):
                    # Tried again at once; whether that helped is elsewhere.
                    yield from _moments(error, t, seq, "notice")
                case SafeStopSent() | Closed() as closing:
                    for name in closing.problems:
                        code, found = PROBLEMS[closing.what], _problem(name, closing)
                        finding = _cell(code, closing.what, found)
                        yield _Moment(finding, t, seq, cause="not watched")
                case CommandRefused() as impossible:
                    yield _Moment(_cell("HC-C06", "command", impossible.why), t, seq)
                case ScreenLost() if seq > back:
                    found = "nobody watches any more"
                    yield _Moment(_cell("HC-C08", "screen lost", found), t, seq, cause="watched")
                case AnswerRefused() | RetakeRefused() as refused:
                    found = refused.subject + after(refused.why) if refused.subject else refused.why
                    yield _Moment(_cell(REFUSALS[refused.what], refused.what, found), t, seq)
                case LinkCounted() if self.log.link is not None and self.log.link.warning:
                    yield _Moment(_cell("HC-R12", "link", self.log.link.counts), t, seq)

    def points(self) -> Iterator[_Moment]:
        """Yield the points and sweeps that were not as they should be."""
        for record in self.session:
            match record.fact:
                case OutlierMeasuredAgain(key=key):
                    found = f"{key} stands out from its neighbours and was measured again"
                    yield _Moment(_cell("HC-V05", "outlier", found), record.t, record.seq)
                case CurveMeasured(holds=False) as sweep:
                    found = f"A{sweep.axis}: {sweep.reason}"
                    yield _Moment(_cell("HC-V06", "axis sweep", found), record.t, record.seq)

    def strip(self) -> Iterator[_Moment]:
        """Yield the holds that took long, or at which drive and strip have moved apart."""
        rail, first_mm = self.log.cell.rail, dict[str, float]()
        for record in self.session:
            held = record.fact
            if not isinstance(held, StationHeld):
                continue
            name, tries = held.station, held.tries
            if tries > MANY_APPROACHES * rail.max_approaches:
                found = f"{name} held only after {tries} approaches, "
                found += f"{rail.max_approaches} are allowed"
                yield _Moment(_cell("HC-S08", "strip approaches", found), record.t, record.seq)
            apart_mm = held.rail_mm - held.strip_mm
            strayed_mm = apart_mm - first_mm.setdefault(name, apart_mm)
            if not abs(strayed_mm) <= STRAYED * rail.slip_limit_mm:
                found = f"{name}: drive and strip have moved {strayed_mm:+z.2f} mm apart"
                yield _Moment(_cell("HC-S09", "strip apart", found), record.t, record.seq)

    def devices(self) -> Iterator[_Moment]:
        """Yield the devices that are lost while the run waits: the next motion would be refused."""
        lost: dict[str, tuple[Record, Json]] = {}
        for record in self.session if self.log.state in ("paused", "suspended") else ():
            match record.fact:
                case DeviceLost(device=device, error=error):
                    lost[device] = record, error
                case DeviceBack(device=device):
                    lost.pop(device, None)
        for record, error in lost.values():
            yield from _moments(error, record.t, record.seq, cause="watched")

    def cut_off(self) -> Iterator[_Moment]:
        """Yield the crashes of earlier sessions: a screen that comes later asks about them, too.

        A run that has finished since has proven the cell: there they are only worth a notice.
        """
        severity: Severity | None = "notice" if self.log.state == "finished" else None
        for cut in self.log.cut_off:
            found = _crash(cut.state, cut.points)
            yield _Moment(found, cut.last.t, cut.last.seq, severity, origin=cut.began)

    def end(self) -> Iterator[_Moment]:
        """Yield why the run stands as it does, or why a session did not begin."""
        log = self.log
        state, end = log.state, log.end
        none = StateChanged(machine="run", to="idle")
        seq, t, change = log.life[-1] if log.life else Change(0, "", none)
        reason, error = change.reason, change.error
        refused_has_end = log.life and not log.over
        if state == "faulted":
            yield from _moments(error, t, seq, "fault", "not watched")
        elif state == "suspended" and self.live and error:
            yield from _moments(error, t, seq, cause="watched")
        elif state == "aborted":
            yield _Moment(_cell("HC-C05", "stopped", reason or "the run was stopped"), t, seq)
        elif not self.live and (end is None or refused_has_end):
            final = log.newest
            at = (final.t, final.seq) if final is not None else (t, seq)
            found = _crash(state, log.counted)
            yield _Moment(found, *at, cause="watched", origin=log.began)
        if end is not None and end.error and end.reason != reason and end.exit in REFUSED_EXITS:
            yield from _moments(end.error, t, seq, "fault", "not watched")  # its end alone says so

    def lost(self) -> Iterator[_Moment]:
        """Yield that the calibration's file is not there, where the run has ended with one."""
        if self.log.calibrates:
            final = self.log.life[-1]
            finding = _cell("HC-J11", "calibration", "it has no file")
            yield _Moment(finding, final.t, final.seq, cause="watched")


def _moments(
    error: Json,
    t: str,
    seq: int,
    severity: Severity | None = None,
    cause: Cause = "over",
) -> Iterator[_Moment]:
    """Yield the alarms of a record's error."""
    for finding in findings_of(error):
        yield _Moment(finding, t, seq, severity, cause)


def _cell(code: str, operation: str, found: str, wanted: str = "") -> Finding:
    return Finding(code, "Cell", operation, found, wanted)


def _problem(name: str, closing: Closing) -> str:
    """Return the message of a device's error, with its name once and without its advice."""
    finding = findings_of(closing.errors[name])[0]
    text = f"{finding.where}: {finding.text}" if finding.where else finding.text
    return text if text.startswith(f"{name}: ") else f"{name}: {text}"


def _crash(state: str, points: int) -> Finding:
    found = f"the journal ends while the run was {state}, with {points} points"
    return _cell("HC-J05", "crash", found)
