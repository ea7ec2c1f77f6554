"""Rotations against scipy's, also where formulas lose digits: near no turn and near half a turn."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hilcell.geometry.frames import from_rotvec, from_zyx, to_rotvec

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
