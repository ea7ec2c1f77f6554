"""Conformance of the cell's drivers to their ports: each promise is tested on a device.

In a simulated cell each driver has its own simulated device, with wires that fail on demand, while
the run's devices are at rest. On real devices only promises without faults are tested, by guarded
motions, each confirmed by the operator.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial

import numpy as np

from hilcell.cell.devices import abilities, streaming_tracker
from hilcell.cell.file import Cell
from hilcell.conformance.exercise import PORTS, Port
from hilcell.conformance.promises import promises_of
from hilcell.conformance.trial import (
    SIMULATED_ONLY,
    Bench,
    NeedsPerson,
    Outcome,
    Promise,
    Trial,
    judge,
)
from hilcell.decoding import typed
from hilcell.journal.log import Log
from hilcell.journal.runs_folder import command_on
from hilcell.model.events import Announced, PromiseJudged
from hilcell.model.plan import PlannedStep
from hilcell.model.verdicts import DriverConforms
from hilcell.ports import Array, HilcellError, RailReading, RobotReading, Stream, TrackerReading
from hilcell.present.table import Table, listed
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Procedure, Result
from procedures.world_frame import Home

NAME = "conformance"


# -- real devices: moved by the run's guarded motions, each confirmed by the operator --------------


class GuardedBench(Bench):
    """The run's device of one port."""

    def __init__(self, session: CellSession, port: Port) -> None:
        super().__init__(session.cell, port, outer=session.clock.check)
        self.clock.inner = session.clock
        self._session = session

    def connected(self) -> GuardedRail | GuardedRobot | GuardedTracker:
        if self.port == "rail":
            return GuardedRail(self._session)
        if self.port == "robot":
            return GuardedRobot(self._session)
        streams = abilities(self.cell)["tracker_streams"]
        return (GuardedStreams if streams else GuardedTracker)(self._session)


class GuardedRail:
    """The slide for promises on real devices."""

    def __init__(self, session: CellSession) -> None:
        self._session = session

    def home(self) -> None:
        """Do nothing: the run has referenced the drive."""

    def move_to(self, position_mm: float) -> None:
        cell, now_mm = self._session.cell, self.read().position_mm
        _confirm(
            self._session,
            f"rail ({cell.rail.driver}): the slide moves from {now_mm:.2f} to {position_mm:.2f} mm "
            f"at {cell.rail.speed_mm_s:g} mm/s; the robot goes to its safe pose first",
        )
        self._session.rail_to(position_mm)

    def settle(self) -> RailReading:
        return self._session.devices.rail.settle()

    def read(self) -> RailReading:
        return self._session.devices.rail.read()


class GuardedRobot:
    """The robot for promises on real devices."""

    def __init__(self, session: CellSession) -> None:
        self._session = session

    def move_to(self, joints_rad: Array, speed_percent: float) -> RobotReading:
        """Move after the operator's confirmation, at most at the cell's speed."""
        cell = self._session.cell
        percent = min(speed_percent, cell.robot.speed_percent)
        turns = _turns(self.read().joints_rad, joints_rad)
        _confirm(
            self._session,
            f"robot ({cell.robot.driver}): {turns} at {percent:g} % or less, every axis from "
            f"{cell.robot.approach_deg:g} deg below",
        )
        return self._session.robot_to(joints_rad, "conformance")

    def read(self) -> RobotReading:
        return self._session.devices.robot.read()


class GuardedTracker:
    """The tracker: only its beam moves."""

    def __init__(self, session: CellSession) -> None:
        self._session = session
        if session.cell.layout.by_hand:
            raise NeedsPerson("one reflector is carried by hand: nests are empty")

    def measure(self, near_mm: Array, reflector: str, samples: int) -> TrackerReading:
        return self._session.devices.tracker.measure(near_mm, reflector, samples)


class GuardedStreams(GuardedTracker):
    """A tracker that streams."""

    def stream(
        self, near_mm: Array, reflector: str, rate_hz: float
    ) -> AbstractContextManager[Stream]:
        return streaming_tracker(self._session.devices.tracker).stream(near_mm, reflector, rate_hz)


class GuardedHome(Home):
    """Safe pose and reference; real devices move after the operator's confirmation."""

    def home_rail(self, session: CellSession) -> None:
        """Announce both motions, and make them; an unattended run makes them as any run."""
        cell = session.cell
        if cell.simulation is None and not session.log.inputs.unattended:
            safe = _turns(session.devices.robot.read().joints_rad, np.radians(cell.robot.safe_deg))
            what = f"robot ({cell.robot.driver}): to its safe pose, {safe}, at "
            what += f"{cell.robot.speed_percent:g} % or less"
            if cell.has_rail:
                now_mm = session.devices.rail.read().position_mm
                what += f"; then rail ({cell.rail.driver}): the slide moves from {now_mm:.2f} mm "
                what += "to its reference switch"
            _confirm(session, what)
        super().home_rail(session)


def _turns(now_rad: Array, to_rad: Array) -> str:
    now_deg, to_deg = np.degrees(now_rad), np.degrees(to_rad)
    stands_deg = 0.05  # an axis that turns by less is not announced
    turns = [
        f"A{axis} from {now:.2f} to {to:.2f} deg"
        for axis, (now, to) in enumerate(zip(now_deg, to_deg, strict=True), start=1)
        if not abs(to - now) <= stands_deg
    ]
    return ", ".join(turns) or "all axes move to their present angles"


def _confirm(session: CellSession, what: str) -> None:
    """Announce a motion and pause before it; raises `NeedsPerson` in an unattended run."""
    if session.log.inputs.unattended:
        raise NeedsPerson(f"{what}: an operator must confirm; run it attended")
    session.add(Announced(motion=what))
    session.pause(
        f'conformance: {what}; clear the cell, stay at the E-stop, then type "yes" at '
        f"`{command_on(session.folder, 'resume')}`, or continue on the screen"
    )


# -- the procedure --------------------------------------------------------------------------------


class Conformance:
    """Judges every promise of every port, once in a run's life."""

    name = NAME
    needs = "devices connected"
    moves = (
        "simulated devices of its own; real ones slowly: the slide to the first station and 60 mm "
        "beyond, the robot 5 deg about its safe pose"
    )
    measures = "three floor nests"
    yields = "a verdict on each promise of each driver"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Refuse a real cell that would move fast."""
        if cell.simulation is None:
            wanted = {
                "robot.speed_percent=10": cell.robot.speed_percent <= 10.0,
                "rail.speed_mm_s=25": not cell.has_rail or cell.rail.speed_mm_s <= 25.0,
            }
            if fast := [f"--set {setting}" for setting, slow in wanted.items() if not slow]:
                raise HilcellError(
                    f"real devices are tried slowly: add {' '.join(fast)}", code="HC-C10"
                )
        trial_s = 120.0  # of one driver, in real time
        return PlannedStep(self.name, 0, len(self._ports(cell)) * trial_s)

    def perform(self, session: CellSession) -> None:
        for port in self._ports(session.cell):
            if session.cell.simulation is None:
                bench = GuardedBench(session, port)
                self._try(session, port, partial(self._on_real, bench))
            else:
                with Trial(session.cell, port, outer=session.clock.check) as trial:
                    trial.begin(self._waiting(session.log, port))
                    self._try(session, port, trial.judge)

    @staticmethod
    def _on_real(bench: Bench, promise: Promise) -> Outcome:
        if promise.real:
            return judge(promise, bench)
        return Outcome(promise.name, "not applicable", SIMULATED_ONLY)

    def _try(self, session: CellSession, port: Port, judged: Callable[[Promise], Outcome]) -> None:
        for promise in self._waiting(session.log, port):
            session.checkpoint()
            session.add(PromiseJudged(port=port, **judged(promise).facts()))
        if (key := f"{NAME} {port}") not in session.log.verdicts:
            broken = [e.promise for e in self._found(session.log, port) if e.verdict == "broken"]
            driver = getattr(session.cell, port).driver
            session.judge(key, DriverConforms(holds=not broken, driver=driver, broken=broken))

    def result(self, log: Log) -> Result:
        return {NAME: {port: self._found(log, port) for port in self._ports(log.cell)}}

    @staticmethod
    def _ports(cell: Cell) -> list[Port]:
        return [port for port in PORTS if port != "rail" or cell.has_rail]

    @staticmethod
    def _waiting(log: Log, port: Port) -> list[Promise]:
        known = {each.promise for each in Conformance._found(log, port)}
        return [promise for promise in promises_of(port) if promise.name not in known]

    @staticmethod
    def _found(log: Log, port: str) -> list[Outcome]:
        judged = [each for each in log.happened(PromiseJudged) if each.port == port]
        return [typed(each, Outcome, from_attributes=True) for each in judged]

    @staticmethod
    def table(result: Result) -> Table:
        rows = [
            (port, each.promise, each.verdict, each.why)
            for port, outcomes in typed(result[NAME], dict[str, list[Outcome]]).items()
            for each in outcomes
        ]
        return Table(listed("port", "promise", "verdict", "why"), rows)


CONFORMANCE = Procedure(
    NAME,
    "whether the drivers keep the promises of their ports",
    (GuardedHome(), Conformance()),
    Conformance.table,
)
