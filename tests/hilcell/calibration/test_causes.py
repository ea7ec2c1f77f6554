"""Poses that were measured twice: chance explains them, or the cause that was put in is named.

The cause that an error names is the result of the run that it ends.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from hilcell.calibration.causes import Differences, zero_columns
from hilcell.cell.file import load_cell
from hilcell.errors import DeviceError
from hilcell.geometry.kinematics import forward
from hilcell.model.verdicts import Cause, Suspicion, blamed, suspected_in
from hilcell.ports import Array
from procedures.plan import poses_at
from tests.whole.bench import sweep

CELL = load_cell("paper")
ARM, ROBOT = CELL.robot.arm(), CELL.robot.nominal()
CENTRE_MM, HALF_MM = CELL.grid.centre.matrix()[:3, 3], np.array(CELL.grid.size_mm) / 2
SIGMA_MM, COUNT, FREEDOM = 0.025, 6, 81.0
RAIL = np.array([0.0, 1.0, 0.0])


def joints(seed: int) -> Array:
    rng = np.random.default_rng(seed)
    at_mm = CENTRE_MM + HALF_MM * rng.uniform(-1.0, 1.0, (COUNT, 3))
    return ROBOT.joints_for(poses_at(CELL, at_mm))


def measured(seed: int, moved_mm: Array, first: int = COUNT) -> Differences:
    """Return differences with noise, of which the first have moved."""
    rng = np.random.default_rng([seed, 1])
    noise_mm = SIGMA_MM * rng.standard_normal((COUNT, 3))
    noise_mm[:first] += moved_mm[:first]
    covariance = SIGMA_MM**2 * np.eye(3 * COUNT)
    return Differences(noise_mm, covariance, joints(seed), FREEDOM, RAIL, range(1, COUNT + 1))


def reoriented(seed: int, axis: int, deg: float) -> Array:
    at_rad = joints(seed)
    step = np.radians(deg) * np.eye(6)[axis - 1]
    moved: Array = (forward(ARM, at_rad + step) - forward(ARM, at_rad))[:, :3, 3]
    return moved


def grown(seed: int, share: float) -> Array:
    return share * forward(ARM, joints(seed))[:, :3, 3]


@pytest.mark.parametrize("seeds", [50, *sweep(500)])
def test_chance_is_no_change(seeds: int) -> None:
    found = [measured(seed, np.zeros((COUNT, 3))).change(ARM, "x") for seed in range(seeds)]
    assert sum(not each.holds for each in found) <= max(1, seeds // 100)
    assert all((each.suspicion is None) == each.holds for each in found)


@pytest.mark.parametrize(
    ("cause", "unit", "size", "moved"),
    [
        ("zero lost", "deg of axis 1", 0.05, lambda seed: reoriented(seed, 1, 0.05)),
        ("zero lost", "deg of axis 3", 0.05, lambda seed: reoriented(seed, 3, 0.05)),
        ("zero lost", "deg of axis 5", 0.3, lambda seed: reoriented(seed, 5, 0.3)),
        ("mount slipped", "mm", 0.5, lambda seed: np.tile([0.3, 0.0, 0.4], (COUNT, 1))),
        ("strip", "mm", 0.3, lambda seed: np.tile(0.3 * RAIL, (COUNT, 1))),
        ("temperature", "µm/m", 400.0, lambda seed: grown(seed, 4e-4)),
    ],
)
def test_a_cause_is_named_with_its_size(cause: str, unit: str, size: float, moved: object) -> None:
    named = 0
    for seed in range(10):
        assert callable(moved)
        first = 3 if seed % 2 else COUNT
        found = measured(seed, moved(seed), first).change(ARM, "re-visits")
        assert not found.holds
        assert found.suspicion is not None
        assert found.suspicion.noticed_by == "re-visits"
        if (found.suspicion.cause, found.suspicion.unit) == (cause, unit):
            named += 1
            assert found.suspicion.size == pytest.approx(size, rel=0.35)
    assert named >= 8, named


@pytest.mark.parametrize(
    ("slip_mm", "turn_deg", "cause", "size"),
    [
        ([0.0, 0.0, 0.0], 0.3, "zero lost", 0.3),
        ([0.4, 0.0, 0.0], 0.0, "mount slipped", 0.4),
        ([0.0, 0.3, 0.3], 0.0, "mount slipped", 0.42),
    ],
)
def test_a_lost_zero_of_axis_6_is_no_slip_of_the_mount(
    slip_mm: list[float], turn_deg: float, cause: str, size: float
) -> None:
    """One reflector does not tell it from a slip along the turn, which is the rarer cause."""
    for seed in range(10):
        rng = np.random.default_rng([seed, 4])
        at_rad = joints(seed) + rng.uniform(-0.5, 0.5, (COUNT, 6)) * [0, 0, 0, 1, 1, 1]
        step = np.radians(turn_deg) * np.eye(6)[5]
        poses = forward(ARM, at_rad)
        moved_mm = forward(ARM, at_rad + step)[:, :3, 3] - poses[:, :3, 3]
        moved_mm += poses[:, :3, :3] @ slip_mm + SIGMA_MM * rng.standard_normal((COUNT, 3))
        covariance = SIGMA_MM**2 * np.eye(3 * COUNT)
        found = Differences(moved_mm, covariance, at_rad, FREEDOM, RAIL, [COUNT])
        suspicion = found.change(ARM, "re-visits").suspicion
        assert suspicion is not None
        assert suspicion.cause == cause
        assert ("axis 6" in suspicion.unit) == (cause == "zero lost")
        assert suspicion.size == pytest.approx(size, rel=0.35)


def test_scatter_that_no_cause_explains_names_none() -> None:
    unknown = 0
    for seed in range(20):
        scatter_mm = 0.5 * np.random.default_rng([seed, 2]).standard_normal((COUNT, 3))
        found = measured(seed, scatter_mm).change(ARM, "re-visits")
        assert found.suspicion is not None
        unknown += found.suspicion.cause == "unknown"
    assert unknown >= 14, unknown


def test_joints_scatter_by_their_reach_and_are_no_change() -> None:
    """At the ends of the base frame's sweeps and in the cube; the covariance is that of thirty
    visits at three places of the cube, as a run has it.
    """
    base, alarms = CELL.base_frame, 0
    ends_deg = [np.add(base.axis_1_deg, [end, 0, 0, 0, 0, 0]) for end in base.axis_1_sweep_deg]
    ends_deg += [np.add(base.axis_6_deg, [0, 0, 0, 0, 0, end]) for end in base.axis_6_sweep_deg]
    for seed in range(400):
        rng = np.random.default_rng([seed, 5])
        at_rad = np.vstack([np.radians(ends_deg), joints(seed), joints(seed + 1)])
        levers, joint_rad = zero_columns(ARM, at_rad), 1e-5
        draws = joint_rad * rng.standard_normal((10, *at_rad.shape))
        visits_mm = np.einsum("nij,vnj->vni", levers, draws)[:, [5, 7, 9]]
        pooled = np.mean([np.cov(visits_mm[:, n], rowvar=False) for n in range(3)], axis=0)
        covariance = np.kron(np.eye(len(at_rad)), 2.0 * (pooled + 0.008**2 * np.eye(3)))
        draws = np.sqrt(2.0) * joint_rad * rng.standard_normal(at_rad.shape)
        moved_mm = np.einsum("nij,nj->ni", levers, draws)
        moved_mm += np.sqrt(2.0) * 0.008 * rng.standard_normal(moved_mm.shape)
        moments = [4, 7, 10, 13, len(at_rad)]
        found = Differences(moved_mm, covariance, at_rad, FREEDOM, RAIL, moments)
        alarms += not found.change(ARM, "re-visits").holds
    assert alarms <= 1, alarms


def test_wider_scatter_is_found_by_all_differences_together() -> None:
    """Twice as wide as the visits' own: a single cause shows in half of them."""
    found = []
    for seed in range(40):
        scatter_mm = 2.0 * SIGMA_MM * np.random.default_rng([seed, 3]).standard_normal((COUNT, 3))
        found.append(measured(seed, scatter_mm).change(ARM, "re-visits"))
    assert sum(not each.holds for each in found) >= 28


def test_not_a_number_does_not_hold() -> None:
    nowhere = np.full((COUNT, 3), np.nan)
    assert not measured(0, nowhere).change(ARM, "x").holds


STRIP = Suspicion(Cause.STRIP, 1.0, "mm", "slide nest at S300")


def ended_by(**fields: object) -> DeviceError:
    return DeviceError("HC-S10", "Rail", "hold S300", "beside it", fields=fields)


def test_an_error_names_its_cause_by_the_fields_of_a_suspicion() -> None:
    error = ended_by(**STRIP.facts, station="S300")
    assert suspected_in(blamed(error.facts())) == [STRIP]


@pytest.mark.parametrize(
    "facts",
    [
        {},
        ended_by(station="S300").facts(),
        ended_by(cause="strip").facts(),
        ended_by(**STRIP.facts | {"size": math.nan}).facts(),
        ended_by(**STRIP.facts | {"cause": "witchcraft"}).facts(),
    ],
)
def test_an_error_without_a_cause_blames_nothing(facts: dict[str, object]) -> None:
    assert blamed(facts) == {}
    assert suspected_in(blamed(facts)) == []
