"""One reflector that differs from the others in the same nest is named, and how."""

from __future__ import annotations

import numpy as np
import pytest

from hilcell.calibration.instrument import compared_positions

NEST_MM = np.array([4400.0, 100.0, -1500.0])
BEAM = NEST_MM / np.linalg.norm(NEST_MM)
NAMES = ["F1", "F2", "F3", "B1", "B2", "flange"]
LIMIT_MM = 0.04


def seen(seed: int = 1) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return NEST_MM + 0.005 * np.random.default_rng(seed).standard_normal((len(NAMES), 3))


@pytest.mark.parametrize("prism_mm", [0.15, -0.5])
def test_a_prism_of_another_length_is_named(prism_mm: float) -> None:
    at_mm = seen()
    at_mm[5] += prism_mm * BEAM
    wrong = [
        each for each in compared_positions(NAMES, at_mm, np.full(6, LIMIT_MM)) if not each.holds
    ]
    assert [each.place for each in wrong] == ["flange"]
    assert wrong[0].along_mm == pytest.approx(prism_mm, abs=0.02)
    assert wrong[0].across_mm < 0.02


def test_reflectors_alike_hold() -> None:
    for seed in range(50):
        found = compared_positions(NAMES, seen(seed), np.full(6, LIMIT_MM))
        assert all(each.holds for each in found)


def test_a_place_that_is_no_number_holds_nothing() -> None:
    at_mm = seen()
    at_mm[2] = np.nan
    found = compared_positions(NAMES, at_mm, np.full(6, LIMIT_MM))
    assert not found[2].holds
