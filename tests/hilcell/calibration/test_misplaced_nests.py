"""Floor nests that do not stand as the cell file says: which one, or which reflector."""

from __future__ import annotations

import numpy as np
import pytest

from hilcell.calibration.misplaced_nests import misplaced_nest, other_reflector
from hilcell.cell.file import load_cell
from hilcell.geometry.frames import apply, inverse, pose_from_zyx
from hilcell.ports import Array

CELL = load_cell("paper")
LIMIT_MM = 2 * CELL.layout.nest_tolerance_mm
NOMINAL_MM = np.array([nest.xyz_mm for nest in CELL.layout.floor])
NAMES = [nest.name for nest in CELL.layout.floor]


def seen(world_mm: Array, *turn_deg: float) -> Array:
    """Return nests (N, 3) in {W} as a tracker sees them that stands a little off its place."""
    T = CELL.tracker.pose.matrix() @ pose_from_zyx(5.0, -7.0, 3.0, *(turn_deg or (0.1, 0.1, 0.1)))
    return apply(inverse(T), world_mm)


@pytest.mark.parametrize("moved", range(len(NAMES)))
def test_a_nest_that_was_moved_is_named_with_its_place(moved: int) -> None:
    world_mm = NOMINAL_MM.copy()
    world_mm[moved] += [120.0, 160.0, 0.0]
    found = misplaced_nest(CELL, seen(world_mm), LIMIT_MM)
    assert found is not None
    assert found.name == NAMES[moved]
    assert found.off_mm == pytest.approx(200.0, abs=10.0)
    np.testing.assert_allclose(found.world_mm, world_mm[moved], atol=15.0)  # two nests remain
    assert other_reflector(CELL, seen(world_mm), LIMIT_MM) == ""


def test_two_moved_nests_or_none_are_not_one() -> None:
    assert misplaced_nest(CELL, seen(NOMINAL_MM + [[200, 0, 0], [0, 300, 0], [0, 0, 100]]),
                          LIMIT_MM) is None  # fmt: skip


@pytest.mark.parametrize(
    ("mounted_mm", "set_mm", "words"),
    [
        (19.05, 6.35, "1.5 in where the tracker is set to 0.5 in"),
        (6.35, 19.05, "0.5 in where the tracker is set to 1.5 in"),
        (11.1125, 19.05, "0.875 in where the tracker is set to 1.5 in"),
    ],
)
def test_a_reflector_of_another_radius_is_named(
    mounted_mm: float, set_mm: float, words: str
) -> None:
    at_mm = seen(NOMINAL_MM)
    along = at_mm / np.linalg.norm(at_mm, axis=1, keepdims=True)
    assert words in other_reflector(CELL, at_mm + (mounted_mm - set_mm) * along, LIMIT_MM)
    assert other_reflector(CELL, at_mm, LIMIT_MM) == ""
    assert other_reflector(CELL, at_mm + 40.0 * along, LIMIT_MM) == ""
