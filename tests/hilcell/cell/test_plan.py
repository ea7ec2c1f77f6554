"""What a quick plan makes of a cell."""

import numpy as np
import pytest

from hilcell.calibration.grid import grid_of
from hilcell.cell.file import coarsest_pitch_mm, load_cell


@pytest.mark.parametrize(
    ("cells", "pitch_mm"),
    [
        ((3, 3, 3), 450.0),
        ((1, 1, 1), 150.0),
        ((4, 4, 2), 600.0),
        ((2, 1, 1), 300.0),
        ((9, 6, 3), 900.0),
    ],
)
def test_a_coarse_grid_fills_the_box_with_two_cells_at_least(
    cells: tuple[int, ...], pitch_mm: float
) -> None:
    assert coarsest_pitch_mm(cells, 300.0) == pitch_mm
    counts = 300.0 * np.array(cells) / pitch_mm
    assert np.array_equal(counts, np.round(counts))
    assert counts.max() >= 2


def test_a_quick_grid_fills_the_same_cube() -> None:
    full, quick = (grid_of(load_cell("paper", {"plan.quick": each})) for each in ("false", "true"))
    assert quick.shape == (3, 3, 3)
    assert np.array_equal(quick.origin_mm, full.origin_mm)
    assert np.array_equal(quick.far_mm, full.far_mm)
