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
        _agreed(self._session, f"the slide moves to {position_mm:g} mm")
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
        percent = min(speed_percent, self._session.cell.robot.speed_percent)
        to_deg = ", ".join(f"{angle:.1f}" for angle in np.degrees(joints_rad))
        _agreed(self._session, f"the robot moves at {percent:g} % or less to {to_deg} deg")
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


def _agreed(session: CellSession, what: str) -> None:
    """Announce a motion and pause before it; an unattended run has nobody who agrees."""
    if session.log.inputs.unattended:
        raise NeedsPerson(f"{what}: somebody has to agree; run it attended")
    session.event("announced", motion=what)
    session.pause(f"conformance: {what}; clear the cell, stay at the E-stop")


_GUARDED = {"rail": GuardedRail, "robot": GuardedRobot, "tracker": GuardedTracker}
