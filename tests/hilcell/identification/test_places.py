"""Nests by their distances, the base by poses, the rail by jogs: against drawn truths."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from hilcell.cell.file import load_cell
from hilcell.geometry.frames import apply, from_zyx, inverse, matrix, unit
from hilcell.geometry.kinematics import Array
from hilcell.identification.places import may_be_nests, proven_shift, recognised
from hilcell.identification.rail_motion import jog_figures, stop_figures
from hilcell.identification.reflector_radius import reflectors_of

CELL = load_cell("paper")
NOMINAL_MM = np.array([nest.xyz_mm for nest in CELL.layout.fixed_nests])


def seen_of(rng: np.random.Generator, count: int) -> tuple[Array, list[int], Array]:
    T_W_L = matrix(from_zyx((rng.uniform(-180, 180), 1.0, -2.0)), rng.uniform(-3e3, 3e3, 3))
    order = rng.permutation(len(NOMINAL_MM))[:count].tolist()
    noise = rng.normal(scale=0.2, size=(count, 3))
    return T_W_L, order, apply(inverse(T_W_L), NOMINAL_MM[order]) + noise


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("count", [3, 4, 5])
def test_nests_are_recognised_in_any_order(seed: int, count: int) -> None:
    T_W_L, order, seen_mm = seen_of(np.random.default_rng([seed, count]), count)
    upright = [each for each in recognised(NOMINAL_MM, seen_mm, 3.0) if each.upright]
    assert list(upright[0].nests) == order
    assert np.abs(upright[0].T_W_L - T_W_L).max() < 2.0


def test_a_nest_that_moved_is_none_of_the_drawing() -> None:
    _, order, seen_mm = seen_of(np.random.default_rng(3), 5)
    seen_mm[2] += [0.0, 200.0, 0.0]
    best = recognised(NOMINAL_MM, seen_mm, 3.0)[0]
    assert list(best.nests) == [*order[:2], -1, *order[3:]]
    assert np.isnan(best.off_mm[2])
    assert best.worst_mm < 3.0


def test_two_equal_sides_leave_a_tracker_upside_down_open() -> None:
    seen_mm = NOMINAL_MM[:3] + [4000.0, 0.0, -1500.0]
    found = recognised(NOMINAL_MM, seen_mm, 1.0)
    assert [(each.nests, each.upright) for each in found] == [
        ((0, 1, 2), True),
        ((0, 2, 1), False),
    ]


@pytest.mark.parametrize("count", [4, 5])
@pytest.mark.parametrize(
    ("shift_mm", "words"),
    [
        (-12.7, "1.5 in where the tracker is set to 0.5 in"),
        (7.94, "0.875 in where the tracker is set to 1.5 in"),
        (0.0, ""),
    ],
)
def test_reflectors_of_another_radius_are_known_by_their_distances(
    count: int, shift_mm: float, words: str
) -> None:
    """A tracker set to a smaller radius reads too short, by the difference along each beam."""
    rng = np.random.default_rng(count)
    T_W_L, order, seen_mm = seen_of(rng, count)
    seen_mm = seen_mm - shift_mm * unit(seen_mm)
    best = recognised(NOMINAL_MM, seen_mm, 5.0)[0]
    assert list(best.nests) == order
    assert reflectors_of(best.shift_mm) == words
    assert np.abs(best.T_W_L - T_W_L)[:3, 3].max() < best.U_mm + 0.5
    for seen in range(2, count):
        assert may_be_nests(NOMINAL_MM, seen_mm[:seen], 5.0)
    seen_mm[-1] += [0.0, 200.0, 0.0]
    assert not may_be_nests(NOMINAL_MM, seen_mm, 5.0)


def test_few_nests_with_errors_of_a_drawing_prove_no_other_reflector() -> None:
    for seed in range(40):
        _, order, seen_mm = seen_of(np.random.default_rng(seed), 3)
        errors_mm = np.random.default_rng([seed, 1]).normal(scale=2.0, size=(3, 3))
        assert proven_shift(NOMINAL_MM[order], seen_mm + errors_mm, 5.0) == 0.0


@pytest.mark.parametrize("off_mm", [0.0, 12.7, -12.7])
def test_another_reflector_is_proven_where_nests_within_their_tolerance_are_less_likely(
    off_mm: float,
) -> None:
    """Five nests, each coordinate 1 mm (1 sigma) from the drawing, seen from the cell's tracker."""
    seen_mm, rng = apply(inverse(CELL.tracker.pose.matrix()), NOMINAL_MM), np.random.default_rng(5)
    for _ in range(100):
        at_mm = seen_mm + rng.normal(scale=1.0, size=seen_mm.shape).clip(-2.0, 2.0)
        found_mm = proven_shift(NOMINAL_MM, at_mm + off_mm * unit(at_mm), 5.0)
        assert np.sign(found_mm) == -np.sign(off_mm)
        if not off_mm:
            assert proven_shift(NOMINAL_MM[:3], at_mm[:3], 5.0) == 0.0


@dataclass
class Jogged:
    """A jog of 5 mm as the drive counts, at 2 mm/s."""

    scale: float = 1.0
    speed: float = 1.0
    stopped_by: str = ""
    noise_mm_s: float = 0.0
    taken_s: list[float] = field(default_factory=lambda: [0.01 * n for n in range(301)])

    @property
    def drive_mm(self) -> list[float]:
        return [min(2.0 * t, 5.0) for t in self.taken_s]

    @property
    def strip_mm(self) -> list[float]:
        return [self.scale * x + 700.0 for x in self.drive_mm]

    @property
    def velocity_mm_s(self) -> list[float]:
        noise = (self.noise_mm_s * (-1) ** n for n in range(len(self.taken_s)))
        moving = (2.0 * self.speed if x < 5.0 else 0.0 for x in self.drive_mm)
        return [v + e for v, e in zip(moving, noise, strict=True)]


@pytest.mark.parametrize(
    ("scale", "gross", "simple"),
    [
        (1.0, False, 1.0),
        (-1.0, True, -1.0),
        (10.3, True, 10.0),
        (0.9, False, 0.9),
        (0.48, True, 0.5),
    ],
)
def test_a_jog_shows_sign_and_scale(scale: float, gross: bool, simple: float) -> None:
    figures = jog_figures(Jogged(scale))
    assert figures.scale == pytest.approx(scale)
    assert figures.is_gross is gross
    assert figures.simple_scale(0.08) == pytest.approx(simple)


def test_a_strip_that_stands_still_or_reads_nothing_is_gross() -> None:
    assert jog_figures(Jogged(0.0)).is_gross
    assert jog_figures(Jogged(float("nan"))).is_gross


@pytest.mark.parametrize("noise", [0.0, 3.0])
@pytest.mark.parametrize("unit", [0.1, 1.0, 10.0, 1 / 166.7])
def test_the_stated_speed_shows_its_unit(unit: float, noise: float) -> None:
    figures = jog_figures(Jogged(speed=unit, noise_mm_s=2.0 * unit * noise))
    assert figures.speed_share == pytest.approx(1 / unit, rel=0.02)
    assert figures.mean_mm_s == pytest.approx(2.0)  # whatever the drive states


@pytest.mark.parametrize(
    ("polls_s", "mean_mm_s"), [([0.0, 3.0, 4.0], 5.0 / 3.0), ([0.0], 0.0), ([2.5, 3.0], 0.0)]
)
def test_a_jog_that_is_over_within_a_poll_has_a_mean_speed(
    polls_s: list[float], mean_mm_s: float
) -> None:
    assert jog_figures(Jogged(taken_s=polls_s)).mean_mm_s == pytest.approx(mean_mm_s)


def test_a_stop_is_measured_from_full_speed_to_rest() -> None:
    stop = stop_figures(Jogged())
    assert stop.speed_mm_s == pytest.approx(2.0)
    assert stop.distance_mm < 0.1
    assert stop.duration_s < 0.1
