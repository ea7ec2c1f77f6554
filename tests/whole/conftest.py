"""One run of the whole paper, which every test of it shares."""

from __future__ import annotations

import fcntl
import json
import os
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from hilcell.report.facts import read_facts
from hilcell.run.log import Log
from tests.whole.bench import HILCELL, events

LIMIT_S = 170.0


@dataclass(frozen=True)
class PaperRun:
    """A finished run: what it printed, line by line, and its journal as read again.

    Tests copy what they change.
    """

    events: list[dict[str, Any]]
    errors: str
    log: Log

    @property
    def end(self) -> dict[str, Any]:
        return self.events[-1]

    @property
    def result(self) -> dict[str, Any]:
        result: dict[str, Any] = self.end["result"]
        return result


@pytest.fixture(scope="session")
def paper(tmp_path_factory: pytest.TempPathFactory) -> PaperRun:
    """Return the run of seed 2, made once for all workers of a test run."""
    own = tmp_path_factory.getbasetemp()
    shared = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own
    made = shared / "paper.json"
    with (shared / "paper.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not made.exists():
            made.write_text(json.dumps(_run(shared / "paper-runs")))
    told, errors = json.loads(made.read_text())
    printed = events(told)
    assert printed, errors
    return PaperRun(printed, errors, read_facts(shared / "paper-runs" / printed[0]["run"]).log)


def _run(runs: Path) -> tuple[str, str]:
    done = subprocess.run(
        [*HILCELL, "run", "paper", "--json", "--unattended", "--seed", "2", "--runs", str(runs)],
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    return done.stdout, done.stderr
