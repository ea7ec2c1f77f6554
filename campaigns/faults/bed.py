"""One short run on a small simulated cell: its commands, what they print, orders to its engine."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path

from campaigns.faults.cell import ThreadedCell
from campaigns.faults.phases import Event
from drivers.abb import robot_egm as abb_robot
from drivers.abb.http_channel import HttpChannel
from drivers.canopen import drive, nodes
from drivers.kuka import robot as kuka_robot
from drivers.leica.tracker_emscon import LeicaEmsconTracker
from hilcell.errors import HilcellError
from hilcell.journal.runs import JOURNAL
from hilcell.run.control import Command, order
from hilcell.run.device_status import CellMonitor
from tests.whole.bench import SMALL, performed, sets

RUN = "x"
PROCEED_S = 0.08  # a pause is long enough for the devices' readings to be refreshed
KILLED = -9

QUICK = {
    "base_frame.points": "4",
    "layout.nest_samples": "1",
    "tracker.samples": "1",
}


SHORT: tuple[tuple[object, str, float], ...] = (
    (nodes, "FIND_S", 0.5),
    (drive.Drive, "STALL_S", 1.0),
    (abb_robot, "STALL_S", 1.0),
    (abb_robot, "REST_S", 1.0),
    (HttpChannel, "ANSWER_S", 1.0),
    (kuka_robot, "STALL_S", 1.0),
    (kuka_robot, "REST_S", 1.0),
    (LeicaEmsconTracker, "RESULT_S", 0.5),
    (LeicaEmsconTracker, "REPLY_S", 1.0),
    (CellMonitor, "REFRESH_S", 0.02),
)


def hasten(change: Callable[[object, str, float], None] = setattr) -> None:
    """Shorten the patience on a dead wire, in this process."""
    for place, name, value_s in SHORT:
        change(place, name, value_s)


class Bed:
    """The run: its folder, its cell, and all that its commands have printed."""

    def __init__(
        self, folder: Path, cell: ThreadedCell, procedure: str, *, apart: bool = False
    ) -> None:
        """``apart``: the engine is a process of its own, which may be killed."""
        self.folder, self.cell, self.procedure = folder, cell, procedure
        self.cell_file, self.apart = "paper", apart
        self.attended = False
        self.T_W_B: list[list[float]] = []  # true base frame when its last point was measured
        self.values: Mapping[str, str] = {}  # of the cell, beside the usual ones
        self.events: list[Event] = []
        self.exits: list[int] = []
        self.errors = ""
        self.notes: list[str] = []  # of an injection that saw something wrong
        self.process: subprocess.Popen[str] | None = None
        self.on_suspended: Callable[[], None] = lambda: None

    @property
    def run(self) -> Path:
        return self.folder / RUN

    @property
    def journal(self) -> Path:
        return self.run / JOURNAL

    def start(self, hear: Callable[[Event], None]) -> None:
        values = (
            (SMALL if self.procedure == "calibrate" else SMALL | QUICK)
            | {"simulation.address": self.cell.address}
            | dict(self.values)
        )
        words = ["run", self.procedure, "--name", RUN, "--cell", self.cell_file, *sets(values)]
        self._perform(words, hear)

    def resume(self, hear: Callable[[Event], None] = lambda event: None) -> None:
        self._perform(["resume", RUN], hear)

    def order(self, what: Command) -> str:
        """Give the live engine an order; return why that was refused."""
        try:
            order(self.run, what)
        except HilcellError as error:
            return str(error)
        return ""

    def order_soon(self, what: Command) -> None:
        timer = threading.Timer(PROCEED_S, self.order, (what,))
        timer.daemon = True
        timer.start()

    def _perform(self, words: list[str], hear: Callable[[Event], None]) -> None:
        def take(event: Event) -> None:
            self.events.append(event)
            if event["kind"] == "point" and event["id"]["kind"] == "base":
                self.T_W_B = self.cell.simulation.ask(do="truth")["T_W_B"]
            hear(event)

        words += ["--json", "--runs", str(self.folder)]
        words += [] if self.attended else ["--unattended"]
        if self.apart:
            self._perform_apart(words, take)
            return
        done = performed(*words, hear=take)
        self.exits.append(done.returncode)
        self.errors += done.stderr

    def _perform_apart(self, words: list[str], take: Callable[[Event], None]) -> None:
        program, pipe = [sys.executable, "-c", APART, *words], subprocess.PIPE
        self.process = subprocess.Popen(program, stdout=pipe, stderr=pipe, text=True)
        out, err = self.process.stdout, self.process.stderr
        assert out is not None
        assert err is not None
        said: list[str] = []
        reader = threading.Thread(target=lambda: said.append(err.read()), daemon=True)
        reader.start()
        try:
            with out:
                for line in out:
                    if line.endswith("\n"):  # else torn by a kill
                        take(json.loads(line))
        except BaseException:  # of a case that hangs: nobody else ends its engine
            self.process.kill()
            raise
        reader.join()
        err.close()
        self.exits.append(self.process.wait())
        self.errors += said[0]


APART = """
import sys
from hilcell.__main__ import entry
from campaigns.faults.bed import hasten
hasten()
sys.exit(entry())
"""
