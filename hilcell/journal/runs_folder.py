"""The default folder of runs: one for each user; ``HILCELL_RUNS`` names another."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

OVERRIDE = "HILCELL_RUNS"


def usual_runs(environment: Mapping[str, str]) -> tuple[Path, str]:
    """Return the folder of runs without ``--runs`` and a warning, "" for none.

    The user's data follow the XDG base directory specification.
    """
    if named := environment.get(OVERRIDE):
        return at_home(Path(named)), ""
    data = Path(environment.get("XDG_DATA_HOME", ""))
    if not data.is_absolute():  # to be ignored
        home = environment.get("HOME", "") or os.path.expanduser("~")  # noqa: PTH111 - never raises
        data = Path(home, ".local", "share")
    if data.is_absolute():
        return data / "hilcell" / "runs", ""
    here = Path("runs")
    return (
        here,
        f"no home directory: runs are in {here.resolve()}; set {OVERRIDE} to change it",
    )


def at_home(folder: Path) -> Path:
    with suppress(RuntimeError):  # no home, or an unknown user
        return folder.expanduser()
    return folder


def command_on(run: Path, command: str, *words: str) -> str:
    """Return a command of hilcell on the run of a folder, as a shell takes it."""
    return command_in(run.parent, command, run.name, *words)


def command_in(runs: Path, *words: str) -> str:
    """Return a command of hilcell with a folder of runs, as a shell takes it."""
    line = shlex.join(["hilcell", *words])
    there = usual_runs(os.environ)[0].resolve() == runs.resolve()
    return line if there else f"{line} --runs {shlex.quote(str(runs))}"
