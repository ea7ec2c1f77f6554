"""One run of the whole paper, which every test of it shares, and simulated cells."""

from __future__ import annotations

import pytest

from drivers.canopen.motion_guard import SpeedGuard
from tests.whole.bench import OwnCell, sweep
from tests.whole.golden import GoldenRun, GoldenRuns


@pytest.fixture(scope="session", params=["paper", *sweep("paper-whole")])
def paper(request: pytest.FixtureRequest, golden: GoldenRuns) -> GoldenRun:
    """Return the run of seed 2, by day with fewer targets."""
    return golden[request.param]


@pytest.fixture
def own_cell(monkeypatch: pytest.MonkeyPatch) -> OwnCell:
    cell = OwnCell()
    monkeypatch.setattr("hilcell.run.engine.start_simulation", cell.start)
    return cell


@pytest.fixture
def faster_than_a_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let simulated devices that a cell file reaches as machines run faster than the PC's clock.

    The guard of a drive's speed compares its positions with that clock, and is told nothing.
    """
    monkeypatch.setattr(SpeedGuard, "add", lambda self, *look: None)
