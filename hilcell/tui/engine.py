"""Starts engines: processes of their own, which outlive the screen that started them."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from signal import SIGTERM
from typing import Any

import msgspec

from hilcell.errors import HilcellError

WORDS = "engine.log"
MOST_LINES = 7  # of them are shown
UNTOLD = {  # exits that the journal may not tell of
    -SIGTERM: "stopped before anything moved",
    2: "refused",
    5: "a defect of hilcell; please report it",
    6: "another run holds the cell",
    7: "the journal cannot be written; make room on the disk, or mend the folder's rights",
}
HILCELL = (sys.executable, "-m", "hilcell")


@dataclass(frozen=True, slots=True)
class Order:
    """What is asked for in the form."""

    cell: str
    procedure: str
    operator: str = ""
    job: str = ""
    seed: str = "1"
    speed: str = ""
    attended: bool = True
    settings: tuple[str, ...] = ()

    def words(self) -> list[str]:
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


def start(runs: Path, run: str, words: Sequence[str]) -> subprocess.Popen[bytes]:
    """Start an engine in a session of its own; what it says goes to a file in the run's folder.

    Raises `HilcellError` where nothing can be written there.
    """
    folder = runs / run
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / WORDS).open("ab") as said:
            return subprocess.Popen(  # noqa: S603 - our own interpreter, words never reach a shell
                [*HILCELL, *words],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=said,
                start_new_session=True,
            )
    except OSError as error:
        raise HilcellError(f"no engine was started: {folder}: {error.strerror}") from error


def untold(folder: Path, code: int) -> str:
    """Return what the journal may not tell of an engine's end; nothing where it does."""
    from hilcell.runs import JOURNAL  # not for the first screen

    if code not in UNTOLD and (folder / JOURNAL).is_file():
        return ""
    said = _last_words(folder) or UNTOLD.get(code, "without a word")
    return f"the engine ended, exit {code}: {said}"


def _last_words(folder: Path) -> str:
    try:
        said = (folder / WORDS).read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        return str(error)
    return "\n".join(said.strip().splitlines()[-MOST_LINES:])


async def ask_hilcell(*words: str) -> str:
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
        raise HilcellError(said.removeprefix("hilcell: "))
    return out.decode(errors="replace") + err.decode(errors="replace")


async def dry_run(order: Order) -> dict[str, Any]:
    """Return the plan of an order; raises `HilcellError` with every refusal."""
    text = await ask_hilcell(*order.words(), "--dry-run", "--json")
    plan: dict[str, Any] = msgspec.json.decode(text.splitlines()[0], type=dict[str, Any])
    return plan
