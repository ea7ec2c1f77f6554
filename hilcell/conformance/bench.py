"""Where a driver is tried: its simulated device, with wires between them that fail on demand."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import cast

import msgspec

from hilcell.cell.devices import TABLES, driver_options, load_entry, start_simulation
from hilcell.cell.file import Cell
from hilcell.conformance.acts import ACTS, Driver
from hilcell.conformance.verdicts import NotApplicable, Port
from hilcell.conformance.wire import Wires
from hilcell.ports import Clock, Identity, RidesOnRobot, SimulatedCell, Stopped


class Riding:
    """A rail that is an external axis, with the robot whose axis it is: one device.

    A run opens the robot before the rail, and leaves both. So what a promise says of connect, close
    and the wire is said of the two of them.
    """

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


LOOK_S = 0.02
SIMULATED_ONLY = "it needs a fault, or may harm: only on simulated devices"
PACE = 4.0  # of what moves in real time: quick, and slow enough to be stopped

Settings = tuple[Callable[..., Driver], msgspec.Struct]  # a driver's class and its options


def goes_on() -> None:
    """Stop nothing."""


class BenchClock:
    """The simulated cell's clock, also after that was started again."""

    def __init__(self, outer: Callable[[], None], inner: Clock | None = None) -> None:
        self.stop = threading.Event()
        self.outer, self.inner = outer, inner

    def now_s(self) -> float:
        """Return the cell's time."""
        return self._clock().now_s()

    def pc_s(self) -> float:
        """Return this PC's time, by which the driver's readings age."""
        return self._clock().pc_s()

    def wait(self, duration_s: float) -> None:
        """Let time pass."""
        self.check()
        self._clock().wait(duration_s)

    def check(self) -> None:
        """Raise `Stopped` if a stop was asked for, here or in the run."""
        self.outer()
        if self.stop.is_set():
            raise Stopped("a stop was asked for")

    def _clock(self) -> Clock:
        if self.inner is None:
            raise Stopped("the bench is closed")
        return self.inner


class Bench:
    """One driver on trial; this one has no device of its own, so that none of it can fail."""

    def __init__(self, cell: Cell, port: Port, clock: BenchClock) -> None:
        self.cell, self.clock = cell, clock
        self.port: Port = port
        self.acts = ACTS[port](cell)

    @property
    def wires(self) -> Wires:
        """Return the wires before the device."""
        raise NotApplicable(SIMULATED_ONLY)

    def present(self) -> None:
        """Raise `NotApplicable` where the driver has no device."""
        if self.acts.absent:
            raise NotApplicable(self.acts.absent)

    def settings(self) -> Settings:
        """Return the driver's class and its options."""
        raise NotApplicable(SIMULATED_ONLY)

    def carrier(self) -> Settings | None:
        """Return those of the robot whose external axis the rail is; None for any other driver."""
        raise NotApplicable(SIMULATED_ONLY)

    def build(self, **changed: object) -> Driver:
        """Return a driver that is not connected, with ``changed`` options."""
        raise NotApplicable(f"{SIMULATED_ONLY} ({', '.join(changed)})")

    def connected(self) -> Driver:
        """Return a driver that is connected, and ready to be used."""
        raise NotApplicable(SIMULATED_ONLY)

    def replace_device(self) -> None:
        """End the device without a word, and have another in its place."""
        raise NotApplicable(SIMULATED_ONLY)

    def rest(self, duration_s: float) -> None:
        """Let real time pass, until the run is stopped."""
        end_s = time.monotonic() + duration_s
        while (left_s := end_s - time.monotonic()) > 0:
            self.check_outer()
            time.sleep(min(left_s, LOOK_S))

    def check_outer(self) -> None:
        """Raise `Stopped` where the run is stopped."""
        self.clock.outer()

    def tidy(self) -> None:
        """Close what a promise has left open, and mend the wires."""


GROUPS = dict(TABLES)


class SimulatedBench(Bench):
    """A driver and its simulated device, started when the first promise asks for it.

    ``kind`` is tried in place of the class that the cell's driver names; ``outer`` is the check of
    the run that uses the bench.
    """

    def __init__(
        self,
        cell: Cell,
        port: Port,
        *,
        kind: type[Driver] | None = None,
        paced: bool = False,
        outer: Callable[[], None] = goes_on,
    ) -> None:
        if cell.simulation is None:
            raise NotApplicable("the cell is real: nothing simulates its devices")
        alone = msgspec.structs.replace(cell.simulation, address="")
        super().__init__(msgspec.structs.replace(cell, simulation=alone), port, BenchClock(outer))
        self.kind = kind
        self._speed = PACE if paced else math.inf
        self._simulated: SimulatedCell | None = None
        self._wires: Wires | None = None
        self._addresses: dict[str, dict[str, object]] = {}
        self._built: list[Driver] = []

    @property
    def wires(self) -> Wires:
        """Return the wires before the device."""
        self.present()
        self._start()
        if self._wires is None or not self._wires.all:
            raise NotApplicable("no option of the driver says where its wire leads")
        return self._wires

    def settings(self) -> Settings:
        """Return the driver's class and its options."""
        kind, options = self._settings(self.port)
        return self.kind or kind, options

    def carrier(self) -> Settings | None:
        """Return those of the robot whose external axis the rail is; None for any other driver."""
        return self._settings("robot") if self._rides else None

    def build(self, **changed: object) -> Driver:
        """Return a driver that is not connected, with ``changed`` options."""
        kind, options = self.settings()
        built = kind(msgspec.structs.replace(options, **changed), self.clock)
        if carrier := self.carrier():
            of_robot, robot_options = carrier
            built = Riding(built, of_robot(robot_options, self.clock))
        self._built.append(built)
        return built

    def connected(self) -> Driver:
        """Return a driver that is connected, and ready to be used."""
        device = self.build()
        device.connect()
        self.acts.ready(device)
        return device

    def replace_device(self) -> None:
        """End the device without a word, and have another in its place."""
        wires = self.wires
        wires.refuse()
        self._end_simulation()
        self._start()
        wires.admit()

    def tidy(self) -> None:
        """Close what a promise has left open, and mend the wires."""
        self.clock.stop.clear()
        if self._wires is not None:
            self._wires.straight()
        for device in self._built:
            with suppress(Exception):  # of a driver on trial, whose promise is judged already
                device.close()
        if self._built and self._wires is not None:
            self._wires.drop()  # what is under way holds a connection open
        self._built.clear()

    def close(self) -> None:
        """End the device and its wires."""
        self.tidy()
        if self._wires is not None:
            self._wires.close()
        self._end_simulation()

    def _start(self) -> None:
        if self._simulated is not None:
            return
        seed = 1
        simulated = start_simulation(self.cell, seed=seed, speed=self._speed)
        if simulated is None:
            raise NotApplicable("nothing simulates the device")
        self._simulated = simulated
        self.clock.inner = simulated.clock(self.clock.stop)
        if self._wires is None:
            self._wires = Wires(self._behind(simulated))
            self._addresses = cast("dict[str, dict[str, object]]", self._wires.options)
        else:
            self._wires.lead_to(self._behind(simulated))

    @property
    def _rides(self) -> bool:
        """Whether the driver's wire is, in part, the robot's."""
        driver = str(getattr(self.cell, self.port).driver)
        return issubclass(load_entry(GROUPS[self.port], driver), RidesOnRobot)

    def _settings(self, port: str) -> Settings:
        self._start()
        return driver_options(self.cell, port, GROUPS[port], self._addresses[port])

    def _behind(self, simulated: SimulatedCell) -> dict[str, dict[str, object]]:
        """Return where the driver's wires lead, by table."""
        tables = (self.port, "robot") if self._rides else (self.port,)
        return {table: simulated.options[table] for table in tables}

    def _end_simulation(self) -> None:
        simulated, self._simulated = self._simulated, None
        if simulated is not None:
            simulated.close()
