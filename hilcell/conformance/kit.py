"""All promises: those of a rail, a robot, a tracker alone stand here.

``python -m hilcell.conformance.kit`` reads docs/conformance.md on stdin, and writes it with its
table of promises renewed.
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
from hilcell.conformance import connecting, wire_faults
from hilcell.conformance.acts import (
    PORTS,
    SPEED_PERCENT,
    STEP_MM,
    Driver,
    Port,
    TrackerActs,
    worst_deg,
)
from hilcell.conformance.connecting import near
from hilcell.conformance.trial import LOOK_S, Bench, NotApplicable, Promise, fails, need
from hilcell.geometry.kinematics import forward
from hilcell.ports import Array, NoReading, Rail, Robot, StreamBlock, Streams, Sweeps, Tracker

BEYOND_MM = 500.0


def _strip_steps(bench: Bench) -> list[tuple[float, float]]:
    """Return steps of drive and strip, mm."""
    bench.present()
    driver: Rail = bench.connected()
    steps = 3  # from one side, so that the backlash stays out
    at_mm = [bench.cell.station[0].rail_mm + n * STEP_MM for n in range(steps + 1)]
    readings = []
    for each in at_mm:
        driver.move_to(each)
        readings.append(driver.settle())
    return [
        (after.position_mm - before.position_mm, after.strip_mm - before.strip_mm)
        for before, after in pairwise(readings[1:])
    ]


def rail_units(bench: Bench) -> None:
    """Compare steps of the drive with the strip."""
    limit_mm = bench.cell.rail.max_backlash_mm
    for drive_mm, strip_mm in _strip_steps(bench):
        for what, step_mm in (("drive", drive_mm), ("strip", strip_mm)):
            off_mm = abs(abs(step_mm) - STEP_MM)
            need(off_mm <= limit_mm, f"a step of {STEP_MM:g} mm: {what} {step_mm:.3f} mm")


def direction(bench: Bench) -> None:
    """See that drive and strip count the same way."""
    for drive_mm, strip_mm in _strip_steps(bench):
        need(
            drive_mm > 0 and strip_mm > 0,
            f"a step of {STEP_MM:+g} mm: drive {drive_mm:+.3f}, strip {strip_mm:+.3f} mm",
        )


def held(bench: Bench) -> None:
    """Take the power away, and give it back by a motion."""
    bench.present()
    driver: Rail = bench.connected()
    driver.move_to(bench.cell.station[0].rail_mm)
    driver.hold()
    need(not driver.read().powered, "powered after hold")
    driver.hold()
    driver.move_to(bench.cell.station[0].rail_mm + STEP_MM)
    need(driver.settle().powered, "not powered after a motion: it leaves the drive holding")


def travel(bench: Bench) -> None:
    """Ask for places beyond both ends."""
    driver: Rail = bench.connected()
    rail = bench.cell.rail
    before = driver.settle()
    for beyond_mm in (rail.travel_min_mm - BEYOND_MM, rail.travel_max_mm + BEYOND_MM):
        fails(f"a motion to {beyond_mm:g} mm", partial(driver.move_to, beyond_mm))
    apart = bench.acts.apart(before, driver.read())
    need(apart <= 1.0, f"the slide has moved: {apart:.1f} of what a rest allows")


def counts(bench: Bench) -> None:
    """Ask for the wire's counts after close."""
    bench.present()
    driver: Rail = bench.connected()
    driver.read()
    before = driver.statistics().frames
    driver.close()
    after = driver.statistics().frames
    need(0 < before <= after, f"{before} frames before close, {after} after it")


RAIL = (
    Promise("units", "A step of 20 mm is one of drive and strip.", rail_units, ("rail",),
            real=True),
    Promise("handedness", "Drive and strip count in the direction of the command.", direction,
            ("rail",), real=True),
    Promise("held", "Hold takes the power away; a motion leaves the drive holding.", held,
            ("rail",)),
    Promise("travel", "A place beyond the travel is refused, and nothing moves.", travel,
            ("rail",)),
    Promise("counts", "The wire's counts are there, also after close.", counts, ("rail",)),
)  # fmt: skip


STEP_DEG = 5.0
NEAR_MM, NEAR_SHARE = 1.0, 0.02  # a controller's model is the nominal one, rounded
SWEEP_DEG, SWEEP_RAD_S = 4.0, 0.05
OTHERS_DEG = 0.01


def _steps(bench: Bench) -> list[tuple[int, Array, Array]]:
    """Return, for each axis, its step of the tool point as stated and by the nominal arm, mm."""
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


def robot_units(bench: Bench) -> None:
    """Step each axis, and compare how far the tool point goes."""
    for axis, stated_mm, nominal_mm in _steps(bench):
        wanted_mm, found_mm = (float(np.linalg.norm(each)) for each in (nominal_mm, stated_mm))
        limit_mm = NEAR_MM + NEAR_SHARE * wanted_mm
        need(
            abs(found_mm - wanted_mm) <= limit_mm,
            f"axis {axis} by {STEP_DEG:g} deg: tool point {found_mm:.2f} mm, nominally "
            f"{wanted_mm:.2f} +-{limit_mm:.2f} mm",
        )


def robot_handedness(bench: Bench) -> None:
    """Step each axis, and compare where the tool point goes."""
    for axis, stated_mm, nominal_mm in _steps(bench):
        off_mm = float(
            np.linalg.norm(stated_mm / _length(stated_mm) - nominal_mm / _length(nominal_mm))
        )
        turns = _length(nominal_mm) > NEAR_MM
        need(
            not turns or off_mm <= 1.0,
            f"axis {axis} by {STEP_DEG:+g} deg: tool point by {np.round(stated_mm, 1)} mm, "
            f"nominally {np.round(nominal_mm, 1)} mm",
        )


def _length(step_mm: Array) -> float:
    return max(float(np.linalg.norm(step_mm)), 1e-9)


def speed(bench: Bench) -> None:
    """Ask for speeds that are none."""
    driver: Robot = bench.connected()
    there_rad = np.radians(bench.cell.robot.safe_deg)
    before = driver.move_to(there_rad, SPEED_PERCENT)
    for percent in (0.0, -10.0, 0.9, 100.1, math.nan, math.inf):
        fails(
            f"a motion at {percent} %",
            partial(driver.move_to, there_rad + 0.05, percent),
        )
    apart = bench.acts.apart(before, driver.read())
    need(apart <= 1.0, f"the robot has moved: {apart:.1f} of what a rest allows")


def sweep(bench: Bench) -> None:
    """Turn axis 1 slowly, and see that no other turns."""
    driver = _sweeper(bench)
    start = driver.move_to(np.radians(bench.cell.robot.safe_deg), SPEED_PERCENT)
    end_rad = start.joints_rad[0] + np.radians(SWEEP_DEG)
    faster = 1.02
    with driver.sweep(0, end_rad, SWEEP_RAD_S) as sweeping:
        need(
            0 < sweeping.speed_rad_s <= SWEEP_RAD_S * faster,
            f"set to {sweeping.speed_rad_s:.4f} rad/s, wanted <= {SWEEP_RAD_S:g} rad/s",
        )
        sweeping.kickoff()
        samples = []
        while not sweeping.ended:
            samples.append(sweeping.collect())
        last = sweeping.complete()
    target_rad = start.joints_rad.copy()
    target_rad[0] = end_rad
    off_deg = worst_deg(last.joints_rad, target_rad)
    need(off_deg <= OTHERS_DEG, f"the sweep ends {off_deg:.4f} deg off")
    others_deg = max(worst_deg(each.joints_rad[1:], start.joints_rad[1:]) for each in samples)
    need(others_deg <= OTHERS_DEG, f"another axis turns by {others_deg:.4f} deg")
    times = [time_s for each in samples for time_s in (each.before_s, each.after_s)]
    need(times == sorted(times), "times of samples run back")


def moving(bench: Bench) -> None:
    """Read while an axis turns."""
    driver = _sweeper(bench)
    start = driver.move_to(np.radians(bench.cell.robot.safe_deg), SPEED_PERCENT)
    with driver.sweep(0, start.joints_rad[0] + np.radians(SWEEP_DEG), SWEEP_RAD_S) as sweeping:
        sweeping.kickoff()
        sweeping.collect()
        need(not driver.read().still, "still while an axis turns")
        while not sweeping.ended:
            sweeping.collect()
        sweeping.complete()


def _sweeper(bench: Bench) -> Driver:
    driver = bench.connected()
    if not isinstance(driver, Sweeps):
        raise NotApplicable("it does not sweep")
    return driver


ROBOT = (
    Promise("units", "A step of each axis moves the tool point as far as the nominal arm says.",
            robot_units, ("robot",), real=True),
    Promise("handedness", "A step of each axis moves the tool point the way the nominal arm says.",
            robot_handedness, ("robot",), real=True),
    Promise("speed", "A speed that is not 1 to 100 % is refused, and nothing moves.", speed,
            ("robot",)),
    Promise("sweep", "A sweep turns one axis, not faster than asked for.", sweep, ("robot",)),
    Promise("moving", "A reading taken while an axis sweeps is not still.", moving, ("robot",)),
)  # fmt: skip


SAMPLES = 3
RATE_HZ, STREAM_S = 50.0, 1.0
RATE_SHARE, GAP_SHARE = 0.02, 1.5
HELD_LOOKS = range(10, 25)


def _acts(bench: Bench) -> TrackerActs:
    acts = bench.acts
    if not isinstance(acts, TrackerActs):
        raise NotApplicable("no tracker")
    return acts


def _floor(bench: Bench) -> tuple[Array, Array]:
    """Return the floor's first three nests (3, 3), measured and nominal, tracker's frame, mm."""
    driver: Tracker = bench.connected()
    acts = _acts(bench)
    nominal_mm = acts.near_mm[:3]
    found = [driver.measure(each, acts.reflector, 1).xyz_mm for each in nominal_mm]
    return np.array(found), nominal_mm


def tracker_units(bench: Bench) -> None:
    """Measure the distance of two nests."""
    found_mm, nominal_mm = _floor(bench)
    limit_mm = 2 * bench.cell.layout.nest_tolerance_mm
    for other in (1, 2):
        found, wanted = (
            float(np.linalg.norm(each[other] - each[0])) for each in (found_mm, nominal_mm)
        )
        need(
            abs(found - wanted) <= limit_mm,
            f"two nests are {found:.2f} mm apart, nominally {wanted:.2f} +-{limit_mm:g} mm",
        )


def tracker_handedness(bench: Bench) -> None:
    """Compare the sense of three nests, as the tracker sees them."""
    found_mm, nominal_mm = _floor(bench)
    senses = [float(np.sign(np.linalg.det(each))) for each in (found_mm, nominal_mm)]
    need(senses[0] == senses[1], "the nests are mirrored: the axes are left-handed, or two swapped")


def samples(bench: Bench) -> None:
    """Ask for several readings."""
    driver: Tracker = bench.connected()
    acts = _acts(bench)
    reading = driver.measure(acts.near_mm[0], acts.reflector, SAMPLES)
    need(reading.samples == SAMPLES, f"mean of {reading.samples} readings, wanted {SAMPLES}")
    need(reading.reflector == acts.reflector, f"of {reading.reflector!r}")
    std_mm, limit_mm = np.asarray(reading.std_mm), bench.cell.tracker.max_std_mm
    sound = std_mm.shape == (3,) and bool(np.all((std_mm >= 0) & (std_mm <= limit_mm)))
    need(sound, f"standard deviation {std_mm} mm, wanted three of 0 to {limit_mm:g} mm")


def nothing_there(bench: Bench) -> None:
    """Measure where no reflector is."""
    driver: Tracker = bench.connected()
    acts = _acts(bench)
    beside = 10.0  # find radii from any reflector
    beside_mm = acts.near_mm[0] + [0.0, 0.0, beside * bench.cell.tracker.find_radius_mm]
    error = fails("no reflector is there", lambda: driver.measure(beside_mm, acts.reflector, 1))
    need(isinstance(error, NoReading), f"{type(error).__name__}, wanted NoReading: {error}")
    near(bench, acts.visit(driver, 1), 1)


def no_such_reflector(bench: Bench) -> None:
    """Measure with a reflector that the tracker does not know."""
    driver: Tracker = bench.connected()
    acts = _acts(bench)
    fails("an unknown reflector", lambda: driver.measure(acts.near_mm[0], "no such one", 1))


def stream_times(bench: Bench) -> None:
    """Compare the samples' times with the rate."""
    rate_hz, device_s, _ = _streamed(bench)
    need(len(device_s) >= STREAM_S * RATE_HZ / 2, f"{len(device_s)} samples in {STREAM_S:g} s")
    steps_s = np.diff(device_s)
    need(bool(np.all(steps_s > 0)), "times of samples do not rise")
    found_hz = 1.0 / float(np.median(steps_s))
    need(
        abs(found_hz / rate_hz - 1.0) <= RATE_SHARE,
        f"{found_hz:.2f} samples/s, wanted {rate_hz:.2f}",
    )


def stream_gaps(bench: Bench) -> None:
    """Hold the wire for a while; no sample is lost, none comes twice."""
    rate_hz, device_s, _ = _streamed(bench, hold=True)
    steps = np.diff(device_s) * rate_hz
    lost, twice = int(np.sum(steps > GAP_SHARE)), int(np.sum(steps < 1.0 / GAP_SHARE / 2))
    need(not (lost or twice), f"{lost} gaps, {twice} samples twice, in {len(device_s)}")


def stream_place(bench: Bench) -> None:
    """Compare the samples with a measurement at rest."""
    _, _, xyz_mm = _streamed(bench)
    off_mm = np.linalg.norm(xyz_mm - _acts(bench).near_mm[0], axis=1)
    worst_mm = float(np.max(off_mm, initial=0.0))
    limit_mm = bench.acts.tolerance
    need(worst_mm <= limit_mm, f"a sample {worst_mm:.2f} mm off, wanted <= {limit_mm:g} mm")


def stream_ends(bench: Bench) -> None:
    """Measure at rest after a stream, ended well or given up."""
    driver, acts = _streamer(bench), _acts(bench)
    looks = 10  # until a sample has come
    for ends in (True, False):
        with driver.stream(acts.near_mm[0], acts.reflector, RATE_HZ) as stream:
            stream.kickoff()
            for _ in range(looks):
                bench.clock.wait(LOOK_S)
                stream.collect()
            if ends:
                stream.complete()
        near(bench, acts.visit(driver, 1), 1)


def _streamer(bench: Bench) -> Driver:
    driver = bench.connected()
    if not isinstance(driver, Streams):
        raise NotApplicable("it does not stream")
    return driver


def _streamed(bench: Bench, *, hold: bool = False) -> tuple[float, Array, Array]:
    """Return the rate, and the samples' times (N,) and positions (N, 3)."""
    driver, acts = _streamer(bench), _acts(bench)
    blocks: list[StreamBlock] = []
    with driver.stream(acts.near_mm[0], acts.reflector, RATE_HZ) as stream:
        rate_hz: float = stream.rate_hz
        stream.kickoff()
        for look in range(round(STREAM_S / LOOK_S)):
            if hold:
                bench.wires.set("hold" if look in HELD_LOOKS else "pass")
            bench.clock.wait(LOOK_S)
            blocks += stream.collect()
        blocks += stream.complete()
    need(bool(blocks), "no sample came")
    return (
        rate_hz,
        np.concatenate([each.device_s for each in blocks]),
        np.concatenate([each.xyz_mm for each in blocks]),
    )


TRACKER = (
    Promise("units", "Two nests are as far apart as the cell file says.", tracker_units,
            ("tracker",), real=True),
    Promise("handedness", "Three nests have the sense that the cell file says.",
            tracker_handedness, ("tracker",), real=True),
    Promise("samples", "A reading is the mean of as many as asked for, with their deviation.",
            samples, ("tracker",), real=True),
    Promise("nothing-there", "Where no reflector is, measure raises NoReading; the next is good.",
            nothing_there, ("tracker",), real=True),
    Promise("reflector", "A reflector that the tracker does not know is refused.",
            no_such_reflector, ("tracker",)),
    Promise("stream-times", "Times of samples rise, at the stated rate.", stream_times,
            ("tracker",), real=True),
    Promise("stream-gaps", "No sample is lost, and none comes twice, also where the wire pauses.",
            stream_gaps, ("tracker",)),
    Promise("stream-place", "Samples are of the reflector that was asked for.", stream_place,
            ("tracker",), real=True),
    Promise("stream-ends", "After a stream, ended or given up, the tracker measures at rest.",
            stream_ends, ("tracker",), real=True),
)  # fmt: skip


PROMISES: tuple[Promise, ...] = (
    *connecting.PROMISES,
    *RAIL,
    *ROBOT,
    *TRACKER,
    *wire_faults.PROMISES,
)
PORT_OF: dict[str, Port] = {
    group: port for port in PORTS for table, group in TABLES if table == port
}


def driver_cell(where: str, port: Port, driver: str, sets: Mapping[str, str]) -> Cell:
    """Return a cell with a driver at one port."""
    stated = load_cell(where, sets)
    if getattr(stated, port).driver == driver:
        return stated
    return load_cell(where, {f"{port}.driver": driver, **sets})


def promises_of(port: Port) -> list[Promise]:
    """Return the promises of a port, in the order in which they are judged."""
    return [promise for promise in PROMISES if port in promise.ports]


def renewed(page: str) -> str:
    """Return a page with its table renewed: one line a promise."""
    rows = [
        f"| `{each.name}` | {', '.join(each.ports)} | {each.sentence} | "
        f"{'yes' if each.real else 'no'} |"
        for each in PROMISES
    ]
    lines = ["| promise | ports | in words | real devices |", "|---|---|---|---|", *rows]
    begin, end = "<!-- promises: python -m hilcell.conformance.kit -->", "<!-- end of promises -->"
    head, _, rest = page.partition(begin)
    _, _, tail = rest.partition(end)
    return "\n".join([head + begin, *lines, end + tail])


if __name__ == "__main__":
    sys.stdout.write(renewed(sys.stdin.read()))
