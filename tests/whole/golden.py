"""Runs that many tests look at: each is made once, by the worker that needs it first.

Nobody changes a golden run: a test that resumes or retakes works on a copy.
"""

from __future__ import annotations

import fcntl
import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

from hilcell.journal.runs import JOURNAL
from tests.whole.bench import SEATS, SMALL, Ran, command, sets

PAPER = ("--seed", "2", "--unattended")
# Fewer of what the paper's rows average over: they hold all the same.
FEWER = {
    "validation.per_cell": "1",
    "validation.others": "24",
    "survey.step_mm": "400.0",
    "base_frame.points": "12",
    "layout.nest_samples": "2",
    "sweeps.axes": "[1, 2]",
}
POSES = SMALL | {
    "base_frame.points": "5",
    "iso9283.cycles": "4",
    "iso9283.ap_limit_mm": "3",
}
RUNS: dict[str, tuple[str, ...]] = {
    "small": ("calibrate", "--seed", "1", "--operator", "B. Operator", *sets(SMALL)),
    "small-2": ("calibrate", "--seed", "2", *sets(SMALL)),
    "quick": ("calibrate", "--seed", "1"),
    "sign-check": ("sign-check", "--unattended", *sets(SMALL)),
    "seats": ("calibrate", "--cell", "fixed", "--seed", "1", "--unattended", *sets(SMALL | SEATS)),
    "pose-test": ("iso9283", "--cell", "fixed", "--unattended", *sets(POSES)),
    "calibration": ("calibrate", "--full", "--seed", "3"),
    "paper": ("paper", *PAPER, *sets(FEWER)),
    "paper-whole": ("paper", *PAPER),
}


class GoldenRun(Ran):
    """A finished run that tests share."""

    def copied_to(self, runs: Path) -> Path:
        """Copy the run into another folder of runs; return its folder there.

        A worker that reads the journal meanwhile has files beside it, which come and go.
        """
        passing = shutil.ignore_patterns(f"{JOURNAL}-*")
        return Path(shutil.copytree(self.folder, runs / self.folder.name, ignore=passing))


class GoldenRuns:
    """Makes runs in a folder that all workers share."""

    def __init__(self, shared: Path) -> None:
        self._shared = shared

    def __getitem__(self, name: str) -> GoldenRun:
        runs = self._shared / f"golden-{name}"

        def perform() -> str:
            done = command("run", *RUNS[name], "--json", "--name", name, "--runs", str(runs))
            return json.dumps([done.returncode, done.stdout, done.stderr])

        code, out, err = json.loads(once(self._shared / f"golden-{name}.json", perform))
        assert code == 0, f"golden run {name}: {err}"
        return GoldenRun(runs / name, subprocess.CompletedProcess(name, code, out, err))


def once(file: Path, make: Callable[[], str]) -> str:
    """Return the text of a file; the first process that needs it makes it."""
    with file.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not file.exists():
            file.write_text(make())
    return file.read_text()
