from __future__ import annotations

import pytest

from hilcell.cell.file import Cell, load_cell


class OwnTime:
    """The real time of a simulated controller, which the test drives."""

    def __init__(self) -> None:
        self.at_s = 0.0

    def now_s(self) -> float:
        return self.at_s


@pytest.fixture(scope="session")
def cell() -> Cell:
    return load_cell("paper")


@pytest.fixture
def own_time(monkeypatch: pytest.MonkeyPatch) -> OwnTime:
    """Return the time of the life timers that are made later."""
    time = OwnTime()
    monkeypatch.setattr("fakes.time.OwnTime", lambda: time)
    return time
