"""A run is a simulated one when its cell is, or when a device says that it is."""

from pathlib import Path

import msgspec
import pytest

from hilcell.journal.index import row_of
from hilcell.journal.log import Log
from tests.hilcell.run.bed import PLAN, Bed
from tests.hilcell.run.rig import Points, procedure

CELL = {"name": "shop", "serial": "7", "grid": {"station": "S1"}}


def run_of(
    folder: Path, monkeypatch: pytest.MonkeyPatch, *, cell: bool, device: bool
) -> tuple[Log, Bed]:
    monkeypatch.setitem(PLAN, "simulated", cell)
    monkeypatch.setitem(PLAN, "cell", CELL)
    bed = Bed(folder)
    bed.rail.identity = msgspec.structs.replace(bed.rail.identity, simulated=device)
    for other in (bed.robot, bed.tracker):
        monkeypatch.setattr(other, "connect", list)
    assert bed.run(procedure(Points(1))) == 0
    return bed.log(), bed


@pytest.mark.parametrize(
    ("cell", "device"), [(False, False), (False, True), (True, False), (True, True)]
)
def test_what_a_device_says_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cell: bool, device: bool
) -> None:
    log, bed = run_of(tmp_path, monkeypatch, cell=cell, device=device)
    assert log.inputs.simulated is (cell or device)
    assert row_of(tmp_path).simulated is (cell or device)
    assert bed.records("plan")[0].body["simulated"] is cell  # frozen
