"""The last word of a run: its outcome in one sentence, and the commands to type next.

`hilcell run`, `resume`, `watch` and `show`, the screen, the web page and notifications end with it.
It is computed from the journal alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec

from hilcell.alarms.alarm import findings_of
from hilcell.alarms.catalogue import code_of_verdict, entry_of
from hilcell.calibration.known_arm import unfit
from hilcell.calibration.lookup import calibration_in
from hilcell.calibration.recheck import KIND as RECHECK
from hilcell.calibration.recheck import RecheckResult
from hilcell.decoding import Json, typed
from hilcell.errors import EXIT_REFUSED, RESUMABLE, exit_code, facts_of
from hilcell.identification.known_arm import ArmChanged
from hilcell.journal.calibration_facts import NOT_JUDGED
from hilcell.journal.disk_space import shortage
from hilcell.journal.labels import verdict_label, with_labels
from hilcell.journal.log import Log
from hilcell.journal.runs_folder import command_in, command_on
from hilcell.model.events import CalibrationUsed
from hilcell.model.outcome import Figure, Outcome
from hilcell.model.verdicts import (
    OTHERS,
    VALIDATION,
    InstrumentChecked,
    Judged,
    PoseTested,
    Rechecked,
    Verdict,
)
from hilcell.ports import RecordingEnded
from hilcell.sanitize import counted, encodable, harmless

RECHECKED = {"valid": "STILL VALID", "update": "UPDATED", "redo": "CALIBRATE AGAIN"}
MOST_REASONS = 2
USELESS = (RecordingEnded.code, ArmChanged.code)  # to resume: the same points would say the same
DEFAULT_CELL = "paper"  # of the commands


@dataclass(frozen=True, slots=True)
class LastWord:
    """The outcome in capitals, the figures or the cause, and the commands to type next."""

    outcome: str
    because: str
    next: tuple[str, ...]
    simulated: bool

    @property
    def sentence(self) -> str:
        """Return outcome and cause, on one clean line."""
        head = f"{self.outcome} (simulated)" if self.simulated else self.outcome
        because = " ".join(self.because.split()).rstrip(".")
        return harmless(encodable(f"{head}: {because}" if because else head))

    @property
    def text(self) -> str:
        """Return the sentence and the next commands, on one clean line."""
        commands = harmless(encodable("; ".join(self.next)))
        return f"{self.sentence}. Next: {commands}" if commands else f"{self.sentence}."


def last_word(log: Log, folder: Path, fault: Exception | None = None) -> LastWord:
    """Return the last word of a run that has ended, or whose process has died.

    ``fault`` is an error that the journal does not have: of its own storage, or of the calibration
    file.
    """
    end = log.end
    if fault is not None:
        words = _faulted(log, folder, facts_of(fault), exit_code(fault))
    elif end is None:
        because = f"the process of the run has died while it was {log.state}; {_progress(log)}"
        because += shortage(folder)  # the likely cause, which no record could tell
        words = "INTERRUPTED", because, (command_on(folder, "resume"),)
    elif log.state == "finished":
        words = _finished(log, folder)
    elif log.state == "aborted":
        words = _stopped(log, folder)
    else:
        error = end.error or {"found": log.fault or end.reason}
        words = _faulted(log, folder, error, end.exit)
    return LastWord(*words, simulated=log.inputs.simulated)


_Words = tuple[str, str, tuple[str, ...]]


def _stopped(log: Log, folder: Path) -> _Words:
    session = [each.change for each in log.life if each.seq >= log.began]
    aborted = any(change.to == "aborting" for change in session)
    reason = next((change.reason for change in reversed(session) if change.reason), "")
    if not reason and log.end is not None:
        reason = log.end.reason
    by = reason.removeprefix("stopped ").removeprefix("aborted ")
    outcome = "ABORTED" if aborted else "STOPPED"
    because = "; ".join(filter(None, (by, _progress(log))))
    return outcome, because, (command_on(folder, "resume"),)


def _faulted(log: Log, folder: Path, error: Json, code: int) -> _Words:
    findings = findings_of(error)
    entries = [entry_of(each.code, each.device) for each in findings]
    codes = list(dict.fromkeys(each.code for each in findings if each.code))
    found = ": ".join(filter(None, (findings[0].where, findings[0].text)))
    others = f" (and {len(findings) - 1} more)" if len(findings) > 1 else ""
    commands = [f"hilcell explain {each.code}" for each in entries if each.specific]
    refused = code == EXIT_REFUSED
    kept = "nothing has moved" if refused and not log.moved else _progress(log)
    ends = any(entry.then == "new run" for entry in entries)
    lost = ends and any(each.startswith("HC-J") or each in USELESS for each in codes)
    if ends and not refused:
        commands.append(f"{_new_run(log, folder)} (a new run is advised)")
    if code in RESUMABLE and not lost:
        commands.append(command_on(folder, "resume"))
    outcome = f"{'REFUSED' if refused else 'FAULT'} {', '.join(codes)}".rstrip()
    because = f"{with_labels(found, log)}{others}; {kept}"
    return outcome, because, tuple(dict.fromkeys(commands))


def _finished(log: Log, folder: Path) -> _Words:
    rechecked = log.verdict(Rechecked)
    if rechecked is not None:
        return _rechecked(log, folder, rechecked)
    report = command_on(folder, "report", "-o", "report.html")
    failed = failed_verdicts(log.verdicts)
    codes = dict.fromkeys(code_of_verdict(key, each.outcome) for key, each in failed.items())
    explain = [f"hilcell explain {code}" for code in codes]
    outcome, facts = log.outcome, log.facts
    if (checked := InstrumentChecked.by(log.verdicts)) is not None:
        return log.outcome_text.upper(), checked.text, (*explain[:MOST_REASONS], report)
    if outcome is Outcome.ACCEPTED:
        prepare = [_prepare(log, folder, folder.name)] if log.calibrates else []
        return "IN TOLERANCE", _figures(log.verdicts), (report, *prepare)
    if outcome is not None or facts.suspected:
        head = "SUSPECTED CAUSE" if outcome is None else outcome.text.upper()
        return head, _reasons(failed, log), (*explain[:MOST_REASONS], report)
    head = "NOT VALIDATED" if log.outcome_text not in NOT_JUDGED else log.outcome_text.upper()
    return head, _progress(log), (report,) if log.points else ()


def _rechecked(log: Log, folder: Path, rechecked: Rechecked) -> _Words:
    figures = [f"drift {rechecked.drift_mm:.3f} mm, u {rechecked.drift_u_mm:.3f} mm"]
    try:
        found = typed(log.result.get(RECHECK), RecheckResult)
    except msgspec.ValidationError:  # of another version
        pass
    else:
        mean = f"as found, mean {found.mean_mm:.3f} mm (limit {found.mean_tolerance_mm:g})"
        figures.append(f"{mean}, largest {found.max_mm:.3f} ({found.max_tolerance_mm:g})")
    others = {key: each for key, each in failed_verdicts(log.verdicts).items() if key != "recheck"}
    reasons = [each for each in (rechecked.doubt, _reasons(others, log)) if each]
    because = "; ".join(figures + reasons)
    used = [event.run for event in log.happened(CalibrationUsed)]
    match rechecked.verdict:
        case "valid":
            commands = [_prepare(log, folder, used[-1] if used else "RUN")]
        case "update":
            report = command_on(folder, "report", "-o", "report.html")
            commands = [report, _prepare(log, folder, folder.name)]
        case "redo":
            commands = [*_again(log, folder), _new_run(log, folder, "calibrate")]
    return RECHECKED[rechecked.verdict], because, tuple(commands)


def _again(log: Log, folder: Path) -> Iterator[str]:
    """Yield the re-calibration from the calibration in use, if that knows the arm."""
    try:
        used = calibration_in(log)
    except msgspec.ValidationError:  # of another version
        return
    if used is not None and not [*unfit(used, log.cell)]:
        words = ("--from", used.provenance.latest, *_cell(log))
        yield command_in(folder.parent, "run", *words)


def _figures(verdicts: Mapping[str, Verdict]) -> str:
    """Return the worst figures beside their limits, those of one unit together."""
    judged = {key: each for key, each in verdicts.items() if isinstance(each, Judged | PoseTested)}
    together = f"{VALIDATION}{OTHERS}"
    if any(key.startswith(VALIDATION) and key != together for key in judged):
        judged.pop(together, None)
    worst: dict[str, tuple[float, Figure, str]] = {}
    for key, verdict in judged.items():
        place = f" at {key.removeprefix(VALIDATION)}" if len(judged) > 1 else ""
        for each in verdict.figures:
            share = math.inf if each.value is None or not each.limit else each.value / each.limit
            share = share if math.isfinite(share) else math.inf
            if each.name not in worst or share > worst[each.name][0]:
                worst[each.name] = share, each, place
    places = {place for *_, place in worst.values()}
    by_unit: dict[str, list[str]] = {}
    for _, each, place in worst.values():
        texts = by_unit.setdefault(each.unit, [])
        unit, limit = ("", "") if texts else (f" {each.unit}", "limit ")
        value = "unknown" if each.value is None else f"{each.value:.3f}{unit}"
        name = each.name.replace("largest error", "largest")
        at = place if len(places) > 1 else ""
        texts.append(f"{name} {value}{at} ({limit}{each.limit:g})")
    together = places.pop() if len(places) == 1 else ""
    return f"{'; '.join(map(', '.join, by_unit.values()))}{together}"


def _reasons(failed: Mapping[str, Verdict], log: Log) -> str:
    """Return the first reasons of failed verdicts, and how many more there are."""
    texts = [f"{verdict_label(key)}: {each.why}" for key, each in failed.items()]
    more = [f"{len(texts) - MOST_REASONS} more in the report"] if texts[MOST_REASONS:] else []
    return with_labels("; ".join([*texts[:MOST_REASONS], *more]), log)


def failed_verdicts(verdicts: Mapping[str, Verdict]) -> dict[str, Verdict]:
    """Return the failed verdicts; that of all stations together only if no station's failed."""
    failed = {key: verdict for key, verdict in verdicts.items() if not verdict.holds}
    together = f"{VALIDATION}{OTHERS}"
    if any(key.startswith(VALIDATION) and key != together for key in failed):
        failed.pop(together, None)
    return failed


def _progress(log: Log) -> str:
    planned, count = log.inputs.points, log.counted
    if log.state == "finished" or count > planned:
        return f"{counted(count, 'point')} measured"
    return f"{count} of {counted(planned, 'point')} measured"


def _prepare(log: Log, folder: Path, calibration: str) -> str:
    words = ("HOLES.csv", *_cell(log), "--calibration", calibration, "-o", "FOLDER")
    return command_in(folder.parent, "prepare", *words)


def _new_run(log: Log, folder: Path, procedure: str = "") -> str:
    name = procedure or log.inputs.procedure
    words = () if name == "calibrate" else (name,)
    return command_in(folder.parent, "run", *words, *_cell(log))


def _cell(log: Log) -> Iterator[str]:
    """Yield the options that name the run's cell again, without those of its plan."""
    if log.inputs.cell_file != DEFAULT_CELL:
        yield from ("--cell", log.inputs.cell_file)
    for key, value in log.inputs.settings.items():
        if not key.startswith("plan."):
            yield from ("--set", f"{key}={value}")
