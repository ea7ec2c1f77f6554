"""Real devices on trial: the run's own, moved by its guarded motions, each after a word."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from hilcell.cell.devices import abilities, streams_of
from hilcell.conformance.bench import Bench, BenchClock
from hilcell.conformance.verdicts import NeedsPerson, Port
from hilcell.ports import Array, RailReading, RobotReading, Stream, TrackerReading
from hilcell.run.cell_session import CellSession
from procedures.home import Home

STANDS_DEG = 0.05  # an axis that turns by less is not announced


class GuardedBench(Bench):
    """The run's device of one port."""

    def __init__(self, session: CellSession, port: Port) -> None:
        super().__init__(session.cell, port, BenchClock(session.clock.check, session.clock))
        self._session = session

    def connected(self) -> Any:
        """Return the device, connected as it is."""
        if self.port == "tracker" and abilities(self.cell)["tracker_streams"]:
            return GuardedStreams(self._session)
        return _GUARDED[self.port](self._session)


class GuardedRail:
    """The slide, as far as promises on real devices use it."""

    def __init__(self, session: CellSession) -> None:
        self._session = session

    def home(self) -> None:
        """Do nothing: the run has found the reference."""

    def move_to(self, position_mm: float) -> None:
        """Move after the operator's word."""
        cell, now_mm = self._session.cell, self.read().position_mm
        _agreed(
            self._session,
            f"rail ({cell.rail.driver}): the slide moves from {now_mm:.2f} to {position_mm:.2f} mm "
            f"at {cell.rail.speed_mm_s:g} mm/s; the robot goes to its safe pose first",
        )
        self._session.rail_to(position_mm)

    def settle(self) -> RailReading:
        """Return a reading at rest."""
        return self._session.devices.rail.settle()

    def read(self) -> RailReading:
        """Read."""
        return self._session.devices.rail.read()


class GuardedRobot:
    """The robot, as far as promises on real devices use it."""

    def __init__(self, session: CellSession) -> None:
        self._session = session

    def move_to(self, joints_rad: Array, speed_percent: float) -> RobotReading:
        """Move after the operator's word, at the cell's speed, which is slow."""
        cell = self._session.cell
        percent = min(speed_percent, cell.robot.speed_percent)
        turns = _turns(self.read().joints_rad, joints_rad)
        back_deg = cell.robot.approach_deg
        _agreed(
            self._session,
            f"robot ({cell.robot.driver}): {turns} at {percent:g} % or less, every axis from "
            f"{back_deg:g} deg below",
        )
        return self._session.robot_to(joints_rad, "conformance")

    def read(self) -> RobotReading:
        """Read."""
        return self._session.devices.robot.read()


class GuardedTracker:
    """The tracker: only its beam moves."""

    def __init__(self, session: CellSession) -> None:
        self._session = session
        if session.cell.layout.by_hand:
            raise NeedsPerson("one reflector is carried by hand: nests stand empty")

    def measure(self, near_mm: Array, reflector: str, samples: int) -> TrackerReading:
        """Measure."""
        return self._session.devices.tracker.measure(near_mm, reflector, samples)


class GuardedStreams(GuardedTracker):
    """A tracker that streams."""

    def stream(
        self, near_mm: Array, reflector: str, rate_hz: float
    ) -> AbstractContextManager[Stream]:
        """Prepare a stream."""
        return streams_of(self._session.devices.tracker).stream(near_mm, reflector, rate_hz)


class GuardedHome(Home):
    """The way to safe pose and reference: real devices set out after the operator's word."""

    def home_rail(self, session: CellSession) -> None:
        """Announce both motions, and make them; an unattended run makes them as any run."""
        cell = session.cell
        if cell.simulation is None and not session.log.inputs.unattended:
            safe = _turns(session.devices.robot.read().joints_rad, np.radians(cell.robot.safe_deg))
            to_reference = (
                f"; then rail ({cell.rail.driver}): the slide moves from "
                f"{session.devices.rail.read().position_mm:.2f} mm to its reference switch"
                if cell.has_rail
                else ""
            )
            _agreed(
                session,
                f"robot ({cell.robot.driver}): to its safe pose, {safe}, at "
                f"{cell.robot.speed_percent:g} % or less{to_reference}",
            )
        super().home_rail(session)


def _turns(now_rad: Array, to_rad: Array) -> str:
    """Return which axes turn, from where to where."""
    now_deg, to_deg = np.degrees(now_rad), np.degrees(to_rad)
    turns = [
        f"A{axis} from {now:.2f} to {to:.2f} deg"
        for axis, (now, to) in enumerate(zip(now_deg, to_deg, strict=True), start=1)
        if not abs(to - now) <= STANDS_DEG
    ]
    return ", ".join(turns) or "all axes turn to where they stand"


def _agreed(session: CellSession, what: str) -> None:
    """Announce a motion and pause before it; an unattended run has nobody who agrees."""
    if session.log.inputs.unattended:
        raise NeedsPerson(f"{what}: somebody has to agree; run it attended")
    session.event("announced", motion=what)
    session.pause(
        f'conformance: {what}; clear the cell, stay at the E-stop, then type "yes" at '
        f"`hilcell resume {session.folder.name}`, or let it go on at the screen"
    )


_GUARDED = {"rail": GuardedRail, "robot": GuardedRobot, "tracker": GuardedTracker}
