"""Promises of every port about readings: their time, their rest, and numbers that are none."""

from __future__ import annotations

import math
from functools import partial

from hilcell.conformance.bench import Bench
from hilcell.conformance.connecting import near
from hilcell.conformance.trial import Promise
from hilcell.conformance.verdicts import fails, need


def taken(bench: Bench) -> None:
    """Compare a reading's time with those of the question and the answer."""
    driver = bench.connected()
    for ask in (bench.acts.ask, lambda device: bench.acts.visit(device, 1), bench.acts.ask):
        asked_s = bench.clock.pc_s()
        taken_s = ask(driver).taken_s
        early_ms, late_ms = 1000 * (asked_s - taken_s), 1000 * (taken_s - bench.clock.pc_s())
        need(early_ms <= 0, f"taken {early_ms:.1f} ms before the question")
        need(late_ms <= 0, f"taken {late_ms:.1f} ms after the answer")


def no_number(bench: Bench) -> None:
    """Ask for places that are no numbers."""
    driver = bench.connected()
    for value in (math.nan, math.inf, -math.inf):
        fails(f"a place that is {value}", partial(bench.acts.refused, driver, value))


def reads_back(bench: Bench) -> None:
    """Visit places, and read there."""
    driver = bench.connected()
    for place in (0, 1, 0, 1, 0):
        near(bench, bench.acts.visit(driver, place), place)


def at_rest(bench: Bench) -> None:
    """Read a device that stands, while its axes dither."""
    driver = bench.connected()
    first = bench.acts.visit(driver, 1)
    reads = 5
    for n in range(1, reads + 1):
        reading = bench.acts.ask(driver)
        need(reading.still, f"reading {n} of {reads} at rest says that it moves")
        apart = bench.acts.apart(first, reading)
        need(apart <= 1.0, f"reading {n} of {reads} at rest: {apart:.1f} of what a rest allows")


def ended(bench: Bench) -> None:
    """Compare the end of a motion with the readings before and after it."""
    bench.present()
    driver = bench.connected()
    began_s = bench.clock.pc_s()
    reading = bench.acts.visit(driver, 1)
    need(reading.ended_s is not None, "no end of the motion is stated")
    need(began_s <= reading.ended_s, "the motion ended before it was asked for")
    later = bench.acts.ask(driver)
    need(later.ended_s == reading.ended_s, "the end of the motion changes at rest")
    need(later.ended_s <= later.taken_s, "the reading was taken before the motion ended")


PROMISES = (
    Promise("taken", "A reading's time lies between the question and the answer.", taken,
            real=True),
    Promise("no-number", "A place that is NaN or infinite is refused with a DeviceError.",
            no_number),
    Promise("reads-back", "After each motion or measurement the reading is of the place asked for.",
            reads_back, real=True),
    Promise("at-rest", "A device that stands and dithers reads as still.", at_rest,
            ("rail", "robot"), real=True),
    Promise("ended", "Readings state when the last motion ended, and were taken after it.", ended,
            ("rail", "robot"), real=True),
)  # fmt: skip
