"""A plant that replays: commanded joints in, the recorded measurement out.

The data are rows of commanded joints and measured positions in the tracker's frame; one pose may
carry several reflectors. Where the robot stands on no recorded pose, nothing is found. The rail
stands where it was switched on. A replay has no floor and no slide nests.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fakes.faults import Faults
from fakes.time import PlantTime
from fakes.truth.rail_truth import FloorTruth, RailTruth
from fakes.truth.robot_motion import RobotMotion
from fakes.truth.tracker_truth import Air, Measurement
from fakes.truth.transforms import Array
from hilcell.cell.file import Cell
from hilcell.fit.robot_file import read_measurements


class ReplayPlant:
    """One replayed cell; raises `SettingsError` where the data cannot be read."""

    def __init__(self, cell: Cell, data: Path, time: PlantTime, faults: Faults) -> None:
        self.cell, self.time = cell, time
        self.rail = RailTruth(cell, 0, time, faults) if cell.has_rail else FloorTruth(cell)
        self.robot = RobotMotion(cell, time, lambda key: lambda: np.zeros(6))
        self.tracker = ReplayTracker(data, self.robot)
        self.streams: None = None

    def seat(self, place: str) -> None:
        """Refuse: the recorded reflectors stay; raises `ValueError`."""
        raise ValueError("the reflectors of recorded data are where they were")

    def slip_mount(self, along_mm: float) -> None:
        """Do nothing: the recorded data have their own mount."""

    def lose_motion(self, lost_rad: float, axis: int = 3) -> None:
        """Leave the recorded data as they are."""

    def lose_zero(self, lost_rad: float, axis: int = 1) -> None:
        """Leave the recorded data as they are."""

    def grow(self, um_m: float) -> None:
        """Leave the recorded data as they are."""

    def loosen(self, axis: int, slip_rad: float) -> None:
        """Leave the recorded data as they are."""


class ReplayTracker:
    """Sees the reflectors recorded for the pose at which the robot stands."""

    AIR = Air(temperature_c=20.0, pressure_mbar=1013.25, humidity_percent=50.0)

    def __init__(self, data: Path, robot: RobotMotion) -> None:
        self._rows = read_measurements(data)
        self._robot = robot

    def reflectors(self) -> dict[str, Array]:
        """Return the recorded positions of the reflectors at this pose, by name."""
        state = self._robot.state()
        if state.moving:
            return {}
        off_rad = np.abs(self._rows.joints_rad - state.joints_rad).max(axis=1)
        same_pose_rad = 2e-5  # joints travel as decimals
        here = np.flatnonzero(off_rad <= same_pose_rad)
        return {self._rows.target[row]: self._rows.xyz_mm[row] for row in here}

    def reflector(self, name: str) -> Array | None:
        """Return the recorded position of one reflector, None where there is none."""
        return self.reflectors().get(name)

    def find(self, near_mm: Array, radius_mm: float) -> str | None:
        """Return the reflector nearest to a point (3,) within the radius."""
        found = {
            name: float(np.linalg.norm(at_mm - near_mm))
            for name, at_mm in self.reflectors().items()
        }
        best = min(found, key=found.__getitem__, default=None)
        return best if best is not None and found[best] <= radius_mm else None

    def measure(self, name: str, *, back: bool = False) -> Measurement | None:
        """Return the recorded measurement, whose face the data do not tell."""
        at_mm = self.reflector(name)
        std_mm = 0.005  # the data say nothing of each reading's spread
        return None if at_mm is None else Measurement(at_mm, np.full(3, std_mm))

    def air(self) -> Air:
        """Return the air, which the data do not tell."""
        return self.AIR
