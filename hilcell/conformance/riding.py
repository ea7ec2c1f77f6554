"""A rail that is an external axis, with the robot whose axis it is: one device, as a run uses both.

A run opens the robot before the rail, and leaves both. So what a promise says of connect, close and
the wire is said of the two of them.
"""

from __future__ import annotations

from hilcell.conformance.acts import Driver
from hilcell.ports import Identity


class Riding:
    """The rail's driver, whose robot is connected and closed with it."""

    def __init__(self, rail: Driver, robot: Driver) -> None:
        self._rail, self._robot = rail, robot
        rail.ride(robot)

    def __getattr__(self, name: str) -> object:
        return getattr(self._rail, name)

    def connect(self) -> list[Identity]:
        """Open both, the robot first; return the rail's identities."""
        self._robot.connect()
        found: list[Identity] = self._rail.connect()
        return found

    def close(self) -> None:
        """Leave both, the rail first."""
        try:
            self._rail.close()
        finally:
            self._robot.close()
