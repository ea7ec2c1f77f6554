"""Faces of a run on a terminal: events as JSON lines, or a progress bar and a table.

A face only listens. Whatever happens to it, a closed pipe or a lost terminal, the run goes on.
"""

from __future__ import annotations

import io
import sys
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec

from hilcell.cell.file import Cell
from hilcell.clean import harmless
from hilcell.commands.messages import harmless_lines, tell
from hilcell.errors import facts_of
from hilcell.journal.journal import Record
from hilcell.journal.log import Log
from hilcell.run.procedure import Plan, Procedure, Table

WIDEST = 500  # columns of a table


class Face:
    """Takes every durable record of a run; silent itself."""

    def __init__(self, *, as_json: bool) -> None:
        self.as_json = as_json
        self._lost = False

    def __enter__(self) -> Self:
        """Begin to show."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Cease to show."""

    def already(self, points: int) -> None:
        """Hear how many points a resumed run already has."""

    def close(self, code: int, log: Log, fault: Exception | None) -> None:
        """Say the end where the journal could not take it."""

    def take(self, record: Record) -> None:
        """Show one record; a face that fails is dropped."""
        if not self._lost:
            try:
                self.show(record)
            except (OSError, ValueError):
                self._lost = True

    def show(self, record: Record) -> None:
        """Show one record."""


def json_face(run: str) -> Face:
    """Return the face that prints every record as one line of JSON."""
    return _JsonFace(run)


class _JsonFace(Face):
    def __init__(self, run: str) -> None:
        super().__init__(as_json=True)
        self._run = run

    def show(self, record: Record) -> None:
        self._write(record.event(self._run))

    def close(self, code: int, log: Log, fault: Exception | None) -> None:
        if log.end is None and not self._lost:
            end: dict[str, Any] = {
                "run": self._run,
                "kind": "end",
                "state": log.states["run"],
                "exit": code,
            }
            end |= {"result": {}, "reason": str(fault)}
            end |= {} if fault is None else {"error": facts_of(fault)}
            with suppress(OSError, ValueError):
                self._write(end)

    def _write(self, event: dict[str, Any]) -> None:
        sys.stdout.buffer.write(msgspec.json.encode(event) + b"\n")
        sys.stdout.buffer.flush()


def progress_face(run: str, points: int) -> Face:
    """Return the face that draws a progress bar on stderr."""
    return _ProgressFace(run, points)


class _ProgressFace(Face):
    def __init__(self, run: str, points: int) -> None:
        super().__init__(as_json=False)
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        self._console = Console(stderr=True)
        self._progress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self._console,
        )
        self._task = self._progress.add_task(harmless(run), total=points)

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with suppress(OSError, ValueError):
            self._progress.stop()

    def already(self, points: int) -> None:
        self._progress.advance(self._task, points)

    def show(self, record: Record) -> None:
        body = record.body
        if record.kind == "point" and body["group"] != "control":
            place = f" at {body['station']}" if body["station"] else ""
            text = harmless(f"{body['group']}{place}")
            self._progress.update(self._task, advance=1, description=text)
        elif record.kind == "state" and body["machine"] == "calibration":
            self._say(f"{body['to'].replace('_', ' ')}")
        elif record.kind == "state" and body["to"] in ("paused", "suspended"):
            self._say(f"{body['to']}: {_asked(body)}hilcell resume goes on, ctrl-C stops")
        elif record.kind == "event" and body["what"] == "no reading":
            self._say(f"{body['key']}: {body['reason']} (try {body['tries']})")

    def _say(self, text: str) -> None:
        self._console.print(harmless_lines(text), markup=False, highlight=False)


def print_table(table: Table) -> None:
    """Print a table on stdout, harmless, at its full width: names must stay whole to be copied."""
    from rich.console import Console
    from rich.measure import Measurement
    from rich.table import Table as RichTable

    headers, rows = table
    drawn = RichTable()
    for column, header in enumerate(headers):
        drawn.add_column(harmless(header), justify="left" if column == 0 else "right", no_wrap=True)
    for row in rows:
        drawn.add_row(*map(harmless_lines, row))
    text = io.StringIO()
    wide = Console(file=text, markup=False, highlight=False, width=WIDEST)
    wide.width = Measurement.get(wide, wide.options, drawn).maximum
    wide.print(drawn)
    sys.stdout.write(text.getvalue())


def print_end(
    folder: Path, log: Log, procedure: Procedure, face: Face, fault: Exception | None
) -> None:
    """Say how the run ended: its table on stdout, everything else on stderr."""
    if fault is not None:
        tell(f"hilcell: {fault}")
    if face.as_json:
        return
    if log.end is not None and log.end["result"]:
        with suppress(OSError):  # a run is what it is, also when nobody reads its table
            print_table(procedure.table(log.end["result"]))
            sys.stdout.flush()
    for key, verdict in log.verdicts.items():
        if not verdict["holds"]:
            tell(f"out of tolerance: {key}: {_facts(verdict)}")
    if log.link is not None and log.link.warning:
        tell(f"warning: {log.link.warning}")
    state = log.states["run"]
    ended = state if log.end is not None else f"cut off while {state}"
    tell(f"{kind_of(log)} {folder.name}: {ended}; journal in {folder}")


def kind_of(log: Log) -> str:
    """Return the word for a run: nobody must take a simulated one for a real one."""
    return "SIMULATED run" if log.inputs.simulated else "run"


def _asked(body: dict[str, Any]) -> str:
    """Return what a paused or suspended run waits for, in words that go before what to do."""
    prompt = body.get("prompt")
    if prompt is not None:
        return f"{prompt['title']}. {prompt['text']} When it is done, "
    return f"{body['reason']}; " if "reason" in body else ""


def _facts(verdict: dict[str, Any]) -> str:
    return ", ".join(
        f"{name} {value:.4f}" if isinstance(value, float) else f"{name} {value}"
        for name, value in verdict.items()
        if name != "holds"
    )


def print_dry_run(cell: Cell, procedure: Procedure, plan: Plan, *, as_json: bool) -> None:
    """Print the plan: steps, points and duration."""
    if as_json:
        body = {
            "procedure": procedure.name,
            "cell": cell.name,
            "digest": cell.digest,
            "simulated": cell.simulation is not None,
            "steps": msgspec.to_builtins(plan.steps),
            "points": plan.points,
            "duration_s": plan.duration_s,
        }
        head = {"run": None, "seq": 1, "kind": "plan"}
        end = {"run": None, "seq": 2, "kind": "end", "state": "idle", "exit": 0, "result": body}
        for event in (head | body, end):
            print(msgspec.json.encode(event).decode())
        return
    rows = [[step.name, str(step.points), f"{step.duration_s / 60:.1f}"] for step in plan.steps]
    rows.append(["all", str(plan.points), f"{plan.duration_s / 60:.1f}"])
    print_table((["step", "points", "minutes"], rows))
