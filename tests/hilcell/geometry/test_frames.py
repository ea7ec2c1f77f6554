"""Rigid fits and frames: properties, refusals, and a peer."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from hilcell.geometry.frames import (
    FrameError,
    apply,
    from_rotvec,
    from_zyx,
    inverse,
    orientations,
    point_uncertainty,
    pose_from_zyx,
    rigid_fit,
    rotation_levers,
    three_point_frame,
    to_rotvec,
    zyx_from_pose,
)

angle = st.floats(-180, 180)
length = st.floats(-5000, 5000)
poses = st.builds(pose_from_zyx, length, length, length, angle, angle, angle)
seeds = st.integers(0, 2**32 - 1)
NESTS = np.array(
    [
        [350, -350, 60],
        [350, 350, 60],
        [-350, 350, 90],
        [-350, -350, 90],
        [300, 0, 420],
        [-300, 0, 450.0],
    ]
)


@given(poses, seeds, st.integers(3, 6))
def test_fit_recovers_the_motion(T: np.ndarray, seed: int, count: int) -> None:
    a = NESTS[:count] + np.random.default_rng(seed).uniform(-50, 50, (count, 3))
    fit = rigid_fit(a, apply(T, a))
    np.testing.assert_allclose(fit.T, T, atol=1e-9 * (1 + np.abs(T).max()))
    assert fit.rms_mm < 1e-8


@given(poses, poses, seeds)
def test_fit_moves_with_either_frame(P: np.ndarray, Q: np.ndarray, seed: int) -> None:
    rng = np.random.default_rng(seed)
    b = NESTS + rng.normal(0, 0.5, NESTS.shape)
    plain = rigid_fit(NESTS, b)
    moved = rigid_fit(apply(P, NESTS), apply(Q, b))
    np.testing.assert_allclose(moved.T, Q @ plain.T @ inverse(P), atol=1e-6)
    assert moved.rms_mm == pytest.approx(plain.rms_mm, abs=1e-8)
    tool = np.array([1850.0, 100.0, 950.0])
    assert point_uncertainty(moved, apply(P, tool[None])[0]) == pytest.approx(
        point_uncertainty(plain, tool), rel=1e-5
    )


@given(seeds)
def test_order_and_scale_of_weights_do_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    b, weights = NESTS + rng.normal(0, 0.5, NESTS.shape), rng.uniform(0.5, 2, len(NESTS))
    order = rng.permutation(len(NESTS))
    one = rigid_fit(NESTS, b, weights)
    two = rigid_fit(NESTS[order], b[order], 7 * weights[order])
    np.testing.assert_allclose(one.T, two.T, atol=1e-10)
    np.testing.assert_allclose(one.covariance, two.covariance, rtol=1e-8, atol=1e-15)


@given(seeds)
def test_plain_fit_agrees_with_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    b = NESTS + rng.normal(0, 0.5, NESTS.shape)
    peer, _ = Rotation.align_vectors(b - b.mean(axis=0), NESTS - NESTS.mean(axis=0))
    np.testing.assert_allclose(rigid_fit(NESTS, b).T[:3, :3], peer.as_matrix(), atol=1e-10)


def test_full_covariances_reach_the_least_cost() -> None:
    rng = np.random.default_rng(5)
    roots = rng.normal(0, 0.3, (6, 3, 3))
    covariances = roots @ np.swapaxes(roots, 1, 2) + 1e-3 * np.eye(3)
    b = NESTS + rng.normal(0, 0.5, NESTS.shape)
    best = rigid_fit(NESTS, b, covariances)
    W = np.linalg.inv(covariances)

    def cost(T: np.ndarray) -> float:
        r = b - apply(T, NESTS)
        return float(np.einsum("ni,nij,nj->", r, W, r))

    for _ in range(50):
        nudge = pose_from_zyx(*rng.normal(0, 0.01, 3), *rng.normal(0, 0.001, 3))
        assert cost(nudge @ best.T) > cost(best.T)


@pytest.mark.parametrize("absolute", [False, True])
def test_covariance_predicts_the_scatter_at_the_tool(absolute: bool) -> None:
    rng = np.random.default_rng(1)
    T, sigma, tool = (
        pose_from_zyx(1000, -2000, 300, 30, -20, 100),
        0.02,
        np.array([1850, 0, 950.0]),
    )
    covariances = np.tile(sigma**2 * np.eye(3), (6, 1, 1)) if absolute else None
    fits = [
        rigid_fit(NESTS, apply(T, NESTS) + rng.normal(0, sigma, NESTS.shape), covariances)
        for _ in range(250)
    ]
    errors = np.array([apply(fit.T, tool[None])[0] - apply(T, tool[None])[0] for fit in fits])
    seen = np.sqrt(np.mean(np.sum(errors**2, axis=1)))
    said = np.sqrt(np.mean([point_uncertainty(fit, tool) ** 2 for fit in fits]))
    assert said == pytest.approx(seen, rel=0.15 if absolute else 0.1)


@pytest.mark.parametrize(
    ("a", "b"),
    [
        (NESTS[:2], NESTS[:2]),
        (NESTS[:3], NESTS[:4]),
        (NESTS, np.where(np.arange(18).reshape(6, 3) == 7, np.nan, NESTS)),
        (np.outer([0, 1, 2], [100, 50, 20.0]), NESTS[:3]),
        (NESTS[:3], np.zeros((3, 3))),
        (NESTS, NESTS * [1, -1, 1]),
    ],
    ids=["two", "not one to one", "no number", "a line", "one place", "mirrored"],
)
def test_fit_refuses(a: np.ndarray, b: np.ndarray) -> None:
    with pytest.raises(FrameError):
        rigid_fit(a, b)


@pytest.mark.parametrize(
    "weights",
    [np.ones(5), np.zeros(6), np.full(6, np.nan), -np.ones(6), np.zeros((6, 3, 3))],
)
def test_fit_refuses_weights(weights: np.ndarray) -> None:
    with pytest.raises(FrameError):
        rigid_fit(NESTS, NESTS, weights)


def test_plane_nests_fit_although_noise_may_mirror_them() -> None:
    rng = np.random.default_rng(3)
    flat = NESTS[:4] * [1, 1, 0]
    for _ in range(50):
        a, b = flat + rng.normal(0, 0.05, flat.shape), flat + rng.normal(0, 0.05, flat.shape)
        assert rigid_fit(a, b).rms_mm < 0.3


@given(poses, seeds)
def test_three_point_frame_rides_on_the_slide(T: np.ndarray, seed: int) -> None:
    points = NESTS[:3] + np.random.default_rng(seed).uniform(-50, 50, (3, 3))
    here, there = three_point_frame(*points), three_point_frame(*apply(T, points))
    np.testing.assert_allclose(there, T @ here, atol=1e-8)


def test_three_point_frame_is_that_of_equations_14_to_16() -> None:
    T = three_point_frame([10, 20, 30], [10, 25, 30], [8, 21, 30])
    np.testing.assert_allclose(
        T, [[0, -1, 0, 10], [1, 0, 0, 20], [0, 0, 1, 30], [0, 0, 0, 1]], atol=1e-12
    )


@pytest.mark.parametrize("p3", [[2, 0, 0.01], [np.nan, 1, 0], [0, 0, 0]])
def test_three_point_frame_refuses(p3: list[float]) -> None:
    with pytest.raises(FrameError):
        three_point_frame([0, 0, 0], [1, 0, 0], p3)


@given(poses)
def test_kuka_angles_return(T: np.ndarray) -> None:
    np.testing.assert_allclose(pose_from_zyx(*zyx_from_pose(T)), T, atol=1e-9)


@given(poses)
def test_inverse_agrees_with_scipy(T: np.ndarray) -> None:
    np.testing.assert_allclose(
        inverse(T), RigidTransform.from_matrix(T).inv().as_matrix(), atol=1e-8
    )
    np.testing.assert_allclose(inverse(np.array([T, T]))[1], inverse(T))


angles = st.tuples(*[st.floats(-360.0, 360.0)] * 3)
directions = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1)
turns = st.floats(0.0, np.pi) | st.floats(0.0, 1e-3) | st.floats(np.pi - 1e-6, np.pi)


@given(angles)
@example((0.0, 90.0, 30.0))
def test_angles(a_b_c_deg: tuple[float, float, float]) -> None:
    wanted = Rotation.from_euler("ZYX", a_b_c_deg, degrees=True).as_matrix()
    np.testing.assert_allclose(from_zyx(a_b_c_deg), wanted, rtol=0, atol=1e-15)


@given(directions, turns)
@example((1.0, 0.0, 0.0), 0.0)
@example((0.6, 0.0, 0.8), 0.99999e-4)
@example((0.6, 0.0, 0.8), 1.00001e-4)
@example((0.0, 1.0, 0.0), np.pi)
def test_rotation_vectors_there_and_back(axis: tuple[float, float, float], turn: float) -> None:
    vector = turn * np.array(axis) / np.linalg.norm(axis)
    R = from_rotvec(vector)
    np.testing.assert_allclose(R, Rotation.from_rotvec(vector).as_matrix(), rtol=0, atol=1e-15)
    back = to_rotvec(R)
    np.testing.assert_allclose(np.linalg.norm(back), turn, rtol=0, atol=1e-14)
    np.testing.assert_allclose(from_rotvec(back), R, rtol=0, atol=2e-15)


def test_many_at_once() -> None:
    rng = np.random.default_rng(1)
    vectors = rng.uniform(-1.5, 1.5, (4, 5, 3))
    np.testing.assert_allclose(to_rotvec(from_rotvec(vectors)), vectors, rtol=0, atol=1e-14)
    degrees = rng.uniform(-180, 180, (4, 5, 3))
    np.testing.assert_allclose(from_zyx(degrees)[2, 3], from_zyx(degrees[2, 3]), rtol=0, atol=0)


@pytest.mark.process
def test_what_starts_an_engine_imports_no_scipy() -> None:
    """Its import alone takes longer than all else that is needed before a run."""
    modules = "hilcell.run.runner, procedures.calibrate, drivers.kuka.robot_c3"
    code = f"import sys, {modules}; sys.exit('scipy' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


PLACES_MM = np.array([[98.0, 0.0, 127.0], [-40.0, 110.0, 127.0], [-40.0, -110.0, 120.0]])


@given(seeds)
def test_a_body_is_turned_as_its_points_are_seen(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R = from_rotvec(rng.normal(0.0, 2.0, (4, 3)))
    seen_mm = np.einsum("nij,kj->nki", R, PLACES_MM) + rng.normal(0.0, 2000.0, (4, 1, 3))
    np.testing.assert_allclose(orientations(PLACES_MM, seen_mm), R, atol=1e-9)


@given(seeds)
def test_levers_are_the_derivative_of_the_orientation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R = from_rotvec(rng.normal(0.0, 2.0, (1, 3)))
    seen_mm = np.einsum("nij,kj->nki", R, PLACES_MM)
    off_mm = rng.normal(0.0, 1e-3, seen_mm.shape)
    turned = to_rotvec(orientations(PLACES_MM, seen_mm + off_mm) @ np.swapaxes(R, 1, 2))
    wanted = np.einsum("nkij,nkj->ni", rotation_levers(PLACES_MM, R), off_mm)
    np.testing.assert_allclose(turned, wanted, atol=1e-9)


def test_points_that_would_be_mirrored_are_turned() -> None:
    mirrored = PLACES_MM * [1.0, 1.0, -1.0]
    found = orientations(PLACES_MM, mirrored[None])
    np.testing.assert_allclose(np.linalg.det(found), 1.0)
