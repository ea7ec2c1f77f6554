"""The orientation of a body by points on it: exact, and its derivative."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hilcell.geometry.frames import from_rotvec, orientations, rotation_levers, to_rotvec

PLACES_MM = np.array([[98.0, 0.0, 127.0], [-40.0, 110.0, 127.0], [-40.0, -110.0, 120.0]])
seeds = st.integers(0, 2**32 - 1)


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
