"""Promises of a tracker alone."""

from __future__ import annotations

import numpy as np

from hilcell.conformance.acts import Driver, TrackerActs
from hilcell.conformance.bench import Bench
from hilcell.conformance.connecting import near
from hilcell.conformance.trial import Promise
from hilcell.conformance.verdicts import NotApplicable, fails, need
from hilcell.ports import Array, NoReading, StreamBlock, Streams, Tracker

SAMPLES = 3
RATE_HZ, STREAM_S, LOOK_S = 50.0, 1.0, 0.02
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


def units(bench: Bench) -> None:
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


def handedness(bench: Bench) -> None:
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


PROMISES = (
    Promise("units", "Two nests are as far apart as the cell file says.", units, ("tracker",),
            real=True),
    Promise("handedness", "Three nests have the sense that the cell file says.", handedness,
            ("tracker",), real=True),
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
