"""Speeds by positions and time: which motions prove something, and which never do."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
import pytest

from drivers.canopen.motion_guard import Proofs, SpeedGuard, Speeds
from hilcell.ports import Array
from tests.whole.bench import sweep

SPEED, ACCELERATION, PER_MM = 250_000.0, 200_000.0, 1000.0  # counts
POLL_S = 0.022

Profile = Callable[[float], tuple[float, float]]  # position and speed at a time


@dataclass
class Seen:
    """The first proof of each kind, and how far the slide was then."""

    contradiction: Speeds | None = None
    overspeed: Speeds | None = None
    way_mm: float = np.inf
    speed_mm_s: float = np.nan

    @property
    def proves(self) -> bool:
        return self.contradiction is not None or self.overspeed is not None


def trapezoid(distance: float, speed: float, acceleration: float) -> tuple[Profile, float]:
    """Return a motion from 0 over ``distance``, and how long it takes."""
    peak = min(speed, (distance * acceleration) ** 0.5)
    ramp_s = peak / acceleration
    cruise_s = distance / peak - ramp_s

    def at(now_s: float) -> tuple[float, float]:
        up_s = min(max(now_s, 0.0), ramp_s)
        level_s = min(max(now_s - ramp_s, 0.0), cruise_s)
        down_s = min(max(now_s - ramp_s - cruise_s, 0.0), ramp_s)
        way = acceleration * up_s**2 / 2 + peak * (level_s + down_s) - acceleration * down_s**2 / 2
        return way, acceleration * (up_s - down_s)

    return at, 2 * ramp_s + cruise_s


def look(
    profile: Profile, taken_s: Iterator[tuple[float, float]], unit: float = 1.0, lag_s: float = 0.0
) -> Seen:
    """Guard a motion by looks, each taken and ended at these times; return what it proves."""
    guard, seen = SpeedGuard(0.0, SPEED, ACCELERATION, PER_MM), Seen()
    for at_s, ended_s in taken_s:
        guard.take(round(profile(at_s)[0]), round(profile(at_s - lag_s)[1] / unit), ended_s)
        found = guard.contradiction(), guard.overspeed()
        if any(found) and not np.isfinite(seen.way_mm):
            seen.way_mm, seen.speed_mm_s = (each / PER_MM for each in profile(ended_s))
        seen.contradiction = seen.contradiction or found[0]
        seen.overspeed = seen.overspeed or found[1]
    return seen


def regular(until_s: float, apart_s: float = POLL_S) -> Iterator[tuple[float, float]]:
    for ended_s in np.arange(apart_s, until_s + 0.5, apart_s):
        yield ended_s - apart_s / 2, ended_s


def busy(until_s: float, seed: int) -> Iterator[tuple[float, float]]:
    """Looks of a PC that is late now and then, at either side of a reading; some come twice."""
    rng, now_s, at_s, again = np.random.default_rng(seed), 0.0, 0.0, False
    while now_s < until_s + 0.5:
        before_s, behind_s = rng.choice([0.002, 0.02, 0.3, 0.7], 2, p=[0.4, 0.4, 0.1, 0.1])
        again = not again and rng.random() < 0.05
        last_s, at_s = at_s, now_s + before_s
        now_s = at_s + behind_s
        yield last_s if again else at_s, now_s


@pytest.mark.parametrize("distance_mm", [0.3, 20.0, 700.0, 2500.0])
@pytest.mark.parametrize("seed", range(8))
def test_a_late_pc_proves_nothing_against_a_healthy_slide(distance_mm: float, seed: int) -> None:
    at, duration_s = trapezoid(1000.0 * distance_mm, SPEED, ACCELERATION)
    assert not look(at, busy(duration_s, seed)).proves


@pytest.mark.parametrize("lag_s", [0.0, 0.05])
@pytest.mark.parametrize(
    ("distance_mm", "apart_s"),
    [
        *product((0.3, 20.0, 700.0, 2500.0), (POLL_S, 0.1, 0.7)),
        *product((0.3, 20.0), (0.001,)),  # that often only as far as a ramp: each look costs time
        *sweep((700.0, 0.001), (2500.0, 0.001)),
    ],
)
def test_a_healthy_slide_passes_however_it_is_looked_at(
    distance_mm: float, apart_s: float, lag_s: float
) -> None:
    at, duration_s = trapezoid(1000.0 * distance_mm, SPEED, ACCELERATION)
    assert not look(at, regular(duration_s, apart_s), lag_s=lag_s).proves


def test_a_stepped_cell_is_looked_at_three_times_a_motion_and_passes() -> None:
    at, duration_s = trapezoid(2_000_000.0, SPEED, ACCELERATION)
    thirds = [(third * duration_s / 3,) * 2 for third in (1, 2, 3, 3, 3)]
    assert not look(at, iter(thirds)).proves


def test_a_frame_that_comes_twice_proves_nothing() -> None:
    at, duration_s = trapezoid(2_000_000.0, SPEED, ACCELERATION)
    looks = list(regular(duration_s))
    late = [(looks[max(0, n - (n % 7 == 3))][0], ended_s) for n, (_, ended_s) in enumerate(looks)]
    assert not look(at, iter(late)).proves


@pytest.mark.parametrize("jump_mm", [-640.0, 0.4, 640.0])
@pytest.mark.parametrize("at_s", [0.1, 2.0, 3.0])
def test_a_reference_that_is_set_on_the_way_proves_nothing(jump_mm: float, at_s: float) -> None:
    at, duration_s = trapezoid(600_000.0, SPEED, ACCELERATION)

    def homing(now_s: float) -> tuple[float, float]:
        way, speed = at(now_s)
        return way + 1000.0 * jump_mm * (now_s >= at_s), speed

    assert not look(homing, regular(duration_s)).proves


@pytest.mark.parametrize("unit", [0.01, 0.1, 4.0, 10_000 / 60, 1000.0])
def test_a_unit_of_speed_is_named_by_its_factor(unit: float) -> None:
    """6081h, 6083h and 606Ch in ``unit`` counts/s; the motor reaches 500 mm/s, 2000 mm/s^2."""
    speed, acceleration = min(SPEED * unit, 5e5), min(ACCELERATION * unit, 2e6)
    at, duration_s = trapezoid(2_000_000.0, speed, acceleration)
    seen = look(at, regular(min(duration_s, 20.0)), unit)
    assert seen.contradiction is not None
    assert seen.contradiction.factor == pytest.approx(unit, rel=0.15)
    stops_mm = seen.speed_mm_s**2 / 2 / 400.0  # on the ramp of a quick stop
    assert seen.way_mm + stops_mm < 50.0


def test_a_drive_that_shows_no_speed_at_all_is_a_contradiction() -> None:
    at, duration_s = trapezoid(500_000.0, SPEED, ACCELERATION)
    seen = look(at, regular(duration_s), unit=1e9).contradiction
    assert seen is not None
    assert seen.factor == np.inf


@pytest.mark.parametrize(("factor", "fires"), [(1.1, False), (1.35, True), (2.0, True)])
def test_overspeed_is_seen_by_positions(factor: float, fires: bool) -> None:
    at, duration_s = trapezoid(2_000_000.0, factor * SPEED, ACCELERATION)
    seen = look(at, regular(duration_s))
    assert seen.contradiction is None, "the drive says its speed"
    assert (seen.overspeed is not None) is fires


def test_a_speed_that_is_no_number_is_a_contradiction() -> None:
    guard = SpeedGuard(0.0, SPEED, ACCELERATION, PER_MM)
    for ended_s in (0.1, 0.2, 0.3):
        guard.take(0.0, np.nan, ended_s)
    assert guard.contradiction() is not None


def test_durations_lie_between_the_looks() -> None:
    since_s, until_s = np.array([0.0, 1.0, 2.0, 3.0]), np.array([1.0, 2.0, 3.0, 5.0])
    position, speed = np.array([0.0, 1.0, 3.0, 2.5]), np.array([1.0, -1.0, 2.0, 3.0])
    found = Proofs.of(since_s, until_s, position, speed)

    def values(each: Array) -> list[float]:
        return [float(value) for value in each]

    assert values(found.at_most_s) == [5.0, 4.0]
    assert values(found.at_least_s) == [2.0, 1.0]
    assert values(found.between_s) == [2.0, 2.0]
    assert values(found.gone) == [2.5 - 1.0, 1.5 - 1.5]
    assert values(found.path) == [3.5, 2.5]
    assert values(found.slowest) == [0.0, 0.0]
    assert values(found.fastest) == [3.0, 3.0]
    assert values(found.seen_s) == [4.0, 3.0]
    assert values(found.said) == [1.0 + 1.5 + 5.0, 1.5 + 5.0]
