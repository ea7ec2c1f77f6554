"""Starts engines: processes of their own, which outlive the screen that started them."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from signal import SIGTERM
from typing import Any, BinaryIO

import msgspec

from hilcell.errors import HilcellError

REASON = "hilcell: "
MOST_LINES = 7  # of an engine's last words are shown
EXIT_REASONS = {  # exits that the journal may not tell of
    -SIGTERM: "stopped before anything moved",
    2: "refused",
    5: "a defect of hilcell; please report it",
    6: "another run holds the cell",
    7: "the journal cannot be written; make room on the disk, or mend the folder's rights",
}
HILCELL = (sys.executable, "-m", "hilcell")


@dataclass(frozen=True, slots=True)
class RunRequest:
    """What is asked for in the form."""

    cell: str
    procedure: str
    operator: str = ""
    job: str = ""
    seed: str = "1"
    speed: str = ""
    attended: bool = True
    settings: tuple[str, ...] = ()

    def arguments(self) -> list[str]:
        """Return the command line of `hilcell run`."""
        words = ["run", self.procedure, "--cell", self.cell, "--seed", self.seed]
        for option, value in (
            ("--operator", self.operator),
            ("--job", self.job),
            ("--speed", self.speed),
        ):
            words += [f"{option}={value}"] if value else []
        for setting in self.settings:
            words += ["--set", setting]
        return words if self.attended else [*words, "--unattended"]


@dataclass(frozen=True, slots=True)
class StartedEngine:
    """An engine that this screen has started, and the file that it alone speaks to."""

    process: subprocess.Popen[bytes]
    log_file: Path

    def wait_for_end(self) -> str:
        """Wait for the engine's end; return what the journal may not tell of it, else nothing."""
        from hilcell.journal.runs import JOURNAL  # not for the first screen

        code = self.process.wait()
        if code not in EXIT_REASONS and (self.log_file.parent / JOURNAL).is_file():
            return ""
        reason = _last_reason(self.log_file) or EXIT_REASONS.get(code, "without a word")
        return f"the engine ended, exit {code}: {reason}"


def start_engine(runs: Path, run: str, words: Sequence[str]) -> StartedEngine:
    """Start an engine in a session of its own; what it says goes to a file in the run's folder.

    Raises `HilcellError` where nothing can be written there.
    """
    folder = runs / run
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with _new_file(folder) as said:
            process = subprocess.Popen(  # noqa: S603 - our own interpreter, words reach no shell
                [*HILCELL, *words, "--screen"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=said,
                start_new_session=True,
            )
            return StartedEngine(process, Path(said.name))
    except OSError as error:
        raise HilcellError(f"no engine was started: {folder}: {error.strerror}") from error


def _new_file(folder: Path) -> BinaryIO:
    """Open a file that nobody else writes: two screens may resume one run at a time."""
    for number in count(1):
        with suppress(FileExistsError):
            return (folder / f"engine-{number}.log").open("xb")
    raise AssertionError("numbers never end")


def _last_reason(log_file: Path) -> str:
    """Return the reason that an engine gave last, without what it reported before."""
    try:
        lines = log_file.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    except OSError:
        return ""  # the run's folder is gone, or its disk
    reasons = [number for number, line in enumerate(lines) if line.startswith(REASON)]
    last = lines[reasons[-1] :][:MOST_LINES] if reasons else lines[-MOST_LINES:]
    return "\n".join(last).removeprefix(REASON)


async def run_command(*words: str) -> str:
    """Run a command that moves nothing and return what it said; raises `HilcellError`."""
    process = await asyncio.create_subprocess_exec(
        *HILCELL,
        *words,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    out, err = await process.communicate()
    if process.returncode:
        said = err.decode(errors="replace").strip() or out.decode(errors="replace").strip()
        said = said.rpartition("error: ")[2] if said.startswith("usage: ") else said
        raise HilcellError(said.removeprefix(REASON))
    return out.decode(errors="replace") + err.decode(errors="replace")


async def dry_run(request: RunRequest) -> dict[str, Any]:
    """Return the plan of an request; raises `HilcellError` with every refusal."""
    text = await run_command(*request.arguments(), "--dry-run", "--json")
    plan: dict[str, Any] = msgspec.json.decode(text.splitlines()[0], type=dict[str, Any])
    return plan
