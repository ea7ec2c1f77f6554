"""Floor nests under other names, or in another order, span another {W}: they are refused."""

from __future__ import annotations

import msgspec
import pytest

from hilcell.cell.file import Cell
from hilcell.cell.layout import Nest
from hilcell.journal.journal import read_journal
from hilcell.journal.log import Log
from hilcell.journal.previous_reference import floor_before
from hilcell.journal.runs import JOURNAL
from hilcell.ports import DeviceError
from tests.whole.golden import GoldenRuns


@pytest.fixture
def cell(golden: GoldenRuns) -> Cell:
    return Log(read_journal(golden["small"].folder / JOURNAL)).cell


def with_floor(cell: Cell, floor: list[Nest]) -> Cell:
    layout = msgspec.structs.replace(cell.layout, floor=floor)
    return msgspec.structs.replace(cell, layout=layout)


def renamed(nests: list[Nest], names: list[str]) -> list[Nest]:
    return [
        msgspec.structs.replace(nest, name=name) for nest, name in zip(nests, names, strict=True)
    ]


def test_places_under_other_names_or_in_another_order_are_refused(
    golden: GoldenRuns, cell: Cell
) -> None:
    one, two, three = cell.layout.floor
    runs = golden["small"].runs
    assert floor_before(runs, cell, 1) is not None
    for floor in ([two, three, one], renamed([one, two, three], ["F2", "F3", "F1"])):
        with pytest.raises(DeviceError) as refused:
            floor_before(runs, with_floor(cell, floor), 1)
        assert refused.value.code == "HC-T32"
        assert refused.value.fields["nests"] == [nest.name for nest in floor]


def test_nests_that_were_moved_on_purpose_are_others(golden: GoldenRuns, cell: Cell) -> None:
    one, two, three = cell.layout.floor
    moved = msgspec.structs.replace(three, y_mm=three.y_mm + 100.0)
    assert floor_before(golden["small"].runs, with_floor(cell, [one, two, moved]), 1) is None
