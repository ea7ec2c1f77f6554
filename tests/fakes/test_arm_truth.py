from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from fakes.arm_truth import (
    HALF_GAP_RAD,
    MAX_ERROR_MM,
    MEAN_ERROR_MM,
    RIPPLE_RAD,
    ArmTruth,
    _cube,
    _draw_ripple,
)
from hilcell.calibration import grid_of
from hilcell.cell import Cell
from hilcell.compensation.correction import corrected
from hilcell.compensation.interpolation import METHODS
from hilcell.geometry.circles import base_frame, fit_circle
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.kinematics import Array, forward
from procedures.base_frame import axis_6_height_mm, sweep
from procedures.plan import joints_for

SEEDS = range(10)
UP = np.ones(6)


@pytest.mark.parametrize("seed", SEEDS)
def test_mean_error_over_the_cube_is_the_papers(cell: Cell, seed: int) -> None:
    arm = ArmTruth(cell, np.random.default_rng(seed))
    targets_mm, commands_rad = _cube(cell)
    nominal_mm = forward(cell.robot.arm(), commands_rad)[:, :3, 3]
    np.testing.assert_allclose(nominal_mm, targets_mm, atol=1e-6)
    errors = np.linalg.norm(arm.errors_mm(commands_rad, targets_mm), axis=1)
    assert len(errors) == 216
    assert errors.mean() == pytest.approx(MEAN_ERROR_MM, abs=1e-9)
    assert 1.3 < errors.max() <= MAX_ERROR_MM


def test_ideal_base_is_what_noise_free_circles_find(cell: Cell) -> None:
    arm = ArmTruth(cell, np.random.default_rng(4))
    axis_1, axis_6 = (
        fit_circle(arm.pose(joints, np.ones_like(joints), np.zeros(6))[:, :3, 3], turn=-1.0)
        for joints in (sweep(cell, 1), sweep(cell, 6))
    )
    found = base_frame(axis_1, axis_6, axis_6_height_mm(cell))
    # The sweep's own ripple moves points along their circle only.
    np.testing.assert_allclose(found, arm.ideal_base, atol=1e-6)


def test_ripple_has_the_wanted_rms() -> None:
    turn = np.linspace(0.0, 2 * np.pi, 20_000, endpoint=False)
    for seed in SEEDS:
        amplitude, cycles, phase = _draw_ripple(np.random.default_rng(seed))
        ripple = (
            amplitude[:, None] * np.sin(cycles[:, None] * turn[:, None] + phase[:, None])
        ).sum(axis=-1)
        np.testing.assert_allclose(np.sqrt((ripple**2).mean(axis=1)), RIPPLE_RAD, rtol=1e-6)
        used = cycles[amplitude > 0]
        assert used.min() >= 30
        assert used.max() <= 500


def test_side_of_approach_shows_as_lost_motion(cell: Cell) -> None:
    arm = ArmTruth(cell, np.random.default_rng(1))
    joints = np.radians(cell.base_frame.axis_1_deg)
    up, down = (arm.pose(joints, side * UP, np.zeros(6))[:3, 3] for side in (1, -1))
    reach_mm = float(np.hypot(*up[:2]))
    assert 0.3 < np.linalg.norm(up - down) / (2 * HALF_GAP_RAD * reach_mm) < 3.0


@pytest.mark.parametrize("seed", SEEDS)
def test_paper_methods_leave_what_the_study_says(cell: Cell, seed: int) -> None:
    """The paper's IDW leaves about a tenth of the error; trilinear less; ripple is the rest."""
    arm = ArmTruth(cell, np.random.default_rng(seed))
    rng = np.random.default_rng([seed, 1])
    grid = grid_of(cell)
    index = np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), axis=-1)
    vertices_mm = grid.origin_mm + index * grid.pitch_mm

    def measured_mm(targets_mm: Array, commands_mm: Array) -> Array:
        joints = joints_for(cell, commands_mm)
        landing = 16.6e-6 * rng.standard_normal(joints.shape)
        at_mm = arm.pose(joints, np.ones_like(joints), landing)[:, :3, 3]
        noise_mm = 0.01 * rng.standard_normal(at_mm.shape)
        return apply(inverse(arm.ideal_base), at_mm) - targets_mm + noise_mm

    flat_mm = vertices_mm.reshape(-1, 3)
    errors_mm = measured_mm(flat_mm, flat_mm).reshape(vertices_mm.shape)
    size_mm = np.array(cell.grid.size_mm)
    targets_mm = grid.origin_mm + rng.uniform(0.01, 0.99, (400, 3)) * size_mm
    left = {}
    for name in ("idw", "trilinear"):
        commands = corrected(grid, targets_mm, partial(METHODS[name], grid, errors_mm))
        left[name] = float(np.linalg.norm(measured_mm(targets_mm, commands), axis=1).mean())
    assert 0.09 < left["idw"] < 0.18
    assert 0.08 < left["trilinear"] < 0.14


def test_same_seed_same_arm(cell: Cell) -> None:
    joints = np.radians(cell.robot.home_deg)
    poses = [
        ArmTruth(cell, np.random.default_rng(seed)).pose(joints, UP, np.zeros(6))
        for seed in (5, 5, 6)
    ]
    assert np.array_equal(poses[0], poses[1])
    assert not np.allclose(poses[0], poses[2], atol=0.01)
