"""Speeds and scales by positions and time: which motions contradict a drive, and which never do."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest

from drivers.canopen.motion_guard import Limits, MotionGuard, SpeedBounds, SpeedGuard, Speeds
from drivers.canopen.process_image import Snapshot
from drivers.slide import ScaleGuard, Windows
from hilcell.ports import Array
from tests.drivers.canopen.can_peer import CanPeer
from tests.drivers.canopen.rail_bed import BedRail, RailBed, RailTime
from tests.drivers.peers import figure, refusal
from tests.whole.bench import sweep

START = 500_000  # counts, as everywhere in this peer
RAMP_MM_S2 = 400.0  # of a quick stop


Runs = Callable[..., None]


@pytest.fixture
def runs(peer: CanPeer, time: RailTime, monkeypatch: pytest.MonkeyPatch) -> Runs:
    """Let the slide move in the cell's time as that of a drive whose speeds are in ``unit``.

    It reaches ``most`` counts/s with ``ramp`` counts/s^2; an obedient drive reaches 250 000.
    606Ch is in ``shown`` of that unit.
    """
    axis = peer.axis

    def run(
        unit: float = 1.0, most: float = 250_000.0, ramp: float = 200_000.0, shown: float = 1.0
    ) -> None:
        speed, ramp = min(250_000.0 * unit, most), min(200_000.0 * unit, ramp)
        began: list[tuple[float, int]] = []

        def step() -> None:
            if not axis.steps:
                began.clear()
                return
            if not began:
                began.append((time.now_s(), axis.position))
            began_s, start = began[0]
            passed_s, gap = time.now_s() - began_s, axis.target - start
            ramp_s = min(passed_s, speed / ramp)
            path = ramp * ramp_s**2 / 2 + speed * (passed_s - ramp_s)
            axis.speed = round(ramp * ramp_s / unit / shown)
            if path >= abs(gap):
                axis.position, axis.steps = axis.target, 0
                axis.bits |= 0x1400 if axis.homing else 0x400
            else:
                axis.position = start + round(path if gap > 0 else -path)

        monkeypatch.setattr(axis, "step", step)

    return run


def gone_mm(peer: CanPeer) -> float:
    return abs(peer.axis.position - START) / 1000.0


@pytest.mark.parametrize(
    ("unit", "true_mm_s", "stops_mm"),
    [(10_000 / 60, 500.0, 50.0), (1000.0, 500.0, 50.0), (0.1, 25.0, 10.0)],
)
@pytest.mark.parametrize("homing", [False, True])
def test_a_drive_in_another_unit_is_stopped_in_its_first_motion_and_named_with_its_factor(
    rail: BedRail, runs: Runs, unit: float, true_mm_s: float, stops_mm: float, homing: bool
) -> None:
    runs(unit, most=500_000.0, ramp=2_000_000.0)
    error = refusal(rail.home if homing else lambda: rail.move_to(2500.0))
    assert error.code == "HC-R46"
    assert figure(error, "factor") == pytest.approx(unit, rel=0.15)
    assert 0.0 < figure(error, "speed_mm_s") < true_mm_s
    ratio = figure(error, "speed_mm_s") / figure(error, "drive_speed_mm_s")
    assert ratio == pytest.approx(figure(error, "factor"))
    rail.peer.quick_stopped.wait()
    speed_mm_s = rail.peer.axis.speed * unit / 1000.0
    assert 0.0 < gone_mm(rail.peer) + speed_mm_s**2 / 2 / RAMP_MM_S2 < stops_mm


def test_a_drive_in_the_right_unit_is_not_stopped(rail: BedRail, runs: Runs) -> None:
    runs()
    rail.home()
    rail.move_to(1500.0)
    assert rail.read().position_mm == 1500.0


def test_a_slide_that_is_too_fast_by_its_positions_is_stopped(rail: BedRail, runs: Runs) -> None:
    """By 1.35: its drive says less, within the 1.5 of a unit that is right."""
    runs(1.35, most=337_500.0)
    error = refusal(lambda: rail.move_to(2500.0))
    assert error.code == "HC-R33"
    assert figure(error, "allowed_mm_s") == pytest.approx(300.0)
    assert 300.0 < figure(error, "speed_mm_s") < 340.0
    rail.peer.quick_stopped.wait()


@pytest.mark.parametrize("homing", [False, True])
@pytest.mark.parametrize(
    ("option", "value", "ratio"),
    [
        ("strip_counts_per_mm", 200.0, 0.5),
        ("strip_counts_per_mm", 80.0, 1.25),
        ("counts_per_mm", 2000.0, 2.0),
    ],
)
def test_scales_that_differ_are_named_in_motion(
    bed: RailBed, runs: Runs, option: str, value: float, ratio: float, homing: bool
) -> None:
    if option.startswith("strip"):
        del bed.peer.objects[6][0x6005, 1]  # it does not tell its step
        bed.peer.abort[0x6005, 0] = 0x06020000
    rail = bed.connect(**{option: value})
    runs()
    error = refusal(rail.home if homing else lambda: rail.move_to(1250.0))
    assert error.code == "HC-R47"
    assert figure(error, "ratio") == pytest.approx(ratio, rel=0.01)
    assert figure(error, "drive_mm") * (-1 if homing else 1) > 0.0
    bed.peer.quick_stopped.wait()
    assert gone_mm(bed.peer) < 250.0


@pytest.mark.parametrize("homing", [False, True])
def test_scales_that_differ_are_named_by_three_looks_at_a_motion(
    bed: RailBed, homing: bool
) -> None:
    """As a simulated cell moves; homing sets the reference by the last one."""
    rail = bed.connect(counts_per_mm=2000.0)
    error = refusal(rail.home if homing else lambda: rail.move_to(1250.0))
    assert error.code == "HC-R47"
    assert figure(error, "ratio") == pytest.approx(2.0, rel=0.01)


def test_a_speed_that_is_only_shown_in_another_unit_is_no_overspeed(
    rail: BedRail, runs: Runs
) -> None:
    """606Ch in 0.1 counts/s of a drive that obeys 6081h in counts/s."""
    runs(shown=0.1)
    error = refusal(lambda: rail.move_to(2500.0))
    assert error.code == "HC-R46"
    assert figure(error, "factor") == pytest.approx(0.1, rel=0.15)


@pytest.mark.parametrize("at", ["start", "way"])
def test_a_slide_that_slips_or_a_strip_that_jumps_is_no_matter_of_scale(
    rail: BedRail, runs: Runs, at: str
) -> None:
    runs()

    def jump() -> None:
        if rail.peer.axis.steps and (at == "start" or gone_mm(rail.peer) > 100.0):
            rail.peer.strip_offset = 8000

    rail.peer.on_sync = jump
    rail.move_to(1500.0)
    assert rail.read().strip_mm == 1580.0


@pytest.mark.parametrize("polls", [3, 10_000])
def test_a_strip_that_is_frozen_is_no_matter_of_scale(
    rail: BedRail, runs: Runs, polls: int
) -> None:
    """Where it stays so, the run finds that once the slide stands."""
    runs()
    frozen: list[bytes] = []

    def freeze(line: bytes) -> list[bytes]:
        if line.startswith(b"t186") and gone_mm(rail.peer) > 100.0 and len(frozen) < polls:
            frozen.append(frozen[0] if frozen else line)
            return frozen[-1:]
        return [line]

    rail.peer.tamper = freeze
    rail.move_to(1500.0)
    assert len(frozen) >= 3


def test_a_strip_on_a_wire_of_its_own_is_read_a_little_later() -> None:
    def way_mm(now_s: float) -> float:
        ramp_s = min(max(now_s, 0.0), 1.25)
        return 100.0 * ramp_s**2 + 250.0 * max(0.0, now_s - 1.25)

    guard = ScaleGuard(still_mm=0.02, speed_mm_s=250.0, synchronous=False)
    for now_s in np.arange(0.0, 4.0, 0.02):
        guard.add(way_mm(now_s), way_mm(now_s - 0.09))
        assert guard.contradiction() is None


def test_a_stepped_cell_lets_a_strip_on_its_own_wire_go_ahead_of_its_drive() -> None:
    """And homing sets the reference by the last look."""
    guard = ScaleGuard(still_mm=0.02, speed_mm_s=250.0, synchronous=False)
    for drive_mm, strip_mm in ((0.0, 639.9), (-212.2, 190.7), (0.0, 0.0)):
        guard.add(drive_mm, strip_mm)
        assert guard.contradiction() is None


def test_a_strip_that_counts_in_the_other_direction_is_named() -> None:
    guard = ScaleGuard(0.02, 250.0, synchronous=True)
    for place_mm in range(0, 200, 10):
        guard.add(float(place_mm), -float(place_mm))
    assert "opposite directions" in str(refusal(lambda: guard.check("move")))


@pytest.mark.parametrize(("moves", "words"), [(0.0, "does not follow"), (0.1, "speed_unit")])
def test_a_position_that_does_not_follow_is_no_unit_of_speed(moves: float, words: str) -> None:
    windows = Windows(speed=500.0, spread=10, strip_spread=2, dwell_s=0.4)
    limits = Limits(
        counts_per_mm=1000.0, strip_counts_per_mm=100.0, strip_at_sync=True, lowest=0,
        highest=3_000_000, speed=250_000.0, acceleration=200_000.0, homing_s=60.0, window=50,
        windows=windows,
    )  # fmt: skip
    at = Snapshot(0, 0, 0, 0, True, 0.0, 0x0027, 1)
    guard = MotionGuard(limits, at, 0.0)
    for look in range(1, 80):
        passed_s = 0.02 * look
        place = round(100_000 * moves * passed_s)
        guard.add(replace(at, position=place, velocity=100_000, strip=place // 10), passed_s)
    assert words in str(refusal(lambda: guard.check_unit("move", at)))


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
        guard.add(round(profile(at_s)[0]), round(profile(at_s - lag_s)[1] / unit), ended_s)
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
def test_a_healthy_slide_passes_however_it_is_polled(
    distance_mm: float, apart_s: float, lag_s: float
) -> None:
    at, duration_s = trapezoid(1000.0 * distance_mm, SPEED, ACCELERATION)
    assert not look(at, regular(duration_s, apart_s), lag_s=lag_s).proves


def test_a_stepped_cell_is_polled_three_times_a_motion_and_passes() -> None:
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
def test_a_reference_that_is_set_in_motion_proves_nothing(jump_mm: float, at_s: float) -> None:
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
def test_overspeed_is_detected_by_positions(factor: float, fires: bool) -> None:
    at, duration_s = trapezoid(2_000_000.0, factor * SPEED, ACCELERATION)
    seen = look(at, regular(duration_s))
    assert seen.contradiction is None, "the drive says its speed"
    assert (seen.overspeed is not None) is fires


def test_a_speed_that_is_no_number_is_a_contradiction() -> None:
    guard = SpeedGuard(0.0, SPEED, ACCELERATION, PER_MM)
    for ended_s in (0.1, 0.2, 0.3):
        guard.add(0.0, np.nan, ended_s)
    assert guard.contradiction() is not None


def test_durations_are_bounded_by_the_polls() -> None:
    since_s, until_s = np.array([0.0, 1.0, 2.0, 3.0]), np.array([1.0, 2.0, 3.0, 5.0])
    position, speed = np.array([0.0, 1.0, 3.0, 2.5]), np.array([1.0, -1.0, 2.0, 3.0])
    found = SpeedBounds.of(since_s, until_s, position, speed)

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
