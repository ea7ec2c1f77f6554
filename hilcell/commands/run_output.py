"""Printing of a run while it runs and at its end: JSON lines, or a progress bar and a table.

A closed pipe or a lost terminal never ends the run; data missing on stdout are reported at the end.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from operator import attrgetter
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Self

import msgspec

from hilcell.alarms.catalogue import code_of_verdict
from hilcell.atomic_files import NotPrinted
from hilcell.cell.file import Cell
from hilcell.commands.console import (
    flush_data,
    json_line,
    print_error,
    print_json,
    print_message,
    print_table,
    stdout_checked,
)
from hilcell.decoding import Json
from hilcell.errors import HilcellError, facts_of
from hilcell.journal.calibration_facts import NOT_JUDGED
from hilcell.journal.journal import Record
from hilcell.journal.labels import verdict_label
from hilcell.journal.log import Log
from hilcell.journal.runs_folder import command_on
from hilcell.model.events import (
    ArmCarried,
    Closed,
    CurveMeasured,
    FirstPassBegun,
    NoReadingOf,
    PromiseJudged,
)
from hilcell.model.plan import PlannedStep
from hilcell.model.point import CONTROL, Point
from hilcell.model.records import WAITING, StateChanged
from hilcell.model.verdicts import Verdict, suspected_in
from hilcell.present.table import Column, Table
from hilcell.run.last_word import failed_verdicts
from hilcell.run.procedure import Plan, Procedure
from hilcell.run.stopping import not_at_rest
from hilcell.sanitize import encodable, harmless, harmless_lines

if TYPE_CHECKING:
    from rich.progress import Progress


class RunOutput:
    """Receives every durable record of a run; this base class prints nothing."""

    def __init__(self) -> None:
        self._closed = False
        self.lost: NotPrinted | None = None  # why data are missing on stdout

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Stop printing."""

    def skip_measured(self, keys: Iterable[str]) -> None:
        """Count the points that a resumed run already has."""

    def close(self, code: int, log: Log, fault: Exception | None) -> None:
        """Print the end if the journal could not store it."""

    def take(self, record: Record) -> None:
        """Print one record; nothing more after a failed write."""
        if not self._closed:
            try:
                self.print_record(record)
            except NotPrinted as error:
                self.lost, self._closed = error, True
            except (OSError, ValueError):  # of a progress bar
                self._closed = True

    def print_record(self, record: Record) -> None:
        """Print one record."""


class JsonOutput(RunOutput):
    """Prints every record as one line of JSON on stdout."""

    def __init__(self, run: str) -> None:
        super().__init__()
        self._run = run

    def print_record(self, record: Record) -> None:
        event = record.event(self._run)
        if record.kind == "event" and isinstance(record.fact, ArmCarried):
            event |= {"content": record.fact.summary}
        self._write(event)

    def close(self, code: int, log: Log, fault: Exception | None) -> None:
        if log.end is None and not self._closed:
            end: Json = {"run": self._run, "kind": "end", "state": log.state, "exit": code}
            error = {} if fault is None else {"error": facts_of(fault)}
            try:
                self._write(end | {"result": {}, "reason": str(fault)} | error)
            except NotPrinted as lost:
                self.lost = lost

    def _write(self, event: Json) -> None:
        with stdout_checked():
            sys.stdout.buffer.write(f"{json_line(event)}\n".encode("ascii"))
            sys.stdout.buffer.flush()


def progress_bar() -> Progress:
    """Return a progress bar on stderr; nothing is printed once stderr is a broken pipe."""
    from rich import progress
    from rich.console import Console

    class Quiet(Console):
        def on_broken_pipe(self) -> None:
            """Continue: rich would end the thread that prints, which is the run's worker."""
            self.quiet = True

    return progress.Progress(
        progress.TextColumn("{task.description}", markup=False),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeElapsedColumn(),
        progress.TimeRemainingColumn(),
        console=Quiet(stderr=True),
    )


class ProgressOutput(RunOutput):
    """Draws a progress bar on stderr."""

    def __init__(self, folder: Path, points: int) -> None:
        super().__init__()
        self._known_arm = False  # a re-calibration measures no grid
        self._folder, self._progress = folder, progress_bar()
        self._console = self._progress.console
        self._planned, self._measured = points, set[str]()
        self._task = self._progress.add_task(harmless(encodable(folder.name)), total=points)

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        with suppress(OSError, ValueError):
            self._progress.stop()

    def skip_measured(self, keys: Iterable[str]) -> None:
        self._measured.update(keys)
        self._show_measured()

    def _show_measured(self, description: str | None = None) -> None:
        """Show the count: re-measured points count once; a quick run may exceed its plan."""
        count = len(self._measured)
        total = max(count, self._planned)
        self._progress.update(self._task, completed=count, total=total, description=description)

    def print_record(self, record: Record) -> None:
        match record.fact:
            case Point(group=group, station=station) if group != CONTROL:
                self._measured.add(record.key)
                self._show_measured(harmless(f"{group} at {station}" if station else group))
            case StateChanged() as change:
                self._print_state(change)
            case FirstPassBegun(key=key, speed_percent=percent):
                self._print(f"{key}: first pass outside the cube, at {percent:g} %")
            case PromiseJudged(port=port, promise=promise, verdict=verdict, why=why):
                self._progress.update(self._task, description=harmless(f"{port} {promise}"))
                if verdict == "broken":
                    self._print(f"{port} {promise}: broken: {why}")
            case ArmCarried(run=run):
                self._known_arm = True
                self._print(f"arm carried from {run}")
            case CurveMeasured(holds=False, summary=words):
                self._print(words)
            case NoReadingOf(key=key, reason=reason, tries=tries):
                self._print(f"{key}: {reason} (try {tries})")

    def _print_state(self, change: StateChanged) -> None:
        if change.machine == "calibration" and change.to == "grid_measured" and self._known_arm:
            return  # it follows a carried arm, by poses that come later
        if change.machine == "calibration":
            self._print(change.to.replace("_", " "))
        elif change.to == "checking":
            self._print("connecting; a tracker may take half a minute to initialise")
        elif change.to in WAITING:
            reason = f"{change.reason}; " if change.reason else ""
            if change.prompt is not None:
                reason = f"{change.prompt['title']}. {change.prompt['text']} When it is done, "
            resume = command_on(self._folder, "resume")
            proceed = f"`{resume}` continues, ctrl-C stops"
            choices = [] if change.prompt is None else change.prompt.get("choices", [])
            if words := [f"{each['name']} ({each['text']})" for each in choices]:
                proceed += f"; other answers, by --answer: {', '.join(words)}"
            self._print(f"{change.to}: {reason}{proceed}")

    def _print(self, text: str) -> None:
        self._console.print(harmless_lines(text), markup=False, highlight=False)


def print_end(
    folder: Path, log: Log, procedure: Procedure, output: RunOutput, fault: Exception | None
) -> None:
    """Print the end of a run: its table on stdout, everything else on stderr."""
    if fault is not None:
        print_error(fault)
    if isinstance(output, JsonOutput):
        return
    print_suspected(log)
    if log.end is not None and log.end.result and log.state == "finished":
        _print_result(procedure, output, log.end.result)
    for key, verdict in failed_verdicts(log.verdicts).items():
        print_message(failure_text(key, verdict))
    if log.link is not None and log.link.warning:
        print_message(f"warning: {log.link.warning}")
    gone = log.end is None and fault is not None
    end = f"{log.state}, its end could not be recorded" if gone else end_text(log)
    print_message(f"{kind_of(log)} {folder.name}: {end}; journal in {folder}")


def _print_result(procedure: Procedure, output: RunOutput, result: Json) -> None:
    try:
        print_table(procedure.table(result))
        flush_data()
    except NotPrinted as error:
        output.lost = error
    if text := procedure.words(result):
        print_message(text)


def end_text(log: Log) -> str:
    """Return the state of an ended run, and its outcome if it finished."""
    if log.end is None:
        return f"{log.state}, its process has died"
    outcome = log.outcome_text
    if log.state != "finished":
        return outcome
    return log.state if outcome in NOT_JUDGED else f"{log.state}, {outcome}"


def print_suspected(log: Log) -> None:
    """Print the suspected causes of a faulted run; the text of a finished one contains them."""
    if log.end is not None and log.state == "faulted":
        for each in suspected_in(log.end.result):
            print_message(f"Suspected: {each.text}.")


def print_unclosed(problems: Mapping[str, Exception], fault: Exception | None) -> None:
    """Print which devices were not left at rest, unless the fault says so."""
    error = not_at_rest(problems)
    if error is not None and str(error) != str(fault):
        print_error(error)


def left_moving(log: Log) -> str:
    """Return which devices the last session did not leave at rest, or ""."""
    closings = log.happened(Closed)
    last = closings[-1].problems if closings and log.over else {}
    problems = {name: HilcellError(text) for name, text in last.items()}
    error = not_at_rest(problems)
    return "" if error is None or error.summary in log.fault else str(error)


def print_lost(folder: Path, output: RunOutput) -> None:
    """Print that data are missing on stdout, and where they are complete."""
    if output.lost is not None:
        print_error(output.lost)
        print_message(
            f"the journal in {folder} is complete: "
            f"`hilcell watch {quote(str(folder))} --json` prints it"
        )


def kind_of(log: Log) -> str:
    return "SIMULATED run" if log.inputs.simulated else "run"


def failure_text(key: str, verdict: Verdict) -> str:
    """Return a failed verdict as text: its outcome, its subject, the decisive values."""
    code = code_of_verdict(key, verdict.outcome)
    text = f"{verdict.outcome.text}: {verdict_label(key)}: {verdict.why}"
    return f"{text} (hilcell explain {code})"


def print_dry_run(cell: Cell, procedure: Procedure, plan: Plan, *, as_json: bool) -> None:
    """Print the plan: steps, points and duration."""
    if as_json:
        body = {
            "procedure": procedure.name,
            "cell": cell.name,
            "digest": cell.digest,
            "simulated": cell.simulation is not None,
            "rail": cell.has_rail,
            "steps": msgspec.to_builtins(plan.steps),
            "points": plan.points,
            "duration_s": plan.duration_s,
        }
        print_json({"run": None, "seq": 1, "kind": "plan"} | body)
        end = {"run": None, "seq": 2, "kind": "end", "state": "idle", "exit": 0}
        print_json(end | {"result": body})
        return
    columns = (
        Column[PlannedStep]("step", attrgetter("name")),
        Column[PlannedStep]("points", attrgetter("points"), form="d"),
        Column[PlannedStep]("minutes", lambda step: step.duration_s / 60, form=".1f"),
    )
    print_table(Table(columns, [*plan.steps, PlannedStep("all", plan.points, plan.duration_s)]))
    for note in plan.notes:
        print_message(note)
    print_warnings(plan)


def print_warnings(plan: Plan) -> None:
    for warning in plan.warnings:
        print_message(f"warning: {warning}")
