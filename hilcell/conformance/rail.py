"""Promises of a rail alone."""

from __future__ import annotations

from functools import partial
from itertools import pairwise

from hilcell.conformance.acts import STEP_MM
from hilcell.conformance.bench import Bench
from hilcell.conformance.trial import Promise
from hilcell.conformance.verdicts import fails, need
from hilcell.ports import Rail

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


def units(bench: Bench) -> None:
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


PROMISES = (
    Promise("units", "A step of 20 mm is one of drive and strip.", units, ("rail",), real=True),
    Promise("handedness", "Drive and strip count in the direction of the command.", direction,
            ("rail",), real=True),
    Promise("held", "Hold takes the power away; a motion leaves the drive holding.", held,
            ("rail",)),
    Promise("travel", "A place beyond the travel is refused, and nothing moves.", travel,
            ("rail",)),
    Promise("counts", "The wire's counts are there, also after close.", counts, ("rail",)),
)  # fmt: skip
