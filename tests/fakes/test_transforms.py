"""Rotations of the simulated cell, against those of scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fakes.truth.transforms import rotation_vector

AXES = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.6, 0.0, -0.8], [-0.48, 0.64, 0.6]]


@pytest.mark.parametrize("angle_rad", [0.0, 1e-9, 1e-3, 1.0, 2.0, 3.1, np.pi - 1e-9])
@pytest.mark.parametrize("axis", AXES)
def test_a_rotation_vector_leads_back_to_its_rotation(axis: list[float], angle_rad: float) -> None:
    turned = Rotation.from_rotvec(angle_rad * np.array(axis))
    found = rotation_vector(turned.as_matrix())
    assert found == pytest.approx(turned.as_rotvec(), abs=1e-14)


@pytest.mark.parametrize("axis", AXES)
def test_half_a_turn_has_either_sign(axis: list[float]) -> None:
    turned = Rotation.from_rotvec(np.pi * np.array(axis))
    found = rotation_vector(turned.as_matrix())
    assert np.linalg.norm(found) == pytest.approx(np.pi)
    assert Rotation.from_rotvec(found).as_matrix() == pytest.approx(turned.as_matrix(), abs=1e-14)
