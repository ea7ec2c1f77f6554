from __future__ import annotations

import pytest

from hilcell.cell.file import Cell, load_cell


@pytest.fixture(scope="session")
def cell() -> Cell:
    return load_cell("paper")
