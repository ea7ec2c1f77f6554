"""Nests by their distances, the base by poses, the rail by jogs: against drawn truths."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from hilcell.cell.file import load_cell
from hilcell.geometry.frames import apply, from_zyx, inverse, matrix
from hilcell.geometry.kinematics import Array, forward
from hilcell.identification.places import fit_base, rail_direction, rail_scale, recognised
from hilcell.identification.rail_motion import jog_figures, stop_figures

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
    seen_mm = NOMINAL_MM[:3]
    found = recognised(NOMINAL_MM, seen_mm, 1.0)
    assert [(each.nests, each.upright) for each in found] == [
        ((0, 1, 2), True),
        ((0, 2, 1), False),
    ]


@pytest.mark.parametrize("seed", range(4))
def test_base_and_reflector_follow_from_poses(seed: int) -> None:
    rng, arm = np.random.default_rng(seed), CELL.robot.arm()
    joints_rad = np.radians(np.array(CELL.robot.home_deg) + rng.uniform(-15, 15, (24, 6)))
    T_L_B = matrix(from_zyx(rng.uniform(-180, 180, 3)), rng.uniform(-3e3, 3e3, 3))
    seen_mm = apply(T_L_B, forward(arm, joints_rad)[:, :3, 3]) + rng.normal(
        scale=0.05, size=(24, 3)
    )
    supposed_mm = np.array(CELL.robot.smr_mm) + rng.uniform(-30, 30, 3)
    fit = fit_base(arm, joints_rad, seen_mm, supposed_mm)
    off_mm = np.r_[fit.T_L_B[:3, 3] - T_L_B[:3, 3], fit.smr_mm - CELL.robot.smr_mm]
    u_mm = np.sqrt(np.diag(fit.covariance))[[0, 1, 2, 6, 7, 8]]
    assert np.all(np.abs(off_mm) < 5 * u_mm)
    assert fit.rms_mm < 0.15
    assert np.linalg.norm(fit.predict_mm(arm, joints_rad) - seen_mm, axis=1).max() < 0.4


def test_an_arm_that_turns_the_other_way_does_not_fit() -> None:
    rng, arm = np.random.default_rng(1), CELL.robot.arm()
    joints_rad = np.radians(np.array(CELL.robot.home_deg) + rng.uniform(-15, 15, (24, 6)))
    turned = joints_rad * [1, 1, 1, 1, -1, 1]
    seen_mm = forward(arm, turned)[:, :3, 3]
    assert fit_base(arm, joints_rad, seen_mm, np.array(CELL.robot.smr_mm)).rms_mm > 3.0


def test_the_rail_s_direction_and_scale_follow_from_places() -> None:
    along = np.array([0.6, -0.8, 0.0])
    positions_mm = [0.0, 20.0, 100.0, 300.0]
    places_mm = np.outer(positions_mm, along * 1.01) + [5.0, 6.0, 7.0]
    assert rail_direction(positions_mm, places_mm) == pytest.approx(along)
    assert rail_scale(positions_mm, places_mm) == pytest.approx(1.01)


@dataclass
class Jogged:
    """A jog of 5 mm as the drive counts, at 2 mm/s."""

    scale: float = 1.0
    speed: float = 1.0
    stopped_by: str = ""
    taken_s: list[float] = field(default_factory=lambda: [0.01 * n for n in range(301)])

    @property
    def drive_mm(self) -> list[float]:
        return [min(2.0 * t, 5.0) for t in self.taken_s]

    @property
    def strip_mm(self) -> list[float]:
        return [self.scale * x + 700.0 for x in self.drive_mm]

    @property
    def velocity_mm_s(self) -> list[float]:
        return [2.0 * self.speed if x < 5.0 else 0.0 for x in self.drive_mm]


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


@pytest.mark.parametrize("unit", [0.1, 1.0, 10.0, 1 / 166.7])
def test_the_stated_speed_shows_its_unit(unit: float) -> None:
    assert jog_figures(Jogged(speed=unit)).speed_share == pytest.approx(1 / unit, rel=0.02)


def test_a_stop_is_measured_from_full_speed_to_rest() -> None:
    stop = stop_figures(Jogged())
    assert stop.speed_mm_s == pytest.approx(2.0)
    assert stop.distance_mm < 0.1
    assert stop.duration_s < 0.1
