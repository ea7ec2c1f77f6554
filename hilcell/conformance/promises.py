"""Promises of single ports. ``python -m hilcell.conformance.promises`` reads docs/conformance.md on
stdin, and writes it with its table of promises updated.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from contextlib import AbstractContextManager
from functools import partial
from itertools import pairwise
from typing import cast

import numpy as np

from hilcell.cell.devices import GROUPS
from hilcell.cell.file import Cell, load_cell
from hilcell.conformance.common_promises import PortPromises, WirePromises
from hilcell.conformance.exercise import PORTS, SPEED_PERCENT, STEP_MM, Port, TrackerUse, worst_deg
from hilcell.conformance.trial import POLL_S, Promise, Promises, expect_error, promise, require
from hilcell.geometry.kinematics import forward
from hilcell.ports import (
    Array,
    NoReading,
    Rail,
    Robot,
    Stream,
    StreamBlock,
    Streams,
    Sweeps,
    Tracker,
)


class RailPromises(Promises):
    """Promises of a rail."""

    ports = ("rail",)

    def _strip_steps(self) -> list[tuple[float, float]]:
        """Return steps of drive and strip, mm."""
        self.bench.require_device()
        driver: Rail = self.bench.connected()
        readings = []
        for n in range(4):  # from one side, so that the backlash stays out
            driver.move_to(self.cell.station[0].rail_mm + n * STEP_MM)
            readings.append(driver.settle())
        return [
            (after.position_mm - before.position_mm, after.strip_mm - before.strip_mm)
            for before, after in pairwise(readings[1:])
        ]

    @promise(real=True)
    def units(self) -> None:
        """A step of 20 mm is one of drive and strip."""
        limit_mm = self.cell.rail.max_backlash_mm
        for drive_mm, strip_mm in self._strip_steps():
            for what, step_mm in (("drive", drive_mm), ("strip", strip_mm)):
                off_mm = abs(abs(step_mm) - STEP_MM)
                require(off_mm <= limit_mm, f"a step of {STEP_MM:g} mm: {what} {step_mm:.3f} mm")

    @promise(real=True)
    def handedness(self) -> None:
        """Drive and strip count in the direction of the command."""
        for drive_mm, strip_mm in self._strip_steps():
            require(
                drive_mm > 0 and strip_mm > 0,
                f"a step of {STEP_MM:+g} mm: drive {drive_mm:+.3f}, strip {strip_mm:+.3f} mm",
            )

    @promise()
    def held(self) -> None:
        """Hold takes the power away; a motion leaves the drive holding."""
        self.bench.require_device()
        driver: Rail = self.bench.connected()
        driver.move_to(self.cell.station[0].rail_mm)
        driver.hold()
        require(not driver.read().powered, "powered after hold")
        driver.hold()
        driver.move_to(self.cell.station[0].rail_mm + STEP_MM)
        require(driver.settle().powered, "not powered after a motion: it leaves the drive holding")

    @promise()
    def travel(self) -> None:
        """A place beyond the travel is refused, and nothing moves."""
        driver: Rail = self.bench.connected()
        rail = self.cell.rail
        before = driver.settle()
        for beyond_mm in (rail.travel_min_mm - 500.0, rail.travel_max_mm + 500.0):
            expect_error(f"a motion to {beyond_mm:g} mm", partial(driver.move_to, beyond_mm))
        self.require_same_place(before, driver.read(), "the slide has moved")

    @promise()
    def counts(self) -> None:
        """The wire's counts are there, also after close."""
        self.bench.require_device()
        driver: Rail = self.bench.connected()
        driver.read()
        before = driver.statistics().frames
        driver.close()
        after = driver.statistics().frames
        require(0 < before <= after, f"{before} frames before close, {after} after it")


class RobotPromises(Promises):
    """Promises of a robot."""

    ports = ("robot",)
    STEP_DEG = 5.0
    NEAR_MM = 1.0  # a controller's model is the nominal one, rounded
    SWEEP_DEG, SWEEP_RAD_S = 4.0, 0.05

    def _steps(self) -> list[tuple[int, Array, Array]]:
        """For each axis, its step of the tool point as stated and by the nominal arm, mm."""
        driver: Robot = self.bench.connected()
        arm, safe_rad = self.cell.robot.arm(), np.radians(self.cell.robot.safe_deg)
        first = driver.move_to(safe_rad, SPEED_PERCENT)
        found = []
        for axis in range(6):
            to_rad = safe_rad + np.radians(self.STEP_DEG) * np.eye(6)[axis]
            stated_mm = driver.move_to(to_rad, SPEED_PERCENT).pose[:3, 3] - first.pose[:3, 3]
            nominal_mm = (forward(arm, to_rad) - forward(arm, safe_rad))[:3, 3]
            found.append((axis + 1, stated_mm, nominal_mm))
        return found

    @promise(real=True)
    def units(self) -> None:
        """A step of each axis moves the tool point as far as the nominal arm says."""
        for axis, stated_mm, nominal_mm in self._steps():
            expected_mm, found_mm = (
                float(np.linalg.norm(each)) for each in (nominal_mm, stated_mm)
            )
            limit_mm = self.NEAR_MM + 0.02 * expected_mm
            require(
                abs(found_mm - expected_mm) <= limit_mm,
                f"axis {axis} by {self.STEP_DEG:g} deg: tool point {found_mm:.2f} mm, nominally "
                f"{expected_mm:.2f} +-{limit_mm:.2f} mm",
            )

    @promise(real=True)
    def handedness(self) -> None:
        """A step of each axis moves the tool point the way the nominal arm says."""
        for axis, stated_mm, nominal_mm in self._steps():
            length_mm, nominally_mm = (
                max(float(np.linalg.norm(each)), 1e-9) for each in (stated_mm, nominal_mm)
            )
            off_mm = float(np.linalg.norm(stated_mm / length_mm - nominal_mm / nominally_mm))
            turns = nominally_mm > self.NEAR_MM
            require(
                not turns or off_mm <= 1.0,
                f"axis {axis} by {self.STEP_DEG:+g} deg: tool point by "
                f"{np.round(stated_mm, 1)} mm, nominally {np.round(nominal_mm, 1)} mm",
            )

    @promise()
    def speed(self) -> None:
        """A speed that is not 1 to 100 % is refused, and nothing moves."""
        driver: Robot = self.bench.connected()
        there_rad = np.radians(self.cell.robot.safe_deg)
        before = driver.move_to(there_rad, SPEED_PERCENT)
        for percent in (0.0, -10.0, 0.9, 100.1, math.nan, math.inf):
            expect_error(
                f"a motion at {percent} %", partial(driver.move_to, there_rad + 0.05, percent)
            )
        self.require_same_place(before, driver.read(), "the robot has moved")

    @promise()
    def sweep(self) -> None:
        """A sweep turns one axis, not faster than asked for."""
        driver = self.able(Sweeps, "sweep")
        start = driver.move_to(np.radians(self.cell.robot.safe_deg), SPEED_PERCENT)
        end_rad = start.joints_rad[0] + np.radians(self.SWEEP_DEG)
        with driver.sweep(0, end_rad, self.SWEEP_RAD_S) as sweeping:
            require(
                0 < sweeping.speed_rad_s <= self.SWEEP_RAD_S * 1.02,
                f"set to {sweeping.speed_rad_s:.4f} rad/s, expected <= {self.SWEEP_RAD_S:g} rad/s",
            )
            sweeping.kickoff()
            samples = []
            while not sweeping.ended:
                samples.append(sweeping.collect())
            last = sweeping.complete()
        target_rad = start.joints_rad.copy()
        target_rad[0] = end_rad
        off_deg = worst_deg(last.joints_rad, target_rad)
        require(off_deg <= 0.01, f"the sweep ends {off_deg:.4f} deg off")
        others_deg = max(worst_deg(each.joints_rad[1:], start.joints_rad[1:]) for each in samples)
        require(others_deg <= 0.01, f"another axis turns by {others_deg:.4f} deg")
        times = [time_s for each in samples for time_s in (each.before_s, each.after_s)]
        require(times == sorted(times), "times of samples run back")

    @promise()
    def moving(self) -> None:
        """A reading taken while an axis sweeps is not still."""
        driver = self.able(Sweeps, "sweep")
        start = driver.move_to(np.radians(self.cell.robot.safe_deg), SPEED_PERCENT)
        end_rad = start.joints_rad[0] + np.radians(self.SWEEP_DEG)
        with driver.sweep(0, end_rad, self.SWEEP_RAD_S) as sweeping:
            sweeping.kickoff()
            sweeping.collect()
            require(not driver.read().still, "still while an axis turns")
            while not sweeping.ended:
                sweeping.collect()
            sweeping.complete()


class TrackerPromises(Promises):
    """Promises of a tracker."""

    ports = ("tracker",)
    RATE_HZ, STREAM_S = 50.0, 1.0

    @property
    def tracker(self) -> TrackerUse:
        return cast("TrackerUse", self.use)

    def _floor(self) -> tuple[Array, Array]:
        driver: Tracker = self.bench.connected()
        nominal_mm = self.tracker.near_mm[:3]
        found = [driver.measure(each, self.tracker.reflector, 1).xyz_mm for each in nominal_mm]
        return np.array(found), nominal_mm

    @promise(real=True)
    def units(self) -> None:
        """Two nests are as far apart as the cell file says."""
        found_mm, nominal_mm = self._floor()
        limit_mm = 2 * self.cell.layout.nest_tolerance_mm
        for other in (1, 2):
            found, expected = (
                float(np.linalg.norm(each[other] - each[0])) for each in (found_mm, nominal_mm)
            )
            require(
                abs(found - expected) <= limit_mm,
                f"two nests are {found:.2f} mm apart, nominally {expected:.2f} +-{limit_mm:g} mm",
            )

    @promise(real=True)
    def handedness(self) -> None:
        """Three nests have the sense that the cell file says."""
        found_mm, nominal_mm = self._floor()
        senses = [float(np.sign(np.linalg.det(each))) for each in (found_mm, nominal_mm)]
        require(
            senses[0] == senses[1],
            "the nests are mirrored: the axes are left-handed, or two swapped",
        )

    @promise(real=True)
    def samples(self) -> None:
        """A reading is the mean of as many as asked for, with their deviation."""
        driver: Tracker = self.bench.connected()
        reading = driver.measure(self.tracker.near_mm[0], self.tracker.reflector, 3)
        require(reading.samples == 3, f"mean of {reading.samples} readings, expected 3")
        require(reading.reflector == self.tracker.reflector, f"of {reading.reflector!r}")
        std_mm, limit_mm = np.asarray(reading.std_mm), self.cell.tracker.max_std_mm
        sound = std_mm.shape == (3,) and bool(np.all((std_mm >= 0) & (std_mm <= limit_mm)))
        require(sound, f"standard deviation {std_mm} mm, expected three of 0 to {limit_mm:g} mm")

    @promise(real=True)
    def nothing_there(self) -> None:
        """Where no reflector is, measure raises NoReading; the next is good."""
        driver: Tracker = self.bench.connected()
        beside_mm = self.tracker.near_mm[0] + [0.0, 0.0, 10.0 * self.cell.tracker.find_radius_mm]
        error = expect_error(
            "no reflector is there", lambda: driver.measure(beside_mm, self.tracker.reflector, 1)
        )
        require(
            isinstance(error, NoReading), f"{type(error).__name__}, expected NoReading: {error}"
        )
        self.visit(driver, 1)

    @promise()
    def reflector(self) -> None:
        """A reflector that the tracker does not know is refused."""
        driver: Tracker = self.bench.connected()
        expect_error(
            "an unknown reflector",
            lambda: driver.measure(self.tracker.near_mm[0], "no such one", 1),
        )

    @promise(real=True)
    def stream_times(self) -> None:
        """Times of samples rise, at the stated rate."""
        rate_hz, device_s, _ = self._streamed()
        require(
            len(device_s) >= self.STREAM_S * self.RATE_HZ / 2,
            f"{len(device_s)} samples in {self.STREAM_S:g} s",
        )
        steps_s = np.diff(device_s)
        require(bool(np.all(steps_s > 0)), "times of samples do not rise")
        found_hz = 1.0 / float(np.median(steps_s))
        even = abs(found_hz / rate_hz - 1.0) <= 0.02
        require(even, f"{found_hz:.2f} samples/s, expected {rate_hz:.2f}")

    @promise()
    def stream_gaps(self) -> None:
        """No sample is lost, and none comes twice, also where the wire pauses."""
        rate_hz, device_s, _ = self._streamed(hold=True)
        steps = np.diff(device_s) * rate_hz
        lost, twice = int(np.sum(steps > 1.5)), int(np.sum(steps < 1.0 / 1.5 / 2))
        require(not (lost or twice), f"{lost} gaps, {twice} samples twice, in {len(device_s)}")

    @promise(real=True)
    def stream_place(self) -> None:
        """Samples are of the reflector that was asked for."""
        _, _, xyz_mm = self._streamed()
        off_mm = np.linalg.norm(xyz_mm - self.tracker.near_mm[0], axis=1)
        worst_mm = float(np.max(off_mm, initial=0.0))
        limit_mm = self.tracker.tolerance
        require(
            worst_mm <= limit_mm, f"a sample {worst_mm:.2f} mm off, expected <= {limit_mm:g} mm"
        )

    @promise(real=True)
    def stream_ends(self) -> None:
        """After a stream, ended or given up, the tracker measures at rest."""
        driver = self.able(Streams, "stream")
        for ends in (True, False):
            with self._stream(driver) as stream:
                stream.kickoff()
                for _ in range(10):  # until a sample has come
                    self.bench.clock.wait(POLL_S)
                    stream.collect()
                if ends:
                    stream.complete()
            self.visit(driver, 1)

    def _stream(self, driver: Streams) -> AbstractContextManager[Stream]:
        return driver.stream(self.tracker.near_mm[0], self.tracker.reflector, self.RATE_HZ)

    def _streamed(self, *, hold: bool = False) -> tuple[float, Array, Array]:
        """Rate, and the samples' times (N,) and positions (N, 3)."""
        driver = self.able(Streams, "stream")
        blocks: list[StreamBlock] = []
        with self._stream(driver) as stream:
            rate_hz: float = stream.rate_hz
            stream.kickoff()
            for look in range(round(self.STREAM_S / POLL_S)):
                if hold:
                    self.bench.wires.set_mode("hold" if 10 <= look < 25 else "pass")
                self.bench.clock.wait(POLL_S)
                blocks += stream.collect()
            blocks += stream.complete()
        require(bool(blocks), "no sample came")
        return (
            rate_hz,
            np.concatenate([each.device_s for each in blocks]),
            np.concatenate([each.xyz_mm for each in blocks]),
        )


PROMISES = tuple(
    promise
    for kind in (PortPromises, RailPromises, RobotPromises, TrackerPromises, WirePromises)
    for promise in kind.listed()
)
PORT_OF: dict[str, Port] = {GROUPS[port]: port for port in PORTS}


def driver_cell(where: str, port: Port, driver: str, sets: Mapping[str, str]) -> Cell:
    stated = load_cell(where, sets)
    if getattr(stated, port).driver == driver:
        return stated
    return load_cell(where, {f"{port}.driver": driver, **sets})


def promises_of(port: Port) -> list[Promise]:
    return [promise for promise in PROMISES if port in promise.ports]


def renewed(page: str) -> str:
    rows = [
        f"| `{each.name}` | {', '.join(each.ports)} | {each.sentence} | "
        f"{'yes' if each.real else 'no'} |"
        for each in PROMISES
    ]
    lines = ["| promise | ports | in words | real devices |", "|---|---|---|---|", *rows]
    begin, end = (
        "<!-- promises: python -m hilcell.conformance.promises -->",
        "<!-- end of promises -->",
    )
    head, _, rest = page.partition(begin)
    _, _, tail = rest.partition(end)
    return "\n".join([head + begin, *lines, end + tail])


if __name__ == "__main__":
    sys.stdout.write(renewed(sys.stdin.read()))
