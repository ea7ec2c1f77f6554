"""One driver under test: its device, and its promises judged on it.

A bench is a simulated device, with wires that fail on demand. Promises that wait until the driver
gives up (half a minute for a measuring tracker) are judged concurrently, each on its own device;
those about milliseconds in sequence.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from typing import Literal

import msgspec

from hilcell.cell.devices import checked_options, driver_options, is_robot_driven, start_simulation
from hilcell.cell.file import Cell
from hilcell.conformance.exercise import PORTS, USES, Driver, Port, Reading
from hilcell.decoding import Json
from hilcell.errors import DeviceError, HilcellError, Stopped, with_location
from hilcell.ports import Clock, Identity, SimulatedCell, Streams, Sweeps
from hilcell.wire.relay import Relays

Verdict = Literal["held", "broken", "not applicable", "needs a person"]
POLL_S = 0.02
SIMULATED_ONLY = "it needs a fault, or may harm: only on simulated devices"

Settings = tuple[Callable[..., Driver], msgspec.Struct]  # a driver's class and its options


class Finding(HilcellError):
    """Why a promise is not kept, or cannot be judged."""

    verdict: Verdict


class Broken(Finding):
    """The driver does not keep the promise."""

    verdict = "broken"


class NeedsPerson(Finding):
    """The promise needs a person to do or to confirm something."""

    verdict = "needs a person"


class NotApplicable(Finding):
    """The promise does not apply to this driver."""

    verdict = "not applicable"


def require(holds: bool, why: str) -> None:
    """Raise `Broken` unless ``holds``; a comparison with NaN does not."""
    if not holds:
        raise Broken(why)


def expect_error(what: str, call: Callable[[], object]) -> DeviceError:
    """The error with which a call fails; raises `Broken` where it does not, or wrongly."""
    try:
        found = call()
    except DeviceError as error:
        return error
    except Stopped:
        raise
    except Exception as error:  # a driver may raise anything
        raise Broken(f"{what}: {with_location(error)}; expected a DeviceError") from error
    raise Broken(f"{what}: returned {found}; expected a DeviceError")


class RailWithRobot:
    """A rail that is an external axis, with its robot: one device. A run opens the robot before the
    rail, and closes both, so that promises about connect, close and the wire concern both.
    """

    def __init__(self, rail: Driver, robot: Driver) -> None:
        self._rail, self._robot = rail, robot
        rail.attach_robot(robot)

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


class BenchClock:
    """The simulated cell's clock, also after its restart."""

    def __init__(self, outer: Callable[[], None]) -> None:
        self.stop = threading.Event()
        self.outer = outer
        self.inner: Clock | None = None  # while the cell lives

    def now_s(self) -> float:
        return self._clock().now_s()

    def pc_s(self) -> float:
        """Return this PC's time, by which the driver's readings age."""
        return self._clock().pc_s()

    def wait(self, duration_s: float) -> None:
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
    """One driver and its simulated device, started by the first promise.

    ``kind`` replaces the class that the cell's driver names; ``outer`` is the check of the run that
    uses the bench. Nothing is simulated on the bench of a real cell.
    """

    PACE = 4.0  # of what moves in real time: quick, and slow enough to be stopped

    def __init__(
        self,
        cell: Cell,
        port: Port,
        *,
        kind: type[Driver] | None = None,
        paced: bool = False,
        outer: Callable[[], None] = lambda: None,
    ) -> None:
        if cell.simulation is not None:  # no cell that runs already
            alone = msgspec.structs.replace(cell.simulation, address="")
            cell = msgspec.structs.replace(cell, simulation=alone)
        self.cell, self.clock, self.kind = cell, BenchClock(outer), kind
        self.port: Port = port
        self.use = USES[port](cell)
        self._speed = self.PACE if paced else math.inf
        self._simulated: SimulatedCell | None = None
        self._wires = Relays({})
        self._built: list[Driver] = []

    @property
    def wires(self) -> Relays:
        self.require_device()
        self._start()
        if not self._wires.all:
            raise NotApplicable("no option of the driver says where its wire leads")
        return self._wires

    def require_device(self) -> None:
        """Raise `NotApplicable` where the driver has no device."""
        if self.use.absent:
            raise NotApplicable(self.use.absent)

    def settings(self) -> list[Settings]:
        """Return those of the driver, then of the robot whose external axis its rail is."""
        self._start()
        found = [
            driver_options(self.cell, table, self._wires.options[table]) for table in self._tables
        ]
        kind, options = found[0]
        return [(self.kind or kind, options), *found[1:]]

    def build(self, **changed: object) -> Driver:
        (kind, options), *carrier = self.settings()
        built = kind(msgspec.structs.replace(options, **changed), self.clock)
        for of_robot, robot_options in carrier:
            built = RailWithRobot(built, of_robot(robot_options, self.clock))
        self._built.append(built)
        return built

    def connected(self) -> Driver:
        device = self.build()
        device.connect()
        self.use.ready(device)
        return device

    def replace_device(self) -> None:
        """End the device without notice, and start another in its place."""
        wires = self.wires
        wires.refuse()
        self._end_simulation()
        self._start()
        wires.admit()

    def sleep(self, duration_s: float) -> None:
        """Let real time pass, until the run is stopped."""
        end_s = time.monotonic() + duration_s
        while (left_s := end_s - time.monotonic()) > 0:
            self.clock.outer()
            time.sleep(min(left_s, POLL_S))

    def reset(self) -> None:
        self.clock.stop.clear()
        self._wires.pass_all()
        for device in self._built:
            with suppress(Exception):  # of a driver on trial, whose promise is judged already
                device.close()
        if self._built:
            self._wires.drop()  # a command in progress keeps a connection open
        self._built.clear()

    def close(self) -> None:
        self.reset()
        self._wires.close()
        self._end_simulation()

    def _start(self) -> None:
        if self._simulated is not None:
            return
        self._simulated = start_simulation(self.cell, seed=1, speed=self._speed)
        if self._simulated is None:
            raise NotApplicable(SIMULATED_ONLY)
        self.clock.inner = self._simulated.clock(self.clock.stop)
        self._wires.lead_to(checked_options(self.cell, self._simulated.options, self._tables))

    @property
    def _tables(self) -> list[str]:
        """Table of the driver; and the robot's, if the rail's wire is in part the robot's."""
        rides = self.port == "rail" and is_robot_driven(self.cell)
        return [self.port, "robot"] if rides else [self.port]

    def _end_simulation(self) -> None:
        simulated, self._simulated = self._simulated, None
        if simulated is not None:
            simulated.close()


class Promise:
    """A method of `Promises` that raises `Broken`; the promise has its name and its docstring.

    ``paced``: on a device that moves in real time. ``real``: on real devices too, where it does
    only what any run does. ``waits``: until the driver gives up.
    """

    name: str
    _judge: type[Promises]

    def __init__(
        self,
        check: Callable[..., None],
        *ports: Port,
        paced: bool = False,
        real: bool = False,
        waits: bool = False,
    ) -> None:
        self.sentence, self._check, self.ports = check.__doc__ or "", check, ports
        self.paced, self.real, self.waits = paced, real, waits

    def __set_name__(self, owner: type[Promises], name: str) -> None:
        self.name, self._judge = name.replace("_", "-"), owner
        self.ports = self.ports or owner.ports

    def check(self, bench: Bench) -> None:
        self._check(self._judge(bench))


def promise(*ports: Port, **flags: bool) -> Callable[[Callable[..., None]], Promise]:
    """Decorator: make a method a `Promise`, of all ports of its class or of some of them."""
    return lambda check: Promise(check, *ports, **flags)


class Promises:
    """Promises about one subject, in the order in which they are judged."""

    ports: tuple[Port, ...] = PORTS

    def __init__(self, bench: Bench) -> None:
        self.bench, self.use, self.cell = bench, bench.use, bench.cell

    @classmethod
    def listed(cls) -> list[Promise]:
        return [each for each in vars(cls).values() if isinstance(each, Promise)]

    def able(self, kind: type[Sweeps | Streams], what: str) -> Driver:
        """A connected driver; raises `NotApplicable` where it lacks an ability."""
        driver = self.bench.connected()
        if not isinstance(driver, kind):
            raise NotApplicable(f"it does not {what}")
        return driver

    def require_same_place(self, one: Reading, other: Reading, otherwise: str) -> None:
        apart = self.use.apart(one, other)
        require(apart <= 1.0, f"{otherwise}: {apart:.1f} of what a rest allows")

    def require_at(self, reading: Reading, place: int) -> None:
        off, limit, unit = self.use.off(reading, place), self.use.tolerance, self.use.unit
        require(
            off <= limit,
            f"reads {off:.4f} {unit} from place {place}, expected <= {limit:g} {unit}",
        )

    def visit(self, device: Driver, place: int) -> Reading:
        """Go to a place; return the reading there; raises `Broken` where it is of another."""
        reading = self.use.visit(device, place)
        self.require_at(reading, place)
        return reading


@dataclass(frozen=True, slots=True)
class Outcome:
    """The finding of one promise."""

    promise: str
    verdict: Verdict
    why: str = ""
    took_s: float = 0.0

    def facts(self) -> Json:
        return asdict(self)


def judge(promise: Promise, bench: Bench) -> Outcome:
    """Put a driver through one promise; raises `Stopped` where the run is stopped."""
    began_s = time.monotonic()
    verdict: Verdict = "held"
    why = ""
    try:
        promise.check(bench)
    except Finding as error:
        verdict, why = error.verdict, str(error)
    except Stopped as error:
        bench.clock.outer()
        verdict, why = "broken", f"Stopped: {error}"
    except Exception as error:  # noqa: BLE001 - a driver may raise anything, which is its answer
        verdict, why = "broken", with_location(error)
    finally:
        bench.reset()
    return Outcome(promise.name, verdict, why, round(time.monotonic() - began_s, 2))


class Trial:
    """Two benches of one driver, one as fast as possible, one in real time."""

    def __init__(
        self,
        cell: Cell,
        port: Port,
        *,
        kind: type[Driver] | None = None,
        outer: Callable[[], None] = lambda: None,
    ) -> None:
        self._bench = partial(Bench, cell, port, outer=outer)
        self._kind = kind
        self._in_turn = {paced: self._bench(kind=kind, paced=paced) for paced in (False, True)}
        self._beside: list[Bench] = []
        self._judged: dict[str, Future[Outcome]] = {}

    def __enter__(self) -> Trial:
        return self

    def __exit__(self, *exception: object) -> None:
        for each in self._beside:
            each.clock.stop.set()  # its outcome is no longer needed
        for future in self._judged.values():
            future.exception()
        for each in (*self._beside, *self._in_turn.values()):
            each.close()

    def begin(self, promises: Iterable[Promise]) -> None:
        """Start those of ``promises`` that wait until the driver gives up."""
        waiting = [promise for promise in promises if promise.waits]
        if not waiting:
            return
        with_threads = ThreadPoolExecutor(len(waiting), "conformance")
        for promise in waiting:
            bench = self._bench(kind=self._kind, paced=promise.paced)
            self._beside.append(bench)
            self._judged[promise.name] = with_threads.submit(judge, promise, bench)
        with_threads.shutdown(wait=False)

    def judge(self, promise: Promise) -> Outcome:
        """Judge one promise; raises `Stopped` where the run is stopped."""
        if promise.name in self._judged:
            return self._judged.pop(promise.name).result()
        return judge(promise, self._in_turn[promise.paced])

    def try_kind(self, kind: type[Driver] | None) -> None:
        self._kind = kind
        for each in self._in_turn.values():
            each.kind = kind
