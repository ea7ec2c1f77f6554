"""One run of 30 simulated days: does its memory grow, does a point take longer and longer?

A case is a point: the robot goes to a vertex, the tracker measures, the cell's clock goes on by its
share of the days. An engine in a process of its own says after every point how much memory is
resident and how much processor it has taken.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.stop import running
from campaigns.spread import print_table
from hilcell.calibration.grid import grid_of
from hilcell.cell.devices import start_simulation
from hilcell.cell.file import Cell, load_cell
from hilcell.geometry.frames import matrix
from hilcell.journal.log import Log
from hilcell.model.plan import PlannedStep
from hilcell.model.point import PointId
from hilcell.run.cell_session import CellSession

COUNT = 5000
DAYS = 30.0
DAY_S = 86400.0
WARM_UP = 500  # points, until caches are filled and code is loaded
SHARE = 10  # of the points: so many make one row of the table
MOST_GROWTH_MB = 5.0
MOST_SLOWER = 1.1  # last points against first, in processor time


class Usage(NamedTuple):
    """What the engine has taken when a point was durable."""

    points: int
    resident_mb: float
    processor_s: float


class Month:
    """A part that measures vertices, again and again."""

    name = "month"
    needs = moves = measures = yields = ""

    def __init__(self, points: int) -> None:
        self._points = points

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        return PlannedStep(self.name, self._points, 0.0)

    def result(self, log: Log) -> dict[str, Any]:
        return {}

    def perform(self, session: CellSession) -> None:
        cell = session.cell
        session.reach("connect")
        session.home_rail()
        session.reach("reference")
        session.frame_world()
        station = cell.reference
        session.hold_station(station)
        vertices_mm = grid_of(cell).serpentine_mm()
        poses = matrix(cell.grid.centre.matrix()[:3, :3], vertices_mm)
        joints_rad = cell.robot.nominal().joints_for(poses)
        for number in range(self._points):
            at_rad = joints_rad[number % len(joints_rad)]
            session.flange_point(PointId("day", number=number), station, at_rad)
            session.clock.wait(DAYS * DAY_S / self._points)
            print(json.dumps([number + 1, resident_mb(), time.process_time()]), flush=True)


def resident_mb() -> float:
    """Return how much memory of this process is resident."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def engine(points: int) -> int:
    """Run a month; the usage after each point goes to stdout."""
    cell = load_cell("paper")
    simulated = start_simulation(cell, seed=1, speed=math.inf)
    assert simulated is not None
    with (
        closing(simulated),
        tempfile.TemporaryDirectory(prefix="days-") as folder,
        running(
            cell, simulated, simulated.options, Path(folder), Month(points), unattended=True
        ) as runner,
    ):
        return runner.run()


def campaign(points: range) -> int:
    """Measure so many points in a run of 30 days, and print what they take."""
    done = subprocess.run(
        [sys.executable, "-m", "campaigns.days", str(len(points))],
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    usage = [Usage(*json.loads(line)) for line in done.stdout.splitlines()]
    if done.returncode or len(usage) != len(points):
        print(f"WRONG the run ended with {done.returncode} after {len(usage)} points")
        return 1
    return 0 if report(usage) else 1


def report(usage: Sequence[Usage]) -> bool:
    """Print the figures; return whether memory and processor stay."""
    size = max(1, len(usage) // SHARE)
    rows = []
    for first in range(0, len(usage) - size + 1, size):
        part = usage[first : first + size]
        rows.append((part[-1].points, f"{part[-1].resident_mb:.1f}", f"{_each_ms(part):.2f}"))
    print_table(("points", "resident MB", "processor ms a point"), rows)
    warm = usage[min(WARM_UP, len(usage) // SHARE) :]
    grown_mb = warm[-1].resident_mb - warm[0].resident_mb
    share = max(2, len(warm) // SHARE)
    slower = _each_ms(warm[-share:]) / _each_ms(warm[:share])
    print(
        f"{DAYS:.0f} days, {len(usage)} points: resident memory grew by {grown_mb:.1f} MB after "
        f"{warm[0].points} points (wanted <= {MOST_GROWTH_MB}), processor a point times "
        f"{slower:.2f} (wanted <= {MOST_SLOWER})"
    )
    return bool(grown_mb <= MOST_GROWTH_MB and slower <= MOST_SLOWER)


def _each_ms(part: Sequence[Usage]) -> float:
    """Return the median of the processor time between two points."""
    return float(np.median(np.diff([each.processor_s for each in part])) * 1e3)


if __name__ == "__main__":
    sys.exit(engine(int(sys.argv[1])))
