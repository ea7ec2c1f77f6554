"""What a quick plan makes of a cell."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hilcell.calibration.grid import grid_of
from hilcell.cell.file import coarsest_pitch_mm, load_cell
from hilcell.cell.source import read_source
from hilcell.ports import HilcellError
from hilcell.run.order import Order


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


@pytest.mark.parametrize(
    ("words", "stated", "quick"),
    [
        ({}, "", True),
        ({"full": True}, "", False),
        ({"quick": True}, "[plan]\nquick = false\n", True),
        ({}, "[plan]\nquick = false\n", False),
        ({"settings": (("plan.quick", "false"),)}, "", False),
        ({"settings": (("plan.bound_mm", "0.1"),)}, "[plan]\nquick = true\n", True),
        ({"procedure": "robot-grid"}, "", False),
        ({"procedure": "robot-grid", "quick": True}, "", True),
    ],
)
def test_calibrate_is_quick_unless_another_plan_is_stated(
    tmp_path: Path, words: dict[str, Any], stated: str, quick: bool
) -> None:
    file = tmp_path / "cell.toml"
    file.write_text(f"{read_source('paper')}\n{stated}")
    planned = Order(cell=str(file), runs=tmp_path, dry_run=True, **words).check(print)
    assert planned.cell.plan.quick is quick
    assert load_cell(str(file), planned.settings) == planned.cell  # as a resume reads it


def test_one_plan_is_stated() -> None:
    with pytest.raises(HilcellError, match="--full and --quick"):
        Order(full=True, quick=True, runs=Path("r"), dry_run=True).check(print)
