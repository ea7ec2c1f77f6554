"""Work apart from the screen's thread: engines, commands, threads, full garbage collections.

An engine is a process of its own and outlives the screen that started it. Threads are daemons:
asyncio joins its own when a program ends, so one that waits for an engine would keep a closed
screen's process alive.
"""

from __future__ import annotations

import asyncio
import contextvars
import gc
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from signal import SIGTERM
from typing import BinaryIO, ClassVar, ParamSpec, TypeVar

import msgspec

from hilcell.decoding import decoded
from hilcell.errors import HilcellError
from hilcell.language import marked, tr
from hilcell.model.plan import PlannedStep
from hilcell.run.order import Order

REASON = "hilcell: "
HILCELL = (sys.executable, "-m", "hilcell")


@dataclass(frozen=True, slots=True)
class StartedEngine:
    """An engine that this screen has started, and its log file."""

    MOST_LINES: ClassVar = 7  # of an engine's log are shown
    EXIT_REASONS: ClassVar = {  # exits that the journal may not hold
        -SIGTERM: marked("stopped before anything moved"),
        2: marked("refused"),
        5: marked("a defect of hilcell; please report it"),
        6: marked("another run holds the cell"),
        7: marked(
            "the journal cannot be written; make room on the disk, or mend the folder's rights"
        ),
    }

    process: subprocess.Popen[bytes]
    log_file: Path

    def wait_for_end(self) -> str:
        """Wait for the engine's end; return the reason where the journal may not hold it."""
        from hilcell.journal.runs import JOURNAL  # not for the first screen

        code = self.process.wait()
        recorded = (self.log_file.parent / JOURNAL).is_file()
        if code not in self.EXIT_REASONS and recorded:
            return ""
        reason = self._last_reason() or tr(self.EXIT_REASONS.get(code, marked("no reason given")))
        if recorded:  # the alarm has the details; under it one line is enough
            reason = reason.partition("\n")[0].rstrip(" :")
        return tr("the engine ended, exit {code}: {reason}", code=code, reason=reason)

    @staticmethod
    def new_log(folder: Path) -> BinaryIO:
        """Open a new file: two screens may resume one run at a time."""
        for number in count(1):
            with suppress(FileExistsError):
                return (folder / f"engine-{number}.log").open("xb")
        raise AssertionError("numbers never end")

    def _last_reason(self) -> str:
        try:
            lines = self.log_file.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        except OSError:
            return ""  # the run's folder is gone, or its disk
        reasons = [number for number, line in enumerate(lines) if line.startswith(REASON)]
        last = lines[reasons[-1] :][: self.MOST_LINES] if reasons else lines[-self.MOST_LINES :]
        return "\n".join(last).removeprefix(REASON)


def start_engine(runs: Path, run: str, arguments: Sequence[str]) -> StartedEngine:
    """Start an engine in a process session of its own; its log goes to the run's folder.

    Raises `HilcellError` where nothing can be written there.
    """
    folder = runs / run
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with StartedEngine.new_log(folder) as log:
            process = subprocess.Popen(  # noqa: S603 - our own interpreter, no shell reads the arguments
                [*HILCELL, *arguments, "--screen"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=log,
                start_new_session=True,
            )
            return StartedEngine(process, Path(log.name))
    except OSError as error:
        raise HilcellError(f"no engine was started: {folder}: {error.strerror}") from error


async def run_command(*arguments: str) -> str:
    """Run a command that moves nothing and return its output; raises `HilcellError`."""
    process = await asyncio.create_subprocess_exec(
        *HILCELL,
        *arguments,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    out, err = await process.communicate()
    if process.returncode:
        reason = err.decode(errors="replace").strip() or out.decode(errors="replace").strip()
        words, _, hint = reason.partition("\n")
        if hint.endswith("--help` lists all arguments"):  # of a command line
            reason = words.partition(": ")[2].removeprefix("argument --")  # the field's name
        raise HilcellError(reason.removeprefix(REASON))
    return out.decode(errors="replace") + err.decode(errors="replace")


class DryRun(msgspec.Struct, frozen=True, kw_only=True):
    """A plan as `hilcell run --dry-run --json` prints it."""

    procedure: str
    cell: str  # its name
    simulated: bool
    rail: bool
    steps: list[PlannedStep]
    points: int
    duration_s: float  # of the cell's time


async def dry_run(order: Order) -> DryRun:
    """Return the plan of an order; raises `HilcellError` with every refusal."""
    text = await run_command("run", *order.replace(dry_run=True, json=True).command_line())
    return decoded(text.splitlines()[0], DryRun)


P = ParamSpec("P")
T = TypeVar("T")


async def run_in_thread(work: Callable[P, T], *args: P.args, **facts: P.kwargs) -> T:
    """Return what a function returns, or raise what it raises.

    The work is done also where it was given up before its thread ran: it may be a stop.
    """
    future: Future[T] = Future()

    def run() -> None:
        awaited = future.set_running_or_notify_cancel()
        try:
            result = work(*args, **facts)
        except Exception as error:  # noqa: BLE001 - raised where it is awaited
            if awaited:
                future.set_exception(error)
        else:
            if awaited:
                future.set_result(result)

    language = contextvars.copy_context().run
    threading.Thread(target=language, args=(run,), name="run_in_thread", daemon=True).start()
    return await asyncio.wrap_future(future)


class GarbageCollector:
    """Takes whole collections over from the interpreter until `end`."""

    PERIOD_S = 30.0
    NEVER = 1_000_000_000

    def __init__(self, now_s: float) -> None:
        self._whole_s = now_s
        self._rested = False  # at the tick before
        self._before = gc.get_threshold()
        gc.set_threshold(self._before[0], self._before[1], self.NEVER)
        gc.freeze()  # what was loaded stays

    def tick(self, *, at_rest: bool, now_s: float) -> None:
        """Collect everything, where that may be done now and was not done lately.

        Not at the first tick of a rest: why nothing moves, such as a run's end, is painted first.
        """
        if at_rest and self._rested and now_s - self._whole_s >= self.PERIOD_S:
            self._whole_s = now_s
            gc.collect()
        self._rested = at_rest

    def end(self) -> None:
        gc.unfreeze()
        gc.set_threshold(*self._before)
