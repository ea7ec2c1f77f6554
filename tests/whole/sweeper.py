"""An engine that makes one sweep: ``python -m tests.whole.sweeper CONTROL FOLDER X Y Z``."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from hilcell.cell.devices import build_devices, connect_all, start_simulation
from hilcell.cell.file import load_cell
from hilcell.journal.log import RunJournal
from hilcell.ports import Array, Clock
from hilcell.run.cell_session import CellSession
from hilcell.run.mover import SweepCommand
from hilcell.run.prompts import NO_CHOICES
from hilcell.run.stopping import SafeStop, close_all

START_RAD = np.radians([-10.0, -100.0, 110.0, 5.0, 40.0, 20.0])
KEY = "sweep/A1/up"


class Watched:
    """The cell's clock; ``wait`` calls ``after`` with how often it was called."""

    def __init__(self, clock: Clock, after: Callable[[int], None]) -> None:
        self._clock, self._after, self._count = clock, after, 0
        self.now_s, self.pc_s, self.check = clock.now_s, clock.pc_s, clock.check

    def wait(self, duration_s: float) -> None:
        self._clock.wait(duration_s)
        self._count += 1
        self._after(self._count)


def order(near_mm: Array, degrees: float = 4.0) -> SweepCommand:
    end_rad = float(START_RAD[0] + np.radians(degrees))
    return SweepCommand(KEY, START_RAD, 0, end_rad, float(np.radians(1.0)), near_mm, 100.0)


class Engine:
    """A session on the devices of a simulated cell, with its own journal and safe stop."""

    def __init__(self, control: str, folder: Path, stack: ExitStack) -> None:
        self.stop = threading.Event()
        cell = load_cell("paper", {"simulation.address": control})
        simulated = start_simulation(cell, seed=1, speed=np.inf)
        assert simulated is not None
        stack.callback(simulated.close)
        clock = simulated.clock(self.stop)
        self.devices = build_devices(cell, simulated.options, clock)
        self.safe_stop = SafeStop(self.devices)
        stack.callback(self.safe_stop.dismiss)
        stack.callback(close_all, self.devices)
        connect_all(self.devices, lambda found: None)
        path = folder / "journal.sqlite"
        journal = RunJournal(path, "r", create=not path.exists())
        stack.callback(journal.close)
        self.log = journal.log
        self.at_wait = 0
        self.then: Callable[[], object] = lambda: None
        self.bench = CellSession(
            cell,
            self.devices,
            Watched(clock, self._waited),
            journal,
            checkpoint=clock.check,
            ask=lambda prompt, verify, cause, choices=NO_CHOICES: verify(),
        )

    def stop_all(self) -> None:
        self.stop.set()
        self.safe_stop.trigger()

    def _waited(self, count: int) -> None:
        if count == self.at_wait:
            self.then()


@contextmanager
def engine(control: str, folder: Path) -> Iterator[Engine]:
    with ExitStack() as stack:
        yield Engine(control, folder, stack)


def main() -> None:

    control, folder, *near = sys.argv[1:]
    with engine(control, Path(folder)) as found:
        found.bench.sweep(order(np.array(near, dtype=float), 150.0))


if __name__ == "__main__":
    main()
