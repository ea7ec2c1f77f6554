"""A run knows the poses of the newest finished runs of its own cell."""

from pathlib import Path

import msgspec
import pytest

from hilcell.cell.file import load_cell
from hilcell.commands import run
from hilcell.journal.index import RunRow

CELL = load_cell("paper")
ROW = RunRow(name="", begun="", state="finished", cell=CELL.name, serial=CELL.serial)


def test_only_finished_runs_of_the_same_cell_count(monkeypatch: pytest.MonkeyPatch) -> None:
    kinds = [
        {"state": "faulted"},
        {"cell": "other"},
        {"serial": "other"},
        *[{"state": "finished"}] * 9,
    ]
    rows = [msgspec.structs.replace(ROW, name=f"{n}", **changes) for n, changes in enumerate(kinds)]
    monkeypatch.setattr(run, "read_index", lambda runs: rows)
    assert run._finished_runs(Path(), CELL) == ["3", "4", "5", "6", "7"]
    bare = msgspec.structs.replace(
        CELL, robot=msgspec.structs.replace(CELL.robot, envelope=None), keep_out=[]
    )
    assert run._finished_runs(Path(), bare) == []
