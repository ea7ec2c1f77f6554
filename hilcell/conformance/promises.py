"""Promises of single ports. ``python -m hilcell.conformance.promises`` reads docs/conformance.md on
stdin, and writes it with its table of promises updated.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from functools import partial
from itertools import pairwise

import numpy as np

from hilcell.cell.devices import TABLES
from hilcell.cell.file import Cell, load_cell
from hilcell.conformance import common_promises
from hilcell.conformance.exercise import (
    PORTS,
    SPEED_PERCENT,
    STEP_MM,
    Driver,
    Port,
    TrackerUse,
    worst_deg,
)
from hilcell.conformance.trial import (
    POLL_S,
    Bench,
    NotApplicable,
    Promise,
    Promises,
    expect_error,
    require,
)
from hilcell.geometry.kinematics import forward
from hilcell.ports import Array, NoReading, Rail, Robot, StreamBlock, Streams, Sweeps, Tracker

PORT_PROMISES = Promises()  # of one port


def _able(bench: Bench, kind: type[Sweeps | Streams], what: str) -> Driver:
    driver = bench.connected()
    if not isinstance(driver, kind):
        raise NotApplicable(f"it does not {what}")
    return driver


def _strip_steps(bench: Bench) -> list[tuple[float, float]]:
    """Return steps of drive and strip, mm."""
    bench.require_device()
    driver: Rail = bench.connected()
    readings = []
    for n in range(4):  # from one side, so that the backlash stays out
        driver.move_to(bench.cell.station[0].rail_mm + n * STEP_MM)
        readings.append(driver.settle())
    return [
        (after.position_mm - before.position_mm, after.strip_mm - before.strip_mm)
        for before, after in pairwise(readings[1:])
    ]


@PORT_PROMISES.add("units", "rail", real=True)
def rail_units(bench: Bench) -> None:
    """A step of 20 mm is one of drive and strip."""
    limit_mm = bench.cell.rail.max_backlash_mm
    for drive_mm, strip_mm in _strip_steps(bench):
        for what, step_mm in (("drive", drive_mm), ("strip", strip_mm)):
            off_mm = abs(abs(step_mm) - STEP_MM)
            require(off_mm <= limit_mm, f"a step of {STEP_MM:g} mm: {what} {step_mm:.3f} mm")


@PORT_PROMISES.add("handedness", "rail", real=True)
def direction(bench: Bench) -> None:
    """Drive and strip count in the direction of the command."""
    for drive_mm, strip_mm in _strip_steps(bench):
        require(
            drive_mm > 0 and strip_mm > 0,
            f"a step of {STEP_MM:+g} mm: drive {drive_mm:+.3f}, strip {strip_mm:+.3f} mm",
        )


@PORT_PROMISES.add("held", "rail")
def held(bench: Bench) -> None:
    """Hold takes the power away; a motion leaves the drive holding."""
    bench.require_device()
    driver: Rail = bench.connected()
    driver.move_to(bench.cell.station[0].rail_mm)
    driver.hold()
    require(not driver.read().powered, "powered after hold")
    driver.hold()
    driver.move_to(bench.cell.station[0].rail_mm + STEP_MM)
    require(driver.settle().powered, "not powered after a motion: it leaves the drive holding")


@PORT_PROMISES.add("travel", "rail")
def travel(bench: Bench) -> None:
    """A place beyond the travel is refused, and nothing moves."""
    driver: Rail = bench.connected()
    rail = bench.cell.rail
    before = driver.settle()
    for beyond_mm in (rail.travel_min_mm - 500.0, rail.travel_max_mm + 500.0):
        expect_error(f"a motion to {beyond_mm:g} mm", partial(driver.move_to, beyond_mm))
    bench.require_same_place(before, driver.read(), "the slide has moved")


@PORT_PROMISES.add("counts", "rail")
def counts(bench: Bench) -> None:
    """The wire's counts are there, also after close."""
    bench.require_device()
    driver: Rail = bench.connected()
    driver.read()
    before = driver.statistics().frames
    driver.close()
    after = driver.statistics().frames
    require(0 < before <= after, f"{before} frames before close, {after} after it")


STEP_DEG = 5.0
NEAR_MM = 1.0  # a controller's model is the nominal one, rounded
SWEEP_DEG, SWEEP_RAD_S = 4.0, 0.05


def _steps(bench: Bench) -> list[tuple[int, Array, Array]]:
    """For each axis, its step of the tool point as stated and by the nominal arm, mm."""
    driver: Robot = bench.connected()
    arm, safe_rad = bench.cell.robot.arm(), np.radians(bench.cell.robot.safe_deg)
    first = driver.move_to(safe_rad, SPEED_PERCENT)
    found = []
    for axis in range(6):
        to_rad = safe_rad + np.radians(STEP_DEG) * np.eye(6)[axis]
        stated_mm = driver.move_to(to_rad, SPEED_PERCENT).pose[:3, 3] - first.pose[:3, 3]
        nominal_mm = (forward(arm, to_rad) - forward(arm, safe_rad))[:3, 3]
        found.append((axis + 1, stated_mm, nominal_mm))
    return found


@PORT_PROMISES.add("units", "robot", real=True)
def robot_units(bench: Bench) -> None:
    """A step of each axis moves the tool point as far as the nominal arm says."""
    for axis, stated_mm, nominal_mm in _steps(bench):
        expected_mm, found_mm = (float(np.linalg.norm(each)) for each in (nominal_mm, stated_mm))
        limit_mm = NEAR_MM + 0.02 * expected_mm
        require(
            abs(found_mm - expected_mm) <= limit_mm,
            f"axis {axis} by {STEP_DEG:g} deg: tool point {found_mm:.2f} mm, nominally "
            f"{expected_mm:.2f} +-{limit_mm:.2f} mm",
        )


@PORT_PROMISES.add("handedness", "robot", real=True)
def robot_handedness(bench: Bench) -> None:
    """A step of each axis moves the tool point the way the nominal arm says."""
    for axis, stated_mm, nominal_mm in _steps(bench):
        length_mm, nominally_mm = (
            max(float(np.linalg.norm(each)), 1e-9) for each in (stated_mm, nominal_mm)
        )
        off_mm = float(np.linalg.norm(stated_mm / length_mm - nominal_mm / nominally_mm))
        turns = nominally_mm > NEAR_MM
        require(
            not turns or off_mm <= 1.0,
            f"axis {axis} by {STEP_DEG:+g} deg: tool point by {np.round(stated_mm, 1)} mm, "
            f"nominally {np.round(nominal_mm, 1)} mm",
        )


@PORT_PROMISES.add("speed", "robot")
def speed(bench: Bench) -> None:
    """A speed that is not 1 to 100 % is refused, and nothing moves."""
    driver: Robot = bench.connected()
    there_rad = np.radians(bench.cell.robot.safe_deg)
    before = driver.move_to(there_rad, SPEED_PERCENT)
    for percent in (0.0, -10.0, 0.9, 100.1, math.nan, math.inf):
        expect_error(f"a motion at {percent} %", partial(driver.move_to, there_rad + 0.05, percent))
    bench.require_same_place(before, driver.read(), "the robot has moved")


@PORT_PROMISES.add("sweep", "robot")
def sweep(bench: Bench) -> None:
    """A sweep turns one axis, not faster than asked for."""
    driver = _able(bench, Sweeps, "sweep")
    start = driver.move_to(np.radians(bench.cell.robot.safe_deg), SPEED_PERCENT)
    end_rad = start.joints_rad[0] + np.radians(SWEEP_DEG)
    with driver.sweep(0, end_rad, SWEEP_RAD_S) as sweeping:
        require(
            0 < sweeping.speed_rad_s <= SWEEP_RAD_S * 1.02,
            f"set to {sweeping.speed_rad_s:.4f} rad/s, expected <= {SWEEP_RAD_S:g} rad/s",
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


@PORT_PROMISES.add("moving", "robot")
def moving(bench: Bench) -> None:
    """A reading taken while an axis sweeps is not still."""
    driver = _able(bench, Sweeps, "sweep")
    start = driver.move_to(np.radians(bench.cell.robot.safe_deg), SPEED_PERCENT)
    with driver.sweep(0, start.joints_rad[0] + np.radians(SWEEP_DEG), SWEEP_RAD_S) as sweeping:
        sweeping.kickoff()
        sweeping.collect()
        require(not driver.read().still, "still while an axis turns")
        while not sweeping.ended:
            sweeping.collect()
        sweeping.complete()


RATE_HZ, STREAM_S = 50.0, 1.0


def _tracker_use(bench: Bench) -> TrackerUse:
    use = bench.use
    if not isinstance(use, TrackerUse):
        raise NotApplicable("no tracker")
    return use


def _floor(bench: Bench) -> tuple[Array, Array]:
    driver: Tracker = bench.connected()
    use = _tracker_use(bench)
    nominal_mm = use.near_mm[:3]
    found = [driver.measure(each, use.reflector, 1).xyz_mm for each in nominal_mm]
    return np.array(found), nominal_mm


@PORT_PROMISES.add("units", "tracker", real=True)
def tracker_units(bench: Bench) -> None:
    """Two nests are as far apart as the cell file says."""
    found_mm, nominal_mm = _floor(bench)
    limit_mm = 2 * bench.cell.layout.nest_tolerance_mm
    for other in (1, 2):
        found, expected = (
            float(np.linalg.norm(each[other] - each[0])) for each in (found_mm, nominal_mm)
        )
        require(
            abs(found - expected) <= limit_mm,
            f"two nests are {found:.2f} mm apart, nominally {expected:.2f} +-{limit_mm:g} mm",
        )


@PORT_PROMISES.add("handedness", "tracker", real=True)
def tracker_handedness(bench: Bench) -> None:
    """Three nests have the sense that the cell file says."""
    found_mm, nominal_mm = _floor(bench)
    senses = [float(np.sign(np.linalg.det(each))) for each in (found_mm, nominal_mm)]
    require(
        senses[0] == senses[1], "the nests are mirrored: the axes are left-handed, or two swapped"
    )


@PORT_PROMISES.add("samples", "tracker", real=True)
def samples(bench: Bench) -> None:
    """A reading is the mean of as many as asked for, with their deviation."""
    driver: Tracker = bench.connected()
    use = _tracker_use(bench)
    reading = driver.measure(use.near_mm[0], use.reflector, 3)
    require(reading.samples == 3, f"mean of {reading.samples} readings, expected 3")
    require(reading.reflector == use.reflector, f"of {reading.reflector!r}")
    std_mm, limit_mm = np.asarray(reading.std_mm), bench.cell.tracker.max_std_mm
    sound = std_mm.shape == (3,) and bool(np.all((std_mm >= 0) & (std_mm <= limit_mm)))
    require(sound, f"standard deviation {std_mm} mm, expected three of 0 to {limit_mm:g} mm")


@PORT_PROMISES.add("nothing-there", "tracker", real=True)
def nothing_there(bench: Bench) -> None:
    """Where no reflector is, measure raises NoReading; the next is good."""
    driver: Tracker = bench.connected()
    use = _tracker_use(bench)
    beside_mm = use.near_mm[0] + [0.0, 0.0, 10.0 * bench.cell.tracker.find_radius_mm]
    error = expect_error(
        "no reflector is there", lambda: driver.measure(beside_mm, use.reflector, 1)
    )
    require(isinstance(error, NoReading), f"{type(error).__name__}, expected NoReading: {error}")
    bench.visit(driver, 1)


@PORT_PROMISES.add("reflector", "tracker")
def no_such_reflector(bench: Bench) -> None:
    """A reflector that the tracker does not know is refused."""
    driver: Tracker = bench.connected()
    use = _tracker_use(bench)
    expect_error("an unknown reflector", lambda: driver.measure(use.near_mm[0], "no such one", 1))


@PORT_PROMISES.add("stream-times", "tracker", real=True)
def stream_times(bench: Bench) -> None:
    """Times of samples rise, at the stated rate."""
    rate_hz, device_s, _ = _streamed(bench)
    require(len(device_s) >= STREAM_S * RATE_HZ / 2, f"{len(device_s)} samples in {STREAM_S:g} s")
    steps_s = np.diff(device_s)
    require(bool(np.all(steps_s > 0)), "times of samples do not rise")
    found_hz = 1.0 / float(np.median(steps_s))
    even = abs(found_hz / rate_hz - 1.0) <= 0.02
    require(even, f"{found_hz:.2f} samples/s, expected {rate_hz:.2f}")


@PORT_PROMISES.add("stream-gaps", "tracker")
def stream_gaps(bench: Bench) -> None:
    """No sample is lost, and none comes twice, also where the wire pauses."""
    rate_hz, device_s, _ = _streamed(bench, hold=True)
    steps = np.diff(device_s) * rate_hz
    lost, twice = int(np.sum(steps > 1.5)), int(np.sum(steps < 1.0 / 1.5 / 2))
    require(not (lost or twice), f"{lost} gaps, {twice} samples twice, in {len(device_s)}")


@PORT_PROMISES.add("stream-place", "tracker", real=True)
def stream_place(bench: Bench) -> None:
    """Samples are of the reflector that was asked for."""
    _, _, xyz_mm = _streamed(bench)
    off_mm = np.linalg.norm(xyz_mm - _tracker_use(bench).near_mm[0], axis=1)
    worst_mm = float(np.max(off_mm, initial=0.0))
    limit_mm = bench.use.tolerance
    require(worst_mm <= limit_mm, f"a sample {worst_mm:.2f} mm off, expected <= {limit_mm:g} mm")


@PORT_PROMISES.add("stream-ends", "tracker", real=True)
def stream_ends(bench: Bench) -> None:
    """After a stream, ended or given up, the tracker measures at rest."""
    driver, use = _able(bench, Streams, "stream"), _tracker_use(bench)
    for ends in (True, False):
        with driver.stream(use.near_mm[0], use.reflector, RATE_HZ) as stream:
            stream.kickoff()
            for _ in range(10):  # until a sample has come
                bench.clock.wait(POLL_S)
                stream.collect()
            if ends:
                stream.complete()
        bench.visit(driver, 1)


def _streamed(bench: Bench, *, hold: bool = False) -> tuple[float, Array, Array]:
    """Rate, and the samples' times (N,) and positions (N, 3)."""
    driver, use = _able(bench, Streams, "stream"), _tracker_use(bench)
    blocks: list[StreamBlock] = []
    with driver.stream(use.near_mm[0], use.reflector, RATE_HZ) as stream:
        rate_hz: float = stream.rate_hz
        stream.kickoff()
        for look in range(round(STREAM_S / POLL_S)):
            if hold:
                bench.wires.set_mode("hold" if 10 <= look < 25 else "pass")
            bench.clock.wait(POLL_S)
            blocks += stream.collect()
        blocks += stream.complete()
    require(bool(blocks), "no sample came")
    return (
        rate_hz,
        np.concatenate([each.device_s for each in blocks]),
        np.concatenate([each.xyz_mm for each in blocks]),
    )


PROMISES = (*common_promises.PROMISES, *PORT_PROMISES, *common_promises.FAULT_PROMISES)
PORT_OF: dict[str, Port] = {
    group: port for port in PORTS for table, group in TABLES if table == port
}


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
