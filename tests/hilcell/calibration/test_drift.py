"""A robot that changes slowly is known by the slope of all its poses, and nothing else is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hilcell.calibration.diagnosis import PoseSeries
from hilcell.cell.file import load_cell
from hilcell.geometry.kinematics import forward
from hilcell.ports import Array
from procedures.plan import joints_for
from procedures.validate import targets

CELL = load_cell("paper")
ARM = CELL.robot.arm()
SIGMA_MM, STRIP_MM = 0.018, 0.006  # of a coordinate of a visit, of a hold
HOLDS = (110, 405, 225, 225, 12)  # poses: grid and what follows, three stations, closing
GROWTH_PER_K = 23e-6


def series(seed: int, *, growth: float = 0.0, slope: Array | None = None) -> PoseSeries:
    """Return the poses of a full plan, by an arm that grows; ``slope`` (N, 3) besides."""
    rng = np.random.default_rng(seed)
    drawn = targets(CELL, seed)["S1100"]
    joints_rad = joints_for(CELL, drawn[rng.integers(len(drawn), size=sum(HOLDS))])
    at_mm = forward(ARM, joints_rad)[:, :3, 3]
    share = np.linspace(0.0, 1.0, len(at_mm))
    warm_k = 0.8 * np.sin(2.0 * np.pi * (share * 1.2 + rng.uniform()))
    hold = np.repeat(np.arange(len(HOLDS), dtype=float), HOLDS)
    slips_mm = STRIP_MM * rng.standard_normal((len(HOLDS), 3))
    off_mm = SIGMA_MM * rng.standard_normal((len(at_mm), 3)) + slips_mm[hold.astype(int)]
    off_mm += growth * share[:, None] * at_mm
    off_mm += rng.uniform(0.0, 1.0) * GROWTH_PER_K * (warm_k - warm_k[0])[:, None] * at_mm
    if slope is not None:
        off_mm += share[:, None] * slope
    placed = np.diag([1.2e-4] * 3 + [1e-10] * 3)  # 11 um, 10 urad
    covariance_mm2 = np.tile(SIGMA_MM**2 * np.eye(3), (len(at_mm), 1, 1))
    return PoseSeries(
        off_mm, covariance_mm2, joints_rad, share, warm_k - warm_k[0], hold,
        np.tile(placed, (len(HOLDS), 1, 1)), GROWTH_PER_K, 81.0, 0.03,
    )  # fmt: skip


def test_a_room_that_swings_and_a_strip_that_slips_are_no_drift() -> None:
    assert [series(seed).drift_cause(ARM) for seed in range(30)] == [None] * 30


def small(seed: int) -> PoseSeries:
    """Return the poses of a small plan without sweeps, where any slope moves poses by more than one
    visit scatters: the ripple that is left is larger.
    """
    full, count, sigma_mm = series(seed), 123, 0.15
    return replace(
        full,
        off_mm=sigma_mm * np.random.default_rng(seed + 5).standard_normal((count, 3)),
        covariance_mm2=np.tile(sigma_mm**2 * np.eye(3), (count, 1, 1)),
        joints_rad=full.joints_rad[:count],
        share=np.linspace(0.0, 1.0, count),
        warm_k=np.zeros(count),
        hold=np.zeros(count),
        holds=full.holds[:1],
    )


def test_chance_is_no_drift_where_any_slope_would_matter() -> None:
    assert [small(seed).drift_cause(ARM) for seed in range(200)] == [None] * 200


@pytest.mark.parametrize("um_m", [25.0, -25.0])
def test_an_arm_that_grows_is_named_with_its_size(um_m: float) -> None:
    for seed in range(10):
        found = series(seed, growth=1e-6 * um_m).drift_cause(ARM)
        assert found is not None
        assert (found.cause, found.unit) == ("drift", "µm/m over the run, as of temperature")
        assert found.size == pytest.approx(um_m, abs=12.0)


def test_an_axis_that_creeps_is_named() -> None:
    found = series(1, slope=np.zeros(3)).drift_cause(ARM)
    assert found is None
    still = series(1)
    creeps = np.radians(0.004)
    before, after = (
        forward(ARM, still.joints_rad + turn * np.eye(6)[1])[:, :3, 3] for turn in (0.0, creeps)
    )
    found = series(1, slope=after - before).drift_cause(ARM)
    assert found is not None
    assert found.unit == "deg of axis 2 over the run, as of zero lost"
    assert found.size == pytest.approx(0.004, rel=0.4)


def test_less_than_one_visit_scatters_is_no_suspicion() -> None:
    slow = series(3, growth=13e-6)
    assert slow.drift_cause(ARM) is None
    assert replace(slow, floor_mm=0.0).drift_cause(ARM) is not None
