"""The simulated drive in another unit of speed, by a clock: how far its slide gets.

Both sides' time passes at a quarter of its speed, so that other work on the PC delays a stop by a
quarter as well.
"""

from __future__ import annotations

import math
import threading
from typing import Any

import pytest

from drivers.canopen.rail import CanopenRail
from fakes.canopen.rail_server import RailDrive
from hilcell.clock import WallClock
from tests.drivers.peers import figure, refusal
from tests.fakes.rail_bench import served

pytestmark = pytest.mark.wall
PACE = 0.25


class SlowClock(WallClock):
    """Real time, slowed down as the simulated rail's is."""

    def __init__(self) -> None:
        super().__init__(threading.Event())

    def now_s(self) -> float:
        return PACE * super().now_s()

    def pc_s(self) -> float:
        return PACE * super().pc_s()

    def wait(self, duration_s: float) -> None:
        super().wait(duration_s / PACE)


def speaks(drive: RailDrive, unit: float, most: float, ramp: float) -> None:
    """Let 6081h, 6083h and 606Ch be in ``unit`` counts/s; the motor has its limits in counts."""
    number = drive.dictionary.number

    def start(target: int) -> None:
        drive._target, drive._reached, drive._busy = target, False, True
        gap = target - drive._position()
        drive._direction = round(math.copysign(1, gap))
        speed, acceleration = min(unit * number(0x6081), most), min(unit * number(0x6083), ramp)
        end_mm = drive._slide.encoder_mm + gap / 1000.0
        drive._rail.move(end_mm, speed / 1000.0, acceleration / 1000.0)

    vars(drive)["_start"] = start
    shown = drive.dictionary.entry(0x606C, 0)
    shown.read = lambda: round(drive._slide.velocity_mm_s * 1000.0 / unit)


@pytest.mark.parametrize("unit", [10_000 / 60, 0.1])
def test_the_slide_is_stopped_and_at_rest_within_50_mm(unit: float) -> None:
    with served(speed=PACE) as bench:
        speaks(bench.server._drive, unit, most=500_000.0, ramp=2_000_000.0)
        options: dict[str, Any] = {
            "channel": f"socket://127.0.0.1:{bench.server.port}",
            "travel_min_mm": 0.0,
            "travel_max_mm": 3000.0,
            "speed_mm_s": 250.0,
            "acceleration_mm_s2": 200.0,
        }
        rail = CanopenRail(CanopenRail.Options(**options), SlowClock())
        rail.connect()
        began_mm = bench.rail.slide_mm()
        found = refusal(lambda: rail.move_to(2000.0))
        assert found.code == "HC-R46"
        assert figure(found, "factor") == pytest.approx(unit, rel=0.2)
        rail.close()
        assert bench.rail.at_rest
        assert 0.1 < abs(bench.rail.slide_mm() - began_mm) < 50.0
