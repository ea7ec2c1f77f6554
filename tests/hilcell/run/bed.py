"""A runner on desk devices, run in a thread so that a test can command it."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from hilcell.cell.devices import Devices
from hilcell.cell.file import Cell, load_cell
from hilcell.journal.journal import Record, read_journal
from hilcell.journal.log import Log, RunJournal
from hilcell.journal.runs import EngineFile
from hilcell.ports import NoReading
from hilcell.run.cell_session import CellSession
from hilcell.run.order import Attendance
from hilcell.run.procedure import Procedure
from hilcell.run.run_plan import Changes, RunPlan
from hilcell.run.runner import Runner
from tests.hilcell.run.rig import (
    DeskClock,
    DeskRail,
    DeskRobot,
    DeskTracker,
    Points,
    desk,
    procedure,
)

NO_CHANGES = Changes()
QUICK = {"settle.robot_s": "0.0", "settle.rail_s": "0.0", "plan.unattended_wait_s": "0"}
CELL = load_cell("paper", QUICK)
PLAN = {
    "procedure": "desk", "cell": {}, "digest": "", "seed": 1, "machine_seed": 1,
    "cell_file": "paper", "replayed": False, "speed": None, "unattended": True,
    "operator": "", "job": "", "simulated": True, "versions": {}, "settings": {}, "steps": [],
    "points": 3, "duration_s": 1.0,
}  # fmt: skip


class Bed:
    """One run's journal and devices, through several sessions."""

    def __init__(
        self,
        folder: Path,
        *,
        unattended: bool = True,
        ordered: bool = False,
        cell: Cell = CELL,
    ) -> None:
        self.path = folder / "journal.sqlite"
        self.cell = cell
        self.clock = DeskClock()
        self.devices: Devices = desk(cell, self.clock)
        self.unattended, self.ordered = unattended, ordered

    @property
    def tracker(self) -> DeskTracker:
        assert isinstance(self.devices.tracker, DeskTracker)
        return self.devices.tracker

    @property
    def rail(self) -> DeskRail:
        assert isinstance(self.devices.rail, DeskRail)
        return self.devices.rail

    @property
    def robot(self) -> DeskRobot:
        assert isinstance(self.devices.robot, DeskRobot)
        return self.devices.robot

    def open_journal(self) -> None:
        """Begin the run's journal, or open it again."""
        fresh = not self.path.exists()
        self.journal = RunJournal(self.path, "r", create=fresh)
        if fresh:
            self.journal.append("plan", "", PLAN | {"cell": msgspec.to_builtins(self.cell)})

    def runner(self, what: Procedure, changes: Changes = NO_CHANGES) -> Runner:
        self.open_journal()
        self.clock.stop = threading.Event()
        folder = self.path.parent
        return Runner(
            RunPlan(folder=folder, cell=self.cell, procedure=what, points=0, changes=changes),
            Attendance(unattended=self.unattended, screen=self.ordered),
            self.journal,
            devices=self.devices,
            clock=self.clock,
            stop=self.clock.stop,
        )

    def run(self, what: Procedure, changes: Changes = NO_CHANGES) -> int:
        code = self.runner(what, changes).run()
        self.journal.close()
        return code

    def fault_of(self, act: Callable[[CellSession, int], None]) -> str:
        """Return the code of the fault that ends a run of ``act``; "" where none does."""
        self.run(procedure(Points(1, act)))
        end = self.log().end
        assert end is not None
        return str(end.error.get("code", ""))

    def log(self) -> Log:
        return Log(read_journal(self.path))

    def records(self, kind: str) -> list[Record]:
        return [record for record in read_journal(self.path) if record.kind == kind]

    def states(self) -> list[str]:
        return [r.body["to"] for r in self.records("state") if r.body["machine"] == "run"]

    def entered(self, state: str) -> list[dict[str, Any]]:
        """Return the records by which the run came to a state."""
        return [r.body for r in self.records("state") if r.body["to"] == state]

    def asked(self) -> list[dict[str, Any]]:
        """Return what suspended the run."""
        return self.entered("suspended")

    def events(self, what: str) -> list[dict[str, Any]]:
        return [record.body for record in self.log().events if record.body["what"] == what]


class Live:
    """A run under way; leaving the block waits for its end."""

    def __init__(self, bed: Bed, what: Procedure) -> None:
        self.bed, self.runner = bed, bed.runner(what)
        self.code = -1
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        self.code = self.runner.run()

    def __enter__(self) -> Live:
        self._thread.start()
        return self

    def __exit__(self, kind: object, *rest: object) -> None:
        if kind is not None:
            self.runner.stop()
        self._thread.join()
        self.bed.journal.close()

    def status(self, key: str) -> Any:
        return msgspec.to_builtins(self.runner.status())[key]

    def until(self, key: str, value: object) -> None:
        until(lambda: self.status(key) == value)


class Screen:
    """A connection that stays open."""

    def __init__(self, folder: Path) -> None:
        file = msgspec.json.decode((folder / "engine.json").read_bytes(), type=EngineFile)
        self.link = socket.socket(socket.AF_UNIX)
        self.link.connect(file.socket)
        self.lines = self.link.makefile("rb")

    def ask(self, command: str, **facts: str) -> dict[str, Any]:
        return self.raw(msgspec.json.encode({"command": command} | facts) + b"\n")

    def raw(self, line: bytes) -> dict[str, Any]:
        self.link.sendall(line)
        return msgspec.json.decode(self.lines.readline(), type=dict[str, Any])

    def close(self) -> None:
        self.lines.close()
        self.link.close()


def until(condition: Callable[[], bool]) -> None:
    """Verification until something is so: what another thread does tells nobody."""
    looks = threading.Event()
    while not condition():
        looks.wait(0.001)  # lets the other thread work


def waiting(limit_s: float) -> Cell:
    """The cell, where an unattended run waits so long."""
    plan = msgspec.structs.replace(CELL.plan, unattended_wait_s=limit_s)
    return msgspec.structs.replace(CELL, plan=plan)


def broken_beam(times: int, *, after: int = 0, code: str = "HC-T10") -> Callable[[], None]:
    """Return an answer of the tracker that fails so many times, ``after`` good ones."""
    left, good = [times], [after]

    def answer() -> None:
        if good[0]:
            good[0] -= 1
        elif left[0]:
            left[0] -= 1
            fields = {"searched_mm": 50.0} if code == "HC-T11" else {}
            raise NoReading(code, "Tracker", "measure", "beam broken", fields=fields)

    return answer
