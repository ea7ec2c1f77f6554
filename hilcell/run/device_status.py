"""The last reading of each device, its age, and whether it moves: for display, never for motion.

The ports of a run are wrapped here, so that no device is read again for the display. A displayed
reading may be old and admits no motion; motions take their own.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from typing import Generic, TypeAlias, TypeVar

import numpy as np

from hilcell import ports
from hilcell.cell.devices import (
    Devices,
    aiming_tracker,
    jogging_rail,
    searching_tracker,
    self_stopping_rail,
    streaming_tracker,
    sweeping_robot,
    two_face_tracker,
)
from hilcell.cell.file import Cell, Station
from hilcell.errors import DriverDefect, HilcellError, with_location
from hilcell.ports import Array, Clock, DeviceError, Identity, NoReading, StripLost
from hilcell.run.control import DeviceStatus, Interlock
from hilcell.run.interlocks import (
    RAIL_BLOCKED,
    ROBOT_BLOCKED,
    TOO_OLD,
    Blocked,
    check_held,
    check_safe_pose,
    check_still,
)

D = TypeVar("D", ports.Rail, ports.Robot, ports.Tracker)
Reading = TypeVar("Reading", ports.RailReading, ports.RobotReading, ports.TrackerReading)


class DeviceMonitor(Generic[Reading]):
    """The last known state of one device; written by the worker alone, read by any thread."""

    def __init__(self, device: str, kind: type[Reading], clock: Clock) -> None:
        self._device, self._clock = device, clock
        self._kind: type[Reading] = kind
        self._reading: Reading | None = None  # the last one
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
        """Watch one call of the device, which may move or fail."""
        self.moving = moving
        try:
            yield
        except NoReading:  # the device answers
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
                raise DriverDefect(self._device, with_location(error)) from error

    def take(self, found: Reading) -> None:
        """Accept a driver's reading; raises `DriverDefect` for an invalid one."""
        if not isinstance(found, self._kind):
            problem = f"its driver returned {type(found).__name__}, expected {self._kind.__name__}"
            raise DriverDefect(self._device, problem)
        ahead_s = found.taken_s - self._clock.pc_s()
        if ahead_s > 0.0:  # NaN is refused where its age is checked
            problem = f"a reading is {ahead_s:.3f} s ahead of now; taken_s is clock.pc_s()"
            raise DriverDefect(self._device, problem)
        self._reading = found

    def identified(self, found: object) -> list[Identity]:
        """Return the identities; raises `DriverDefect` for any other type."""
        if isinstance(found, list) and all(isinstance(each, Identity) for each in found):
            return found
        problem = f"connect returned {type(found).__name__}, expected a list of Identity"
        raise DriverDefect(self._device, problem)

    def known(self, operation: str) -> Reading:
        """Return the last reading; raises `Blocked` if it is old or the device moves."""
        device, name, reading = self._device, self._device.lower(), self._reading
        if self.moving:
            code = "HC-R41" if device == "Rail" else "HC-B31"
            raise Blocked(code, device, operation, f"the {name} is moving", expected="at rest")
        if reading is None:
            raise Blocked(TOO_OLD[device], device, operation, f"the {name} was not read yet")
        age_s = self._clock.pc_s() - reading.taken_s
        if not -0.001 <= age_s <= 5.0:  # it is read again before anything moves
            found = f"the {name} was last read {age_s:.0f} s ago"
            raise Blocked(TOO_OLD[device], device, operation, found, fields={"age_s": age_s})
        return reading

    def status(self) -> DeviceStatus:
        state, age_s = "unknown", None
        if self.taken_s is not None:
            state, age_s = "fresh", round(max(0.0, self._clock.pc_s() - self.taken_s), 2)
        state = "lost" if self.reason else "moving" if self.moving else state
        return DeviceStatus(state, age_s, self.text, self.reason)


Monitor: TypeAlias = (
    DeviceMonitor[ports.RailReading]
    | DeviceMonitor[ports.RobotReading]
    | DeviceMonitor[ports.TrackerReading]
)


class CellMonitor:
    """The monitors of a cell's devices, and the devices as the run uses them."""

    REFRESH_S = 0.5

    def __init__(self, devices: Devices, clock: Clock, cell: Cell) -> None:
        self._cell = cell
        self.rail = DeviceMonitor("Rail", ports.RailReading, clock)
        self.strip = DeviceMonitor("Strip", ports.RailReading, clock)
        self.robot = DeviceMonitor("Robot", ports.RobotReading, clock)
        self.tracker = DeviceMonitor("Tracker", ports.TrackerReading, clock)
        self._monitors: dict[str, Monitor] = {"rail": self.rail, "strip": self.strip}
        self._monitors |= {"robot": self.robot, "tracker": self.tracker}
        self.devices = Devices(
            _WatchedRail(devices.rail, self.rail, self),
            _WatchedRobot(devices.robot, self.robot, self),
            _WatchedTracker(devices.tracker, self.tracker, self),
            devices.rail_on_robot,
        )
        self._refreshed_s = 0.0

    def refresh(self, *, at_once: bool = False) -> None:
        """Read rail and robot again every `REFRESH_S`; called while nothing moves.

        A device that fails is lost, no fault: the next motion's interlocks judge it.
        """
        now_s = time.monotonic()
        if now_s - self._refreshed_s < self.REFRESH_S and not at_once:
            return
        self._refreshed_s = now_s
        for device in (self.devices.rail, self.devices.robot):
            try:
                device.read()
            except DeviceError:
                continue  # shown by its status

    @property
    def lost(self) -> dict[str, DeviceError]:
        """Return, by name, the devices that failed at their last call."""
        devices = {name: each for name, each in self._monitors.items() if name != "strip"}
        return {name: each.error for name, each in devices.items() if each.error is not None}

    def take_rail(self, reading: ports.RailReading) -> ports.RailReading:
        self.rail.take(reading)
        how = "power on" if reading.powered else "held"
        moves = "" if reading.still else f", {reading.velocity_mm_s:.1f} mm/s"
        self.rail.show(f"{reading.position_mm:.2f} mm, {how}{moves}", reading.taken_s)
        self.strip.show(f"{reading.strip_mm:.2f} mm", reading.taken_s)
        return reading

    def take_robot(self, reading: ports.RobotReading) -> ports.RobotReading:
        self.robot.take(reading)
        joints = " ".join(f"{value:.1f}" for value in np.degrees(reading.joints_rad))
        still = "at rest" if reading.still else "moves"
        self.robot.show(f"{still} at {joints} deg", reading.taken_s)
        return reading

    def take_tracker(self, reading: ports.TrackerReading) -> ports.TrackerReading:
        """Accept a reading; raises `DriverDefect` for other shapes than (3,)."""
        self.tracker.take(reading)
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
        left_out = () if self._cell.has_rail else ("rail", "strip")
        return {n: each.status() for n, each in self._monitors.items() if n not in left_out}

    def interlocks(self, station: Station | None) -> list[Interlock]:
        """Return each interlock's state by the last readings; ``station`` is held."""

        def held(operation: str) -> None:
            if self._cell.has_rail:
                check_held(self._cell, self.rail.known(operation), station, operation)

        def parked() -> None:
            check_safe_pose(self._cell, self.robot.known(RAIL_BLOCKED))

        def at_rest() -> None:
            operation = "measurement blocked"
            held(operation)
            check_still(self.robot.known(operation), operation)

        checks = [("rail move", parked)] if self._cell.has_rail else []
        checks += [("robot move", partial(held, ROBOT_BLOCKED)), ("measurement", at_rest)]
        return [_judged(*check) for check in checks]


def _judged(name: str, check: Callable[[], None]) -> Interlock:
    try:
        check()
    except Blocked as blocked:
        expected = f", expected {blocked.expected}" if blocked.expected else ""
        return Interlock(name, blocked.found + expected, blocked.code)
    return Interlock(name)


class _Watched(Generic[D]):
    """A device as the run uses it; statistics, stop and close are not watched."""

    def __init__(self, device: D, own: Monitor, monitor: CellMonitor) -> None:
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


class _WatchedRail(_Watched[ports.Rail]):
    """Satisfies `hilcell.ports.Rail`, and `Jogs` and `StopsItself` where its rail does."""

    own_stop_s = math.nan  # its driver's class states it

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

    def jog(
        self,
        distance_mm: float,
        *,
        bound_mm: float,
        speed_mm_s: float,
        stop_after_mm: float | None = None,
    ) -> ports.RailTrace:
        jogs = jogging_rail(self._device)
        with self._call(moving=True):
            return jogs.jog(
                distance_mm,
                bound_mm=bound_mm,
                speed_mm_s=speed_mm_s,
                stop_after_mm=stop_after_mm,
            )

    def jog_until_lost(
        self, distance_mm: float, *, bound_mm: float, speed_mm_s: float
    ) -> ports.RailTrace:
        rail = self_stopping_rail(self._device)
        with self._call(moving=True):
            return rail.jog_until_lost(distance_mm, bound_mm=bound_mm, speed_mm_s=speed_mm_s)

    def regain(self) -> ports.AfterLoss:
        with self._call():
            return self_stopping_rail(self._device).regain()

    def rescaled(self, drive: float, strip: float, speed: float) -> dict[str, object]:
        return jogging_rail(self._device).rescaled(drive, strip, speed)

    def settle(self) -> ports.RailReading:
        with self._call(moving=True):
            return self._monitor.take_rail(self._device.settle())

    def read(self) -> ports.RailReading:
        with self._call():
            return self._monitor.take_rail(self._device.read())

    def hold(self) -> None:
        with self._call():
            self._device.hold()

    def statistics(self) -> ports.LinkStatistics:
        return self._device.statistics()


class _WatchedRobot(_Watched[ports.Robot]):
    """Satisfies `hilcell.ports.Robot` and `StatesSettings`, and `Sweeps` where its robot does."""

    def settings(self) -> ports.RobotSettings:
        """Return the controller's settings, none of them where its driver does not read them."""
        if not isinstance(self._device, ports.StatesSettings):
            return ports.RobotSettings(None, None, None, None, None)
        with self._call():
            return self._device.settings()

    def move_to(self, joints_rad: Array, speed_percent: float) -> ports.RobotReading:
        with self._call(moving=True):
            return self._monitor.take_robot(self._device.move_to(joints_rad, speed_percent))

    @contextmanager
    def sweep(self, axis: int, end_rad: float, speed_rad_s: float) -> Iterator[ports.Sweep]:
        sweeps = sweeping_robot(self._device)
        with self._own.watch(moving=True), sweeps.sweep(axis, end_rad, speed_rad_s) as sweep:
            yield sweep

    def read(self) -> ports.RobotReading:
        with self._call():
            return self._monitor.take_robot(self._device.read())


class _WatchedTracker(_Watched[ports.Tracker]):
    """Satisfies `hilcell.ports.Tracker`, and its `Streams`, `TwoFaces`, `Searches` and `Aims` where
    its tracker does.
    """

    def measure(self, near_mm: Array, reflector: str, samples: int) -> ports.TrackerReading:
        with self._call():
            return self._monitor.take_tracker(self._device.measure(near_mm, reflector, samples))

    def measure_back(self, near_mm: Array, reflector: str, samples: int) -> ports.TrackerReading:
        turning = two_face_tracker(self._device)
        with self._call():
            return self._monitor.take_tracker(turning.measure_back(near_mm, reflector, samples))

    def release_beam(self) -> None:
        aims = aiming_tracker(self._device)
        with self._call():
            aims.release_beam()

    def measure_aimed(self, reflector: str, samples: int) -> ports.TrackerReading:
        aims = aiming_tracker(self._device)
        with self._call():
            return self._monitor.take_tracker(aims.measure_aimed(reflector, samples))

    def search(
        self, near_mm: Array, reflector: str, samples: int, radius_mm: float
    ) -> ports.TrackerReading:
        searches = searching_tracker(self._device)
        with self._call():
            return self._monitor.take_tracker(
                searches.search(near_mm, reflector, samples, radius_mm)
            )

    @contextmanager
    def stream(self, near_mm: Array, reflector: str, rate_hz: float) -> Iterator[ports.Stream]:
        streams = streaming_tracker(self._device)
        with self._own.watch(), streams.stream(near_mm, reflector, rate_hz) as stream:
            yield stream
