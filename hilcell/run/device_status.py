"""The last reading of each device, its age, and whether it moves: for display, never for motion.

The ports of a run are wrapped here, so that no device is asked a second time for the display. A
displayed reading is no interlock. It may be old; motions take their own.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Generic, TypeVar

import numpy as np

from hilcell.cell.devices import Devices, streams_of, sweeps_of, turning_over
from hilcell.errors import DriverDefect, HilcellError, with_place
from hilcell.ports import (
    Array,
    Clock,
    DeviceError,
    Identity,
    LinkStatistics,
    NoReading,
    Rail,
    RailReading,
    Robot,
    RobotReading,
    Stream,
    StripLost,
    Sweep,
    Tracker,
    TrackerReading,
)
from hilcell.run.control import DeviceStatus

D = TypeVar("D", Rail, Robot, Tracker)
Reading = TypeVar("Reading", RailReading, RobotReading, TrackerReading)


class DeviceMonitor:
    """The known state of one device: written by the worker alone, read by any thread."""

    def __init__(self, device: str, clock: Clock) -> None:
        self._device, self._clock = device, clock
        self.moving = False
        self.reason = ""  # why the device is lost
        self.error: DeviceError | None = None  # by which it is
        self.text = ""
        self.taken_s: float | None = None

    def show(self, text: str, taken_s: float) -> None:
        self.text, self.taken_s = text, taken_s
        self.reason, self.error = "", None

    @contextmanager
    def watch(self, *, moving: bool = False) -> Iterator[None]:
        """Watch one call of the device: it may move meanwhile, and it may fail."""
        self.moving = moving
        try:
            yield
        except NoReading:  # the device is well
            self.reason, self.error = "", None
            raise
        except DeviceError as error:
            self.reason, self.error = str(error), error
            raise
        finally:
            self.moving = False

    @contextmanager
    def call(self, *, moving: bool = False) -> Iterator[None]:
        """Watch one call; raises `DriverDefect` for an error that no driver may raise."""
        with self.watch(moving=moving):
            try:
                yield
            except HilcellError:
                raise
            except Exception as error:  # whatever a driver raises is its defect
                raise DriverDefect(self._device, with_place(error)) from error

    def sound(self, found: Reading, kind: type[Reading]) -> Reading:
        """Return what a driver returned as a reading; raises `DriverDefect` where it is none."""
        if not isinstance(found, kind):
            problem = f"its driver returned {type(found).__name__}, expected {kind.__name__}"
            raise DriverDefect(self._device, problem)
        ahead_s = found.taken_s - self._clock.pc_s()
        if ahead_s > 0.0:  # NaN is refused where its age is judged
            problem = f"a reading is {ahead_s:.3f} s ahead of now; taken_s is clock.pc_s()"
            raise DriverDefect(self._device, problem)
        return found

    def identified(self, found: object) -> list[Identity]:
        """Return the identities; raises `DriverDefect` for anything but a list of them."""
        if isinstance(found, list) and all(isinstance(each, Identity) for each in found):
            return found
        problem = f"connect returned {type(found).__name__}, expected a list of Identity"
        raise DriverDefect(self._device, problem)

    def status(self) -> DeviceStatus:
        state, age_s = "unknown", None
        if self.taken_s is not None:
            state, age_s = "fresh", round(max(0.0, self._clock.pc_s() - self.taken_s), 2)
        state = "lost" if self.reason else "moving" if self.moving else state
        return DeviceStatus(state, age_s, self.text, self.reason)


class CellMonitor:
    """The monitors of a cell's devices, and the devices as the run uses them."""

    REFRESH_S = 0.5

    def __init__(self, devices: Devices, clock: Clock, *, has_rail: bool = True) -> None:
        self._has_rail = has_rail
        self.rail, self.strip = DeviceMonitor("Rail", clock), DeviceMonitor("Strip", clock)
        self.robot = DeviceMonitor("Robot", clock)
        self.tracker = DeviceMonitor("Tracker", clock)
        self.rail_reading: RailReading | None = None
        self.robot_reading: RobotReading | None = None
        self.devices = Devices(
            _WatchedRail(devices.rail, self.rail, self),
            _WatchedRobot(devices.robot, self.robot, self),
            _WatchedTracker(devices.tracker, self.tracker, self),
            devices.rail_rides,
        )
        self._refreshed_s = 0.0

    def refresh(self, *, at_once: bool = False) -> None:
        """Read rail and robot where the last readings grow old; called while nothing moves.

        A device that fails is lost, not at fault: the next motion's interlocks judge it.
        """
        now_s = time.monotonic()
        if now_s - self._refreshed_s < self.REFRESH_S and not at_once:
            return
        self._refreshed_s = now_s
        for device in (self.devices.rail, self.devices.robot):
            try:
                device.read()
            except DeviceError:
                continue  # its status says so

    @property
    def lost(self) -> dict[str, DeviceError]:
        """Return, by name, the devices that did not answer when they were last asked."""
        monitors = {"rail": self.rail, "robot": self.robot, "tracker": self.tracker}
        return {name: each.error for name, each in monitors.items() if each.error is not None}

    def take_rail(self, reading: RailReading) -> RailReading:
        """Show a reading of the rail, which carries the strip's."""
        self.rail_reading = self.rail.sound(reading, RailReading)
        how = "power on" if reading.powered else "held"
        moves = "" if reading.still else f", {reading.velocity_mm_s:.1f} mm/s"
        self.rail.show(f"{reading.position_mm:.2f} mm, {how}{moves}", reading.taken_s)
        self.strip.show(f"{reading.strip_mm:.2f} mm", reading.taken_s)
        return reading

    def take_robot(self, reading: RobotReading) -> RobotReading:
        self.robot_reading = self.robot.sound(reading, RobotReading)
        joints = " ".join(f"{value:.1f}" for value in np.degrees(reading.joints_rad))
        still = "at rest" if reading.still else "moves"
        self.robot.show(f"{still} at {joints} deg", reading.taken_s)
        return reading

    def take_tracker(self, reading: TrackerReading) -> TrackerReading:
        """Show a reading of the tracker; raises `DriverDefect` for other shapes than (3,)."""
        self.tracker.sound(reading, TrackerReading)
        shapes = np.shape(reading.xyz_mm), np.shape(reading.std_mm)
        if shapes != ((3,), (3,)):
            found = " and ".join(map(str, shapes))
            problem = f"xyz_mm and std_mm have the shapes {found}, expected (3,) each"
            raise DriverDefect("Tracker", problem)
        x, y, z = (float(each) for each in reading.xyz_mm)
        air = f"{reading.air.temperature_c:.1f} C" if reading.air else "air not measured"
        self.tracker.show(f"{x:.2f} {y:.2f} {z:.2f} mm, {air}", reading.taken_s)
        return reading

    def status(self) -> dict[str, DeviceStatus]:
        of_rail = {"rail": self.rail, "strip": self.strip} if self._has_rail else {}
        monitors = of_rail | {"robot": self.robot, "tracker": self.tracker}
        return {name: monitor.status() for name, monitor in monitors.items()}


class _Watched(Generic[D]):
    """A device as the run uses it. Its statistics, stop and close are not watched."""

    def __init__(self, device: D, own: DeviceMonitor, monitor: CellMonitor) -> None:
        self._device: D = device
        self._own, self._monitor = own, monitor

    def _call(self, *, moving: bool = False) -> AbstractContextManager[None]:
        return self._own.call(moving=moving)

    def connect(self) -> list[Identity]:
        with self._call():
            return self._own.identified(self._device.connect())

    def stop(self) -> None:
        self._device.stop()

    def close(self) -> None:
        self._device.close()


class _WatchedRail(_Watched[Rail]):
    """Satisfies `hilcell.ports.Rail`."""

    @contextmanager
    def _call(self, *, moving: bool = False) -> Iterator[None]:
        strip = self._monitor.strip
        with self._own.call(moving=moving):
            try:
                with strip.watch(moving=moving):
                    yield
            except StripLost as lost:
                strip.reason = str(lost)
                raise

    def home(self) -> None:
        with self._call(moving=True):
            self._device.home()

    def move_to(self, position_mm: float) -> None:
        with self._call(moving=True):
            self._device.move_to(position_mm)

    def settle(self) -> RailReading:
        with self._call(moving=True):
            return self._monitor.take_rail(self._device.settle())

    def read(self) -> RailReading:
        with self._call():
            return self._monitor.take_rail(self._device.read())

    def hold(self) -> None:
        with self._call():
            self._device.hold()

    def statistics(self) -> LinkStatistics:
        return self._device.statistics()


class _WatchedRobot(_Watched[Robot]):
    """Satisfies `hilcell.ports.Robot`, and `hilcell.ports.Sweeps` where its robot does."""

    def move_to(self, joints_rad: Array, speed_percent: float) -> RobotReading:
        with self._call(moving=True):
            return self._monitor.take_robot(self._device.move_to(joints_rad, speed_percent))

    @contextmanager
    def sweep(self, axis: int, end_rad: float, speed_rad_s: float) -> Iterator[Sweep]:
        sweeps = sweeps_of(self._device)
        with self._own.watch(moving=True), sweeps.sweep(axis, end_rad, speed_rad_s) as sweep:
            yield sweep

    def read(self) -> RobotReading:
        with self._call():
            return self._monitor.take_robot(self._device.read())


class _WatchedTracker(_Watched[Tracker]):
    """Satisfies `hilcell.ports.Tracker`, and `Streams` and `TwoFaces` where its tracker does."""

    def measure(self, near_mm: Array, reflector: str, samples: int) -> TrackerReading:
        with self._call():
            return self._monitor.take_tracker(self._device.measure(near_mm, reflector, samples))

    def measure_back(self, near_mm: Array, reflector: str, samples: int) -> TrackerReading:
        turning = turning_over(self._device)
        with self._call():
            return self._monitor.take_tracker(turning.measure_back(near_mm, reflector, samples))

    @contextmanager
    def stream(self, near_mm: Array, reflector: str, rate_hz: float) -> Iterator[Stream]:
        streams = streams_of(self._device)
        with self._own.watch(), streams.stream(near_mm, reflector, rate_hz) as stream:
            yield stream
