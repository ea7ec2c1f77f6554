"""A run knows the poses of the newest finished runs of its own cell."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

from hilcell.cell.file import load_cell
from hilcell.commands import run
from hilcell.journal.index import RunRow

CELL = load_cell("paper")
ROW = RunRow(
    name="", begun="", state="finished", cell=CELL.name, serial=CELL.serial, simulated=True
)


def test_only_finished_runs_of_the_same_cell_count(monkeypatch: pytest.MonkeyPatch) -> None:
    kinds: list[dict[str, Any]] = [
        {"state": "faulted"},
        {"cell": "other"},
        {"serial": "other"},
        {"replayed": True},
        {"simulated": False},
        *[{"state": "finished"}] * 9,
    ]
    rows = [msgspec.structs.replace(ROW, name=f"{n}", **changes) for n, changes in enumerate(kinds)]
    monkeypatch.setattr(run, "read_index", lambda runs: rows)
    assert run._finished_runs(Path(), CELL) == ["5", "6", "7", "8", "9"]
    real = msgspec.structs.replace(CELL, simulation=None)
    assert run._finished_runs(Path(), real) == ["4"]
    bare = msgspec.structs.replace(
        CELL, robot=msgspec.structs.replace(CELL.robot, envelope=None), keep_out=[]
    )
    assert run._finished_runs(Path(), bare) == []
