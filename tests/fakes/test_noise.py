"""Noise and dither; the servo and the strip wander at rest, always, however often one looks."""

from __future__ import annotations

from statistics import median

import numpy as np
import pytest

from fakes.truth.noise import Dither, KeyedNoise
from tests.fakes.rail_bench import HUNTING, Bus


def test_a_draw_that_nobody_asks_for_counts() -> None:
    lazy, eager = KeyedNoise(1), KeyedNoise(1)
    lazy.later_normal("lands", 6)
    eager.normal("lands", 6)
    assert np.array_equal(lazy.normal("lands", 6), eager.normal("lands", 6))


def test_a_draw_is_the_same_whenever_it_is_asked_for() -> None:
    lazy, eager = KeyedNoise(1), KeyedNoise(1)
    later, wanted = lazy.later_normal("lands", 6), eager.normal("lands", 6)
    lazy.normal("lands", 6)
    assert np.array_equal(later(), wanted)
    assert np.array_equal(later(), wanted)


@pytest.mark.parametrize("reach", [1, 2, 5])
def test_the_middle_of_any_five_steps_is_zero(reach: int) -> None:
    dither = Dither(reach, 5)
    counts, changes = [], []
    for _ in range(2 * Dither.STEPS):
        dither.step()
        counts.append(dither.counts)
        changes.append(dither.change)
    assert (min(counts), max(counts)) == (-reach, reach)
    assert {median(counts[n : n + 5]) for n in range(len(counts) - 4)} == {0}
    assert 0 not in changes


def looks(bus: Bus) -> list[tuple[int, int]]:
    """Return position and speed of the drive at 20 SYNCs."""
    seen = []
    for _ in range(20):
        bus.sync()
        seen.append((bus.position(), bus.read(0x606C, 0, "i")))
    return seen


def test_a_servo_dithers_while_it_has_power(bus: Bus) -> None:
    assert set(looks(bus)) == {(0, 0)}, "the brake holds it"
    bus.enable(1)
    positions, speeds = zip(*looks(bus), strict=True)
    assert bus.rail.at_rest
    assert 2 <= max(positions) - min(positions) <= 4
    assert all(0 < abs(speed) <= HUNTING for speed in speeds)
    for index, kind in ((0x6067, "I"), (0x6068, "H"), (0x606F, "H"), (0x6070, "H")):
        bus.write(index, 0, 77, kind)  # the drive's own windows of position and speed
        assert bus.read(index, 0, kind) == 77
