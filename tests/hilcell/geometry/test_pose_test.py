"""The characteristics of ISO 9283, against sums written out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hilcell.geometry.pose_test import (
    CYCLE,
    cube_poses_mm,
    cube_side_mm,
    distance_figures,
    pose_figures,
    turn_figures,
)
from hilcell.geometry.rotations import to_rotvec

CENTRE_MM = np.array([1850.0, 10.0, 950.0])
POSES_MM = cube_poses_mm(CENTRE_MM, 900.0)
RNG = np.random.default_rng(9283)


def test_the_cube_is_the_largest_that_fits() -> None:
    assert cube_side_mm((900.0, 600.0, 1200.0)) == 600.0


def test_the_poses_lie_on_the_diagonals_of_one_plane() -> None:
    """10 % of the diagonal from its ends (6.8.5), so 40 % of it from the centre."""
    assert sorted(POSES_MM) == sorted(CYCLE)
    assert np.array_equal(POSES_MM["P1"], CENTRE_MM)
    diagonal_mm = 900.0 * math.sqrt(3.0)
    levers_mm = np.array([POSES_MM[f"P{n}"] - CENTRE_MM for n in range(2, 6)])
    assert np.linalg.norm(levers_mm, axis=1) == pytest.approx([0.4 * diagonal_mm] * 4)
    assert np.allclose(levers_mm[0], -levers_mm[2])  # P2 and P4, P3 and P5 on one diagonal each
    assert np.allclose(levers_mm[1], -levers_mm[3])
    assert np.linalg.matrix_rank(levers_mm) == 2


def test_accuracy_and_repeatability_of_a_pose() -> None:
    wanted = [100.0, 200.0, 300.0]
    attained = RNG.normal(wanted, 0.05, size=(30, 3)) + [0.3, -0.4, 1.2]
    found = pose_figures(attained, np.array(wanted))
    mean = [sum(row[axis] for row in attained) / 30 for axis in range(3)]
    off = [mean[axis] - wanted[axis] for axis in range(3)]
    assert found.ap_mm == pytest.approx(off)
    assert found.ap_p_mm == pytest.approx(math.sqrt(sum(each**2 for each in off)))
    l_mm = [math.sqrt(sum((row[axis] - mean[axis]) ** 2 for axis in range(3))) for row in attained]
    l_mean = sum(l_mm) / 30
    s_l = math.sqrt(sum((each - l_mean) ** 2 for each in l_mm) / 29)
    assert (found.l_mean_mm, found.s_l_mm) == pytest.approx((l_mean, s_l))
    assert found.rp_mm == pytest.approx(l_mean + 3 * s_l)


def test_the_measurement_s_noise_is_taken_off() -> None:
    robot = RNG.normal(scale=0.02, size=(3000, 3))
    seen = robot + RNG.normal(scale=0.01, size=(3000, 3))
    wanted_mm = pose_figures(robot, np.zeros(3)).rp_mm
    found = pose_figures(seen, np.zeros(3))
    assert found.rp_mm > 1.08 * wanted_mm
    assert found.rp_without_mm(3 * 0.01**2) == pytest.approx(wanted_mm, rel=0.03)
    assert found.rp_without_mm(1.0) == 0.0
    always_there = pose_figures(np.ones((4, 3)), np.zeros(3))
    assert always_there.rp_without_mm(0.01**2) == always_there.rp_without_mm(0.0) == 0.0


def test_accuracy_and_repeatability_of_a_distance() -> None:
    wanted = np.array([[0.0, 0.0, 0.0], [300.0, -400.0, 1200.0]])
    ends = tuple(RNG.normal(end, 0.03, size=(30, 3)) for end in wanted * 1.001)
    found = distance_figures((ends[0], ends[1]), wanted)
    lengths = [math.dist(one, other) for one, other in zip(*ends, strict=True)]
    mean = sum(lengths) / 30
    assert found.commanded_mm == pytest.approx(1300.0)
    assert found.ad_mm == pytest.approx(mean - 1300.0)
    assert found.rd_mm == pytest.approx(
        3 * math.sqrt(sum((each - mean) ** 2 for each in lengths) / 29)
    )
    along = [
        sum(abs(one[axis] - other[axis]) for one, other in zip(*ends, strict=True)) / 30
        for axis in range(3)
    ]
    assert found.ad_xyz_mm == pytest.approx([along[0] - 300.0, along[1] - 400.0, along[2] - 1200.0])


def test_stated_uncertainties_are_the_scatter_of_many_tests() -> None:
    """Of RP: l and S are not independent, and not normal; the figure is right to a quarter."""
    clouds = RNG.normal(size=(1600, 30, 3))
    found = [pose_figures(cloud, np.zeros(3)) for cloud in clouds]
    rp = np.array([each.rp_mm for each in found])
    assert np.mean([each.rp_u_mm for each in found]) == pytest.approx(rp.std(), rel=0.25)
    far = np.array([[5.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    ways = [
        distance_figures((cloud + far[0], other), far)
        for cloud, other in zip(clouds[:800], clouds[800:], strict=True)
    ]
    for name, u in (("ad_mm", "ad_u_mm"), ("rd_mm", "rd_u_mm")):
        spread = np.std([getattr(each, name) for each in ways])
        assert np.mean([getattr(each, u) for each in ways]) == pytest.approx(spread, rel=0.1)


def test_accuracy_and_repeatability_of_angles_by_scipy() -> None:
    """Attained orientations of a robot, made and read by scipy, in axes of the base."""
    rng = np.random.default_rng(41711)
    commanded = Rotation.from_euler("ZYX", [10.0, 70.0, 5.0], degrees=True)
    wanted_deg, scatter_deg = np.array([0.05, -0.03, 0.08]), np.array([0.01, 0.02, 0.005])
    angles_deg = wanted_deg + rng.normal(size=(30, 3)) * scatter_deg
    attained = Rotation.from_euler("xyz", angles_deg, degrees=True) * commanded
    turns_rad = to_rotvec(attained.as_matrix() @ commanded.as_matrix().T)
    found = turn_figures(turns_rad)
    peer_deg = (attained * commanded.inv()).as_euler("xyz", degrees=True)
    assert np.degrees(found.ap_rad) == pytest.approx(peer_deg.mean(axis=0), abs=2e-4)
    assert np.degrees(found.rp_rad) == pytest.approx(3.0 * peer_deg.std(axis=0, ddof=1), abs=2e-4)
    u = found.rp_u_rad / found.rp_rad
    assert u == pytest.approx([1.0 / math.sqrt(2.0 * 29.0)] * 3)
