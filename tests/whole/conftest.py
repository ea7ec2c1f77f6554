"""One run of the whole paper, which every test of it shares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest

from drivers.canopen.motion_guard import SpeedGuard
from hilcell.journal.log import Log
from hilcell.report.facts import read_facts
from tests.whole.bench import OwnCell, sweep
from tests.whole.golden import GoldenRuns


@dataclass(frozen=True)
class PaperRun:
    """A finished run: its printed lines, and its journal as read again.

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


@pytest.fixture(scope="session", params=["paper", *sweep("paper-whole")])
def paper(request: pytest.FixtureRequest, golden: GoldenRuns) -> PaperRun:
    """Return the run of seed 2, by day with fewer targets."""
    made = golden[request.param]
    assert made.events, made.done.stderr
    return PaperRun(made.events, made.done.stderr, read_facts(made.folder).log)


@pytest.fixture
def own_cell(monkeypatch: pytest.MonkeyPatch) -> OwnCell:
    """Return the simulated cell of the run that is made next."""
    cell = OwnCell()
    monkeypatch.setattr("hilcell.run.engine.start_simulation", cell.start)
    return cell


@pytest.fixture
def faster_than_a_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let simulated devices that a cell file reaches as machines run faster than the PC's clock.

    The guard of a drive's speed compares its positions with that clock, and is told nothing.
    """
    monkeypatch.setattr(SpeedGuard, "add", lambda self, *look: None)
