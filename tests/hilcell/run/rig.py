"""Devices in memory, for tests of the runner alone: they do what they are told, or hang."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, NoReturn

import numpy as np

from hilcell.cell.devices import Devices
from hilcell.cell.file import Cell
from hilcell.geometry.kinematics import forward
from hilcell.journal.log import Log
from hilcell.model.plan import PlannedStep
from hilcell.model.point import PointId
from hilcell.ports import (
    Air,
    Array,
    Clock,
    Identity,
    LinkStatistics,
    RailReading,
    RailTrace,
    RobotReading,
    Stopped,
    TrackerReading,
)
from hilcell.present.table import Table
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Procedure
from tests.clocks import DrivenClock


class DeskClock(DrivenClock):
    """The clock of a run and of its desk devices; every wait ends at once, and by a stop."""

    def __init__(self) -> None:
        super().__init__(1000.0, 1000.0)  # a reading may be older than the run
        self.stop = threading.Event()

    def wait(self, duration_s: float) -> None:
        super().wait(duration_s)
        self.check()

    def check(self) -> None:
        if self.stop.is_set():
            raise Stopped("a stop was asked for")


class DeskRail:
    def __init__(self, cell: Cell, clock: Clock) -> None:
        self.cell, self.position_mm, self.powered = cell, 1100.0, False
        self.clock = clock
        self.stopped_s: float | None = None
        self.ended_s: float | None = None
        self.closed = 0
        self.jogs: list[tuple[float, float]] = []  # distance and bound, mm
        self.link = LinkStatistics(frames=1000)
        self.identity = Identity("Rail", "desk", "1", "memory", simulated=True)

    def connect(self) -> list[Identity]:
        return [self.identity]

    def home(self) -> None:
        self.position_mm = 0.0

    def move_to(self, position_mm: float) -> None:
        self.position_mm, self.powered, self.ended_s = position_mm, True, self.clock.pc_s()

    def jog(
        self,
        distance_mm: float,
        *,
        bound_mm: float,
        speed_mm_s: float,
        stop_after_mm: float | None = None,
    ) -> RailTrace:
        self.jogs.append((distance_mm, bound_mm))
        at_mm = np.array([self.position_mm, self.position_mm + distance_mm])
        self.position_mm, self.powered = float(at_mm[1]), True
        return RailTrace(np.array([0.0, 1.0]), at_mm, at_mm, np.zeros(2), "")

    def rescaled(self, drive: float, strip: float, speed: float) -> dict[str, object]:
        return {}

    def settle(self) -> RailReading:
        return self.read()

    def read(self) -> RailReading:
        at_mm = self.position_mm
        now_s = self.clock.pc_s()
        return RailReading(at_mm, at_mm, 0.0, True, self.powered, now_s, self.ended_s)

    def hold(self) -> None:
        self.powered = False

    def statistics(self) -> LinkStatistics:
        return self.link

    def stop(self) -> None:
        self.stopped_s = self.clock.pc_s()

    def close(self) -> None:
        self.closed += 1
        self.powered = False


class DeskRobot:
    def __init__(self, cell: Cell, clock: Clock) -> None:
        self.clock = clock
        self.arm = cell.robot.arm()  # as the controller takes it to be
        self.joints_rad = np.radians(cell.robot.safe_deg)
        self.targets: list[Array] = []  # of its motions, rad
        self.speeds: list[float] = []  # of its motions, percent
        self.ended_s: float | None = None
        self.stopped = 0

    def connect(self) -> list[Identity]:
        return [Identity("Robot", "desk", "2", "memory", simulated=True)]

    def move_to(self, joints_rad: Array, speed_percent: float) -> RobotReading:
        self.joints_rad = np.array(joints_rad)
        self.targets.append(self.joints_rad)
        self.speeds.append(speed_percent)
        self.ended_s = self.clock.pc_s()
        return self.read()

    def read(self) -> RobotReading:
        pose = forward(self.arm, self.joints_rad)
        return RobotReading(self.joints_rad, pose, True, self.clock.pc_s(), self.ended_s)

    @property
    def moves(self) -> int:
        return len(self.targets)

    def stop(self) -> None:
        self.stopped += 1

    def close(self) -> None: ...


class DeskTracker:
    """``answer`` may raise, block, or change what is measured."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.answer: Callable[[], None] = lambda: None
        self.off_mm = np.zeros(3)
        self.std_mm = 0.01
        self.air: Air | None = Air(22.0, 1013.0, 45.0)
        self.measured = 0

    def connect(self) -> list[Identity]:
        return [Identity("Tracker", "desk", "3", "memory", simulated=True)]

    def measure(self, near_mm: Array, reflector: str, samples: int) -> TrackerReading:
        self.answer()
        self.measured += 1
        std = np.full(3, self.std_mm)
        return TrackerReading(
            np.array(near_mm) + self.off_mm,
            std,
            samples,
            reflector,
            self.air,
            self.clock.pc_s(),
        )

    def stop(self) -> None: ...

    def close(self) -> None: ...


def desk(cell: Cell, clock: Clock) -> Devices:
    return Devices(DeskRail(cell, clock), DeskRobot(cell, clock), DeskTracker(clock))


class Points:
    """A part that measures the floor nest a number of times."""

    name = "points"
    needs = moves = measures = yields = ""

    def __init__(self, count: int, act: Callable[[CellSession, int], None] | None = None) -> None:
        self.count, self.act = count, act

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        return PlannedStep(self.name, self.count, 1.0)

    def perform(self, session: CellSession) -> None:
        session.reach("connect")
        for number in range(self.count):
            if self.act is not None:
                self.act(session, number)
            session.floor_nest_point(PointId("p", target=str(number)), session.cell.layout.floor[0])

    def result(self, log: Log) -> dict[str, Any]:
        return {"measured": len(log.points)}


def procedure(*parts: Any) -> Procedure:
    return Procedure("desk", "for tests", tuple(parts), lambda result: Table((), ()))


def failing(error: Exception) -> Callable[[], NoReturn]:
    """Return a call that raises an error."""

    def fail() -> NoReturn:
        raise error

    return fail


def hang(entered: threading.Event, release: threading.Event) -> Callable[[], None]:
    """Return an answer that blocks until released, deaf to every stop."""

    def answer() -> None:
        entered.set()
        release.wait()

    return answer
