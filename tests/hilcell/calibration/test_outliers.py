"""Vertices that stand out are found at the spread that the grid itself shows."""

import numpy as np
import pytest

from hilcell.calibration.grid import outlying
from hilcell.geometry.kinematics import Array

SHAPE = (4, 4, 4)


def field_mm(seed: int, spread_mm: float, shape: tuple[int, int, int] = SHAPE) -> Array:
    """Return a smooth error of a millimetre with normal deviations from it."""
    rng = np.random.default_rng(seed)
    x, y, z = np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")
    smooth = np.stack([1 + x * y, z - 0.5 * x**2, y + 0.3 * z * z], axis=-1)
    return smooth + rng.normal(0.0, spread_mm, smooth.shape)


def found(errors_mm: Array, least_mm: float = 0.0) -> list[tuple[int, ...]]:
    return [tuple(map(int, at)) for at in np.argwhere(outlying(errors_mm, least_mm=least_mm))]


@pytest.mark.parametrize("spread_mm", [0.005, 0.06, 0.5])
def test_a_spike_of_eight_sigmas_is_found_and_nothing_else(spread_mm: float) -> None:
    """Whatever the size of the spread is, and at corners, edges, faces and inside."""
    for seed in range(5):
        for at in ((0, 0, 0), (0, 0, 1), (0, 2, 1), (1, 2, 1)):
            errors_mm = field_mm(seed, spread_mm)
            errors_mm[at] += spread_mm * np.array([-8.0, 8.0, 0.0])
            assert found(errors_mm) == [at]


@pytest.mark.parametrize("shape", [(3, 3, 3), (4, 4, 4), (3, 4, 7), (7, 7, 7)])
def test_sound_grids_raise_few_false_alarms(shape: tuple[int, int, int]) -> None:
    alarms = sum(len(found(field_mm(seed, 0.05, shape))) for seed in range(100))
    assert alarms <= 5  # 1 is expected


def test_a_smooth_field_has_none_however_small_the_deviations_are() -> None:
    assert found(field_mm(1, 0.0), least_mm=1e-9) == []


def test_less_than_a_reading_may_deviate_never_stands_out() -> None:
    errors_mm = field_mm(1, 0.001)
    errors_mm[1, 1, 1, 0] += 0.04
    assert found(errors_mm) == [(1, 1, 1)]
    assert found(errors_mm, least_mm=0.05) == []
