"""The folder of runs where none is named: one for each user, whatever the current directory.

``HILCELL_RUNS`` names another.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

OVERRIDE = "HILCELL_RUNS"
HERE = Path("runs")
XDG = "XDG_DATA_HOME"
XDG_USUAL = Path(".local", "share")


class RunsFolder(NamedTuple):
    """``note`` says why it is not the user's own, where nobody has asked for it."""

    path: Path
    note: str = ""


def usual_runs(environment: Mapping[str, str]) -> RunsFolder:
    """Return the folder of runs that holds without ``--runs``."""
    if named := environment.get(OVERRIDE):
        return RunsFolder(at_home(Path(named)))
    own = _data_home(environment)
    if own is None:
        return RunsFolder(
            HERE, f"this user has no home: runs are in {HERE.resolve()}; {OVERRIDE} names others"
        )
    return RunsFolder(own / "hilcell" / "runs")


def at_home(folder: Path) -> Path:
    """Return a folder with the ``~`` at its begin expanded, which only shells do."""
    with suppress(RuntimeError):  # no home, or a user that there is not
        return folder.expanduser()
    return folder


def runs_option(runs: Path) -> str:
    """Return what a command needs, with a blank before it, to find runs; "" where it does."""
    usual = usual_runs(os.environ).path
    return "" if usual.resolve() == runs.resolve() else f" --runs {shlex.quote(str(runs))}"


def command_on(run: Path, command: str, *words: str) -> str:
    """Return a command of hilcell on the run of a folder, as a shell takes it."""
    line = shlex.join(["hilcell", command, run.name, *words])
    return line + runs_option(run.parent)


def _data_home(environment: Mapping[str, str]) -> Path | None:
    """Return the user's folder of data by the XDG base directory specification, if there is one."""
    stated = Path(environment.get(XDG, ""))
    if stated.is_absolute():  # others are to be ignored
        return stated
    home = Path(environment.get("HOME", "") or os.path.expanduser("~"))  # noqa: PTH111 - never raises
    return home / XDG_USUAL if home.is_absolute() else None
