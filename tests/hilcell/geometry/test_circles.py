"""Circles and the base frame: exact data, a scipy peer, scatter as predicted, the paper's arm."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from hilcell.cell.file import load_cell
from hilcell.geometry.frames import (
    Circle,
    FrameError,
    apply,
    base_frame,
    base_frame_covariance,
    fit_circle,
    inverse,
    pose_from_zyx,
    reading_covariance,
)
from hilcell.geometry.kinematics import forward

CELL = load_cell("paper")
ARM = CELL.robot.arm()
seeds = st.integers(0, 2**32 - 1)
angle = st.floats(-180, 180)
length = st.floats(-3000, 3000)
poses = st.builds(pose_from_zyx, length, length, length, angle, angle, angle)
T_W_B = pose_from_zyx(-1850, -1100, 300, 1.5, -0.7, 0.4)


def arc(T: np.ndarray, radius: float, degrees: float, count: int = 12) -> np.ndarray:
    """Points on a circle about z of T, in order of positive rotation."""
    phi = np.radians(np.linspace(0, degrees, count))
    return apply(T, radius * np.column_stack([np.cos(phi), np.sin(phi), 0 * phi]))


def sweeps() -> tuple[np.ndarray, np.ndarray]:
    """The reflector's points in {W} on the sweeps of the paper cell."""
    table = CELL.base_frame
    points = []
    for axis, start, sweep in (
        (0, table.axis_1_deg, table.axis_1_sweep_deg),
        (5, table.axis_6_deg, table.axis_6_sweep_deg),
    ):
        joints = np.tile(np.radians(start), (12, 1))
        joints[:, axis] = np.radians(np.linspace(*sweep, 12))
        points.append(apply(T_W_B, forward(ARM, joints)[:, :3, 3]))
    return points[0], points[1]


@given(poses, st.floats(50, 3000), st.floats(60, 340))
def test_exact_circle_is_found(T: np.ndarray, radius: float, degrees: float) -> None:
    circle = fit_circle(arc(T, radius, degrees))
    scale = 1 + radius + np.abs(T[:3, 3]).max()
    np.testing.assert_allclose(circle.centre_mm, T[:3, 3], atol=1e-9 * scale)
    np.testing.assert_allclose(circle.axis, T[:3, 2], atol=1e-9)
    assert circle.radius_mm == pytest.approx(radius, abs=1e-9 * scale)


@given(poses, seeds)
def test_order_decides_the_axis(T: np.ndarray, seed: int) -> None:
    points = arc(T, 500, 200) + np.random.default_rng(seed).normal(0, 0.02, (12, 3))
    there, back = fit_circle(points), fit_circle(points[::-1])
    assert there.axis @ T[:3, 2] > 0.99
    np.testing.assert_allclose(back.axis, -there.axis, atol=1e-9)
    np.testing.assert_allclose(fit_circle(points[::-1], turn=-1.0).axis, there.axis, atol=1e-9)


@settings(max_examples=10)
@given(seeds, st.floats(80, 330))
def test_circle_agrees_with_a_peer_by_scipy(seed: int, degrees: float) -> None:
    rng = np.random.default_rng(seed)
    T = pose_from_zyx(*rng.uniform(-2000, 2000, 3), *rng.uniform(-180, 180, 3))
    points = arc(T, 800, degrees) + rng.normal(0, 0.05, (12, 3))

    def distances(x: np.ndarray) -> np.ndarray:
        axis = T[:3, :3] @ np.array([x[3], x[4], 1.0])
        axis /= np.linalg.norm(axis)
        lever = points - (T[:3, 3] + x[:3])
        along = lever @ axis
        radial = np.linalg.norm(np.cross(lever, axis), axis=1)
        return np.concatenate([along, radial - 800 - x[5]])

    peer = least_squares(
        distances, np.zeros(6), jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac"
    )
    circle = fit_circle(points)
    axis = T[:3, :3] @ np.array([peer.x[3], peer.x[4], 1.0])
    assert np.sum(circle.residuals_mm**2) == pytest.approx(2 * peer.cost, rel=1e-9)
    np.testing.assert_allclose(circle.axis, axis / np.linalg.norm(axis), atol=1e-6)
    np.testing.assert_allclose(circle.centre_mm, T[:3, 3] + peer.x[:3], atol=1e-3)
    assert circle.radius_mm == pytest.approx(800 + peer.x[5], abs=1e-3)


def test_covariance_predicts_the_scatter() -> None:
    rng = np.random.default_rng(4)
    T = pose_from_zyx(100, 200, 300, 10, 20, 30)
    clean = arc(T, 900, 90)
    circles = [fit_circle(clean + rng.normal(0, 0.02, clean.shape)) for _ in range(250)]
    said = np.mean([np.diag(c.covariance) for c in circles], axis=0)
    seen = np.var([[*c.centre_mm, *c.axis] for c in circles], axis=0)
    np.testing.assert_allclose(said, seen, rtol=0.3)


def test_three_points_leave_no_covariance() -> None:
    circle = fit_circle(arc(np.eye(4), 100, 200, count=3))
    assert np.isnan(circle.covariance).all()
    assert circle.rms_mm < 1e-9


@pytest.mark.parametrize(
    ("points", "turn"),
    [
        (arc(np.eye(4), 900, 3), 1.0),
        (arc(np.eye(4), 100, 200)[:2], 1.0),
        (np.full((5, 3), np.nan), 1.0),
        (arc(np.eye(4), 100, 200), 0.0),
        (arc(np.eye(4), 100, 200), np.nan),
    ],
    ids=["nearly a line", "two points", "no numbers", "no turn", "turn is no number"],
)
def test_circle_refuses(points: np.ndarray, turn: float) -> None:
    with pytest.raises(FrameError):
        fit_circle(points, turn)


def height_of_axis_6() -> float:
    """The nominal height of axis 6's circle above {B}."""
    flange = forward(ARM, np.radians(CELL.base_frame.axis_6_deg)) @ inverse(ARM.tool)
    return float(flange[2, 3])


def test_base_frame_of_the_paper_cell_is_found() -> None:
    one, six = sweeps()
    for turn in (1.0, -1.0):  # the sense of axis 6 is not needed
        circles = fit_circle(one, turn=ARM.sign[0]), fit_circle(six, turn=turn)
        np.testing.assert_allclose(base_frame(*circles, height_of_axis_6()), T_W_B, atol=1e-8)


def test_base_frame_covariance_predicts_the_scatter() -> None:
    rng = np.random.default_rng(9)
    one, six = sweeps()
    said, seen = [], []
    for _ in range(150):
        circles = [
            fit_circle(points + rng.normal(0, 0.02, points.shape), turn=turn)
            for points, turn in ((one, ARM.sign[0]), (six, ARM.sign[5]))
        ]
        T = base_frame(circles[0], circles[1], height_of_axis_6())
        said.append(np.diag(base_frame_covariance(circles[0], circles[1], height_of_axis_6())))
        turn = (T[:3, :3] @ T_W_B[:3, :3].T)[[2, 0, 1], [1, 2, 0]]
        seen.append([*(T[:3, 3] - T_W_B[:3, 3]), *turn])
    np.testing.assert_allclose(np.mean(said, axis=0), np.mean(np.square(seen), axis=0), rtol=0.35)


@pytest.mark.parametrize("between_deg", [0.0, 4.0])
def test_base_frame_refuses_nearly_parallel_axes(between_deg: float) -> None:
    one = fit_circle(arc(np.eye(4), 500, 200))
    six = fit_circle(arc(pose_from_zyx(1500, 0, 1800, 0, between_deg, 0), 98, 300))
    with pytest.raises(FrameError, match=f"{between_deg:.1f} deg"):
        base_frame(one, six, 100.0)


def test_readings_that_scatter_more_in_one_direction_move_the_frame_as_predicted() -> None:
    """The residuals hide it: those along the axis turn it, and the others do not."""
    std_mm = np.array([0.02, 0.3, 0.02])
    rng, exact = np.random.default_rng(3), sweeps()
    covariances = np.tile(np.diag(std_mm**2), (12, 1, 1))

    def fitted(noise: float) -> list[Circle]:
        return [fit_circle(each + noise * rng.normal(0, std_mm, each.shape)) for each in exact]

    predicted = [
        reading_covariance(circle, each, covariances)
        for circle, each in zip(fitted(0.0), exact, strict=True)
    ]
    found = [fitted(1.0) for _ in range(200)]
    for which, covariance in enumerate(predicted):
        circles = [each[which] for each in found]
        rows = [np.r_[each.centre_mm, each.axis, each.radius_mm] for each in circles]
        scatter = np.std(rows, axis=0)
        np.testing.assert_allclose(scatter, np.sqrt(np.diag(covariance)), rtol=0.2, atol=1e-6)
