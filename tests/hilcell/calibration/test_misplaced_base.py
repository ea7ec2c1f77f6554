"""A base that is not where the cell file says, with the cause that fits."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from hilcell.calibration.diagnosis import misplaced_base
from hilcell.cell.file import Cell, load_cell
from hilcell.journal.log import Log
from tests.hilcell.verdicts import BASE


class Based(Log):
    """A base measured ``off_mm`` (3,) beside its place in the cell file."""

    def __init__(self, cell: Cell, off_mm: list[float]) -> None:
        super().__init__()
        self._cell = cell
        matrix = cell.layout.nominal_base(cell.reference.rail_mm)
        matrix[:3, 3] += off_mm
        self.frames["base"] = replace(BASE, matrix=matrix.tolist())

    @property
    def cell(self) -> Cell:
        assert self._cell is not None
        return self._cell


CELL = load_cell("paper")
BOLTED = [1.5, -2.0, 0.8]  # as far as bolts and nests let it


@pytest.mark.parametrize(
    ("higher_mm", "unit"),
    [
        (12.7, "mm along z of {W}, as of 0.5 in reflectors in floor nests for 1.5 in"),
        (-12.7, "mm along z of {W}, as of 1.5 in reflectors in floor nests for 0.5 in"),
    ],
)
def test_reflectors_of_another_size_in_all_nests_are_named(higher_mm: float, unit: str) -> None:
    found = misplaced_base(Based(CELL, [BOLTED[0], BOLTED[1], higher_mm]))
    assert found is not None
    assert (found.cause, found.unit) == ("reflector", unit)
    assert found.size == pytest.approx(higher_mm)


def test_a_base_elsewhere_is_misplaced_beyond_its_tolerance_only() -> None:
    assert misplaced_base(Based(CELL, BOLTED)) is None
    found = misplaced_base(Based(CELL, [30.0, 0.0, 0.0]))
    assert found is not None
    assert found.cause == "base misplaced"
    assert found.size == pytest.approx(30.0)
    wide = load_cell("paper", {"layout.base_tolerance_mm": "40.0"})
    assert misplaced_base(Based(wide, [30.0, 0.0, 0.0])) is None
    assert misplaced_base(Based(CELL, [np.nan, 0.0, 0.0])) is not None


def test_without_circles_nothing_is_known() -> None:
    log = Based(CELL, [30.0, 0.0, 0.0])
    log.frames.clear()
    assert misplaced_base(log) is None
