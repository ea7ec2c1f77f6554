"""Use of a device by the promises of every port: visit places 0 and 1, and read its place."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Literal, TypeAlias

import numpy as np

from hilcell.cell.file import Cell
from hilcell.geometry.frames import apply, inverse
from hilcell.ports import Array, Rail, RailReading, Robot, RobotReading, Tracker, TrackerReading

Port = Literal["rail", "robot", "tracker"]
PORTS: tuple[Port, ...] = ("rail", "robot", "tracker")
# Of a rail, robot or tracker, with its reading: loaded by name, each port has a class of its own.
Driver: TypeAlias = Any
Reading: TypeAlias = Any
SPEED_PERCENT = 10.0
STEP_DEG, STEP_MM = 2.0, 20.0
TRAVEL_S = 17.0  # of the cell
MANY = 30  # readings of a measurement that takes seconds


class DeviceUse(ABC):
    """Use of one port's devices, with the port's own readings; a connected device is ready."""

    tolerance: float  # of `off`
    unit: str
    travel_text: str  # text of `travel`
    absent = ""  # why there is no device; "" where there is one

    def __init__(self, cell: Cell) -> None:
        self.cell = cell

    def ready(self, device: Driver) -> None:  # noqa: B027 - most are ready
        """Make a connected device ready to visit places."""

    def ask(self, device: Driver) -> Reading:
        return device.read()

    @abstractmethod
    def visit(self, device: Driver, place: int) -> Reading:
        """Go to a place; return the reading there."""

    @abstractmethod
    def go_invalid(self, device: Driver, value: float) -> object:
        """Go to a place that is ``value``, which is NaN or infinite."""

    @abstractmethod
    def travel(self, device: Driver) -> object:
        """Do what takes seconds."""

    def before_end(self, reading: Reading) -> bool:
        """Whether a device is before the end of `travel`; always for a measurement."""
        return True

    def slow_options(self) -> dict[str, object]:
        """Driver options by which `travel` takes long on any device."""
        return {}

    @abstractmethod
    def off(self, reading: Reading, place: int) -> float:
        """Return how far a reading is from a place."""

    @abstractmethod
    def apart(self, one: Reading, other: Reading) -> float:
        """Return how far two readings are from each other, as a share of what one place allows."""


class _RailUse(DeviceUse):
    """Two places of the slide, near the first station; equal without a rail."""

    tolerance, unit = 0.1, "mm"
    travel_text = "a motion to the end of the travel"

    def __init__(self, cell: Cell) -> None:
        super().__init__(cell)
        first_mm = cell.station[0].rail_mm
        self.places_mm = (first_mm, first_mm + STEP_MM)
        if not cell.has_rail:
            self.absent = "the cell has no rail: no device answers, and nothing moves"
            self.places_mm = (first_mm, first_mm)

    def ready(self, device: Rail) -> None:
        """Home, unless drive and strip agree, as in a run."""
        reading = device.settle()
        apart_mm = abs(reading.position_mm - reading.strip_mm)
        if not apart_mm <= self.cell.rail.slip_limit_mm:
            device.home()

    def visit(self, device: Rail, place: int) -> RailReading:
        device.move_to(self.places_mm[place])
        return device.settle()

    def go_invalid(self, device: Rail, value: float) -> None:
        device.move_to(value)

    def travel(self, device: Rail) -> None:
        device.move_to(self.cell.rail.travel_max_mm)

    def before_end(self, reading: RailReading) -> bool:
        return reading.position_mm < self.cell.rail.travel_max_mm - STEP_MM

    def slow_options(self) -> dict[str, object]:
        """Return the speed at which the far end is `TRAVEL_S` away."""
        rail = self.cell.rail
        way_mm = rail.travel_max_mm - self.places_mm[0]
        return {"speed_mm_s": min(rail.speed_mm_s, way_mm / TRAVEL_S)}

    def off(self, reading: RailReading, place: int) -> float:
        """Return it in mm, of the drive's encoder."""
        return abs(reading.position_mm - self.places_mm[place])

    def apart(self, one: RailReading, other: RailReading) -> float:
        drive_mm = abs(one.position_mm - other.position_mm)
        stands_mm = 0.05
        return max(drive_mm, abs(one.strip_mm - other.strip_mm)) / stands_mm


class _RobotUse(DeviceUse):
    """The safe pose, and all axes a step up from it."""

    tolerance, unit = 0.01, "deg"
    SLOW_PERCENT = 1.0  # a motion that is stopped takes seconds
    travel_text = f"a motion of axis 1 at {SLOW_PERCENT:g} %"

    def __init__(self, cell: Cell) -> None:
        super().__init__(cell)
        safe_deg = np.array(cell.robot.safe_deg)
        self.places_deg = (safe_deg, safe_deg + STEP_DEG)
        axis = cell.robot.joint[0]
        inwards = 1.0 if 2.0 * safe_deg[0] <= axis.min_deg + axis.max_deg else -1.0
        way_deg = TRAVEL_S * axis.speed_deg_s * self.SLOW_PERCENT / 100.0
        self.far_deg = safe_deg + inwards * way_deg * np.eye(6)[0]

    def visit(self, device: Robot, place: int) -> RobotReading:
        return device.move_to(np.radians(self.places_deg[place]), SPEED_PERCENT)

    def go_invalid(self, device: Robot, value: float) -> RobotReading:
        target_deg = self.places_deg[0].copy()
        target_deg[2] = value
        return device.move_to(np.radians(target_deg), SPEED_PERCENT)

    def travel(self, device: Robot) -> RobotReading:
        return device.move_to(np.radians(self.far_deg), self.SLOW_PERCENT)

    def before_end(self, reading: RobotReading) -> bool:
        return worst_deg(reading.joints_rad, np.radians(self.far_deg)) > STEP_DEG

    def off(self, reading: RobotReading, place: int) -> float:
        return worst_deg(reading.joints_rad, np.radians(self.places_deg[place]))

    def apart(self, one: RobotReading, other: RobotReading) -> float:
        stands_deg = 0.002
        return worst_deg(one.joints_rad, other.joints_rad) / stands_deg


class TrackerUse(DeviceUse):
    """The first two nests on the floor."""

    unit = "mm"
    travel_text = f"a measurement of {MANY} readings"

    def __init__(self, cell: Cell) -> None:
        super().__init__(cell)
        self.reflector = cell.tracker.reflector
        self.tolerance = cell.tracker.find_radius_mm
        nests_mm = np.array([nest.xyz_mm for nest in cell.layout.fixed_nests])
        self.near_mm: Array = apply(inverse(cell.tracker.pose.matrix()), nests_mm)

    def ask(self, device: Tracker) -> TrackerReading:
        return self.visit(device, 0)

    def visit(self, device: Tracker, place: int) -> TrackerReading:
        return device.measure(self.near_mm[place], self.reflector, 1)

    def go_invalid(self, device: Tracker, value: float) -> TrackerReading:
        near_mm = self.near_mm[0].copy()
        near_mm[1] = value
        return device.measure(near_mm, self.reflector, 1)

    def travel(self, device: Tracker) -> TrackerReading:
        return device.measure(self.near_mm[0], self.reflector, MANY)

    def off(self, reading: TrackerReading, place: int) -> float:
        return float(np.linalg.norm(reading.xyz_mm - self.near_mm[place]))

    def apart(self, one: TrackerReading, other: TrackerReading) -> float:
        limit_mm = 6.0 * self.cell.tracker.max_std_mm
        return float(np.linalg.norm(one.xyz_mm - other.xyz_mm)) / limit_mm


def worst_deg(one_rad: Array, other_rad: Array) -> float:
    """Return the largest difference of two sets of joints (6,)."""
    return float(np.max(np.abs(np.degrees(one_rad - other_rad))))


USES: dict[Port, Callable[[Cell], DeviceUse]] = {
    "rail": _RailUse,
    "robot": _RobotUse,
    "tracker": TrackerUse,
}
