from __future__ import annotations

import pytest

from hilcell.cell.file import Cell, load_cell


class DeviceTime:
    """The real time of a simulated controller, which the test drives."""

    def __init__(self) -> None:
        self.at_s = 0.0

    def now_s(self) -> float:
        return self.at_s


def station_cell(*, serial: bool, prism_mm: float = 0.0) -> Cell:
    """Return the paper's cell with a total station, on a serial line or on TCP."""
    channel = "/dev/ttyUSB0" if serial else "socket://127.0.0.1:1212"
    return load_cell(
        "paper",
        {
            "tracker.driver": "leica-geocom",
            "tracker.options.channel": channel,
            "tracker.options.prism_constant_mm": str(prism_mm),
        },
    )


@pytest.fixture(scope="session")
def cell() -> Cell:
    return load_cell("paper")


@pytest.fixture
def device_time(monkeypatch: pytest.MonkeyPatch) -> DeviceTime:
    """Return the time of the life timers that are made later."""
    time = DeviceTime()
    monkeypatch.setattr("fakes.time.DeviceTime", lambda: time)
    return time
