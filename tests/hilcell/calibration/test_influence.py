"""Small motions move targets by their levers: figures worked out by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hilcell.calibration.influence import (
    MEASURED,
    MODEL,
    Bounds,
    Frame,
    Influence,
    Part,
    combined_bounds,
    motion,
    moved_frame,
)
from hilcell.geometry.frames import from_rotvec, pose_from_zyx
from hilcell.ports import Array

TARGET = np.array([[0.0, 0.0, 2000.0]])


def influence(covariance: list[list[float]], frame: Frame = "world", **more: Any) -> Influence:
    return Influence("it", MEASURED, "somehow", "4.2", frame, covariance, **more)


def variances(found: Array) -> list[float]:
    (covariance,) = found
    np.testing.assert_allclose(covariance, covariance.T)
    diagonal: list[float] = np.diag(covariance).tolist()
    return diagonal


def test_a_shift_is_the_same_everywhere_and_turns_with_its_frame() -> None:
    shift = influence(motion(np.diag([1.0, 4.0, 9.0])), "base")
    turned = pose_from_zyx(100, 200, 300, 90, 0, 0)
    assert variances(shift.at(np.eye(4), TARGET)) == pytest.approx([1, 4, 9])
    assert variances(shift.at(turned, TARGET)) == pytest.approx([4, 1, 9])


def test_a_rotation_counts_by_its_lever() -> None:
    turn = influence(motion(0.0, (20e-6) ** 2), origin_mm=(0.0, 0.0, 500.0))
    across = (1500.0 * 20e-6) ** 2
    assert variances(turn.at(np.eye(4), TARGET)) == pytest.approx([across, across, 0])


def test_growth_goes_away_from_the_origin_of_the_frame() -> None:
    grown = influence(motion(growth=(1e-5) ** 2), "base")
    at_1_m = pose_from_zyx(0, 0, 1000, 0, 0, 0)
    assert variances(grown.at(at_1_m, TARGET)) == pytest.approx([0, 0, 1e-4])


def test_the_tool_s_own_lever_turns_with_each_target() -> None:
    drill = influence(motion(0.0, (1e-3) ** 2), "tool", origin_mm=(0.0, 0.0, -100.0))
    poses = np.array([pose_from_zyx(0, 0, 2000, 0, 0, 0), pose_from_zyx(0, 0, 2000, 0, 90, 0)])
    found = drill.at(poses, poses[:, :3, 3])
    assert np.diag(found[0]).tolist() == pytest.approx([0.01, 0.01, 0])
    assert np.diag(found[1]).tolist() == pytest.approx([0, 0.01, 0.01])


def test_drawn_motions_have_this_covariance() -> None:
    rng = np.random.default_rng(5)
    root = rng.standard_normal((7, 7)) * np.array([[1e-2] * 3 + [1e-5] * 3 + [1e-5]]).T
    T, origin = pose_from_zyx(100, -50, 30, 20, 40, -60), np.array([10.0, 20.0, 30.0])
    draws = rng.standard_normal((40_000, 7)) @ root.T
    lever = np.linalg.inv(T) @ np.append(TARGET[0], 1.0)
    lever = lever[:3] - origin
    moved = (draws[:, :3] + np.cross(draws[:, 3:6], lever) + draws[:, 6:] * lever) @ T[:3, :3].T
    found = influence((root @ root.T).tolist(), "base", origin_mm=tuple(origin)).at(T, TARGET)[0]
    np.testing.assert_allclose(found, np.cov(moved.T), atol=0.02 * np.trace(found))


def test_a_frame_s_covariance_has_no_growth() -> None:
    whole = np.array(moved_frame(np.diag(np.arange(1.0, 7.0))))
    np.testing.assert_array_equal(np.diag(whole), [1, 2, 3, 4, 5, 6, 0])


def test_parts_add_up_and_the_model_s_turns_with_the_base() -> None:
    R = from_rotvec(np.array([0.0, 0.0, np.pi / 2]))
    T_W_B = np.eye(4)
    T_W_B[:3, :3] = R
    model_mm2 = np.diag([1.0, 4.0, 9.0])[None]
    found = combined_bounds(model_mm2, [influence(motion(1.0))], T_W_B, np.eye(4)[None])
    assert [part.name for part in found.parts] == [MODEL, "it"]
    np.testing.assert_allclose(found.covariance_mm2, [np.diag([5.0, 2.0, 10.0])], atol=1e-12)
    assert found.parts[1].u_mm == pytest.approx(1.0)


def test_a_frame_s_rotation_acts_at_the_drill_and_not_at_the_reflector() -> None:
    """By finite differences: poses are moved as a whole, with the drill on them."""
    rng, drill_mm, origin_mm = np.random.default_rng(8), np.array([30.0, -40.0, 500.0]), (9.0, 8, 7)
    root = rng.standard_normal((6, 6)) * np.array([[1e-2] * 3 + [4e-5] * 3]).T
    frame = influence(moved_frame(root @ root.T), origin_mm=origin_mm)
    poses = np.stack([pose_from_zyx(100, 200, 300, *zyx) for zyx in ((0, 0, 0), (20, 80, -130))])
    tips_mm = poses[:, :3, 3] + poses[:, :3, :3] @ drill_mm
    step = 1e-6
    J = np.zeros((2, 3, 6))
    for axis in range(3):
        J[:, axis, axis] = 1.0
        R = from_rotvec(step * np.eye(3)[axis])
        moved_mm = (tips_mm - origin_mm) @ R.T + origin_mm
        J[:, :, 3 + axis] = (moved_mm - tips_mm) / step
    found = combined_bounds(np.zeros((2, 3, 3)), [frame], np.eye(4), poses, drill_mm=drill_mm)
    wanted_mm2 = J @ root @ root.T @ np.swapaxes(J, 1, 2)
    np.testing.assert_allclose(found.covariance_mm2, wanted_mm2, rtol=1e-5, atol=1e-7)
    without = combined_bounds(np.zeros((2, 3, 3)), [frame], np.eye(4), poses)
    assert (np.abs(found.covariance_mm2 - without.covariance_mm2).max(axis=(1, 2)) > 1e-5).all()


def test_few_samples_widen_the_bound() -> None:
    def bound(freedom: float) -> float:
        part = Part("it", MEASURED, "", "", np.eye(3)[None], freedom)
        return float(Bounds([part]).radii_mm[0])

    assert bound(np.inf) == pytest.approx(2.795, abs=1e-3)
    assert bound(10.0) == pytest.approx(3.336, abs=1e-3)  # sqrt(3 F(3, 10))


def test_what_the_model_has_in_counts_once() -> None:
    """Of 9, 4 and 1 mm2 repeatability has 4: the model keeps what exceeds it."""
    visits = influence(motion(4.0), in_model=True)
    model_mm2 = np.diag([9.0, 4.0, 1.0])[None]
    found = combined_bounds(model_mm2, [visits], np.eye(4), np.eye(4)[None])
    np.testing.assert_allclose(found.parts[0].covariance_mm2[0], np.diag([5.0, 0, 0]), atol=1e-12)
    np.testing.assert_allclose(found.covariance_mm2[0], np.diag([9.0, 4.0, 4.0]), atol=1e-12)


def test_a_model_from_few_poses_has_few_degrees_of_freedom() -> None:
    model_mm2 = np.eye(3)[None]
    few, many = (
        combined_bounds(model_mm2, [], np.eye(4), np.eye(4)[None], samples) for samples in (4, None)
    )
    assert few.parts[0].freedom == pytest.approx(12.0)
    assert few.radii_mm[0] > 1.1 * many.radii_mm[0]
