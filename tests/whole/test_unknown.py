"""A hall that nobody has measured, as a process: it can be calibrated by who knows it."""

from __future__ import annotations

import json
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest

from fakes.traps import TRAPS
from tests.whole.bench import command
from tests.whole.halls import differences, unknown_hall, write_cell

pytestmark = pytest.mark.process
WRONG: list[tuple[tuple[str | int, ...], object]] = [
    (("rail", "options", "drive_node"), 125),
    (("rail", "options", "counts_per_mm"), 1000.0),  # -1000
    (("rail", "options", "strip_counts_per_mm"), 90.0),
    (("rail", "options", "strip_zero_mm"), 0.0),
    (("rail", "options", "speed_unit"), "0.1 counts/s"),
    (("robot", "smr_mm"), [98.0, 0.0, 127.0]),
    (("robot", "joint", 2, "coupled_to"), None),
    (("robot", "joint", 5, "max_deg"), 350.0),
    (("tracker", "pose", "a_deg"), 178.0),
    (("tracker", "reflector"), "SMR 0.5in"),
    (("layout", "base", "x_mm"), -1850.0),
    (("layout", "slide", 3, "z_mm"), 40.0),
    (("layout", "floor", 1, "x_mm"), 1450.0),
]


def test_a_hall_is_the_cell_that_its_right_file_describes(tmp_path: Path) -> None:
    """With a joint 3 that is coupled, and a drive that counts down."""
    with unknown_hall(tmp_path / "sheet", 4) as hall:
        tables = hall.right_cell()
        tables["simulation"] = {"simulator": "unknown", "address": hall.simulation.control}
        tables["plan"] = {"quick": True}
        file = write_cell(tables, tmp_path / "right.toml")
        assert differences(file, hall) == []
        for n, (path, value) in enumerate(WRONG):
            other = deepcopy(tables)
            table: Any = other
            *keys, last = path
            for key in keys:
                table = table[key]
            table[last] = value
            assert differences(write_cell(other, tmp_path / f"{n}.toml"), hall), path
        hall.travel()
        done = command("run", "world-frame", "--cell", file, "--runs", tmp_path / "runs", "--json")
        travel = hall.travel()
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["state"] == "finished"
    assert max(travel["axes"]["excursion_deg"]) < 90.0
    assert travel["slide"]["excursion_mm"] + travel["axes"]["moving_s"] > 0.0


def test_sheet_and_traps_of_the_command(tmp_path: Path) -> None:
    listed = command("sim", "--traps")
    assert listed.returncode == 0
    assert [line.split()[0] for line in listed.stdout.splitlines()] == [*TRAPS]
    for words, said in (
        (("--trap", "drive-sing"), "drive-sign"),
        (("--sheet", tmp_path / "none"), "sheet"),
    ):
        refused = command("sim", *words)
        assert refused.returncode == 2
        assert said in refused.stderr
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(("trap", "code"), [("nodes-exchanged", "HC-R"), ("wrong-tool", "HC-B")])
def test_a_trap_is_found_by_a_run_of_a_file_that_was_right(
    tmp_path: Path, trap: str, code: str
) -> None:
    with unknown_hall(tmp_path / "sheet", 7) as hall:
        tables = hall.right_cell()
    with unknown_hall(tmp_path / "again", 7, trap=trap) as hall:
        for table, options in hall.sheet["addresses"].items():
            tables[table]["options"] |= options
        tables["simulation"] = {"simulator": "unknown", "address": hall.simulation.control}
        file = write_cell(tables, tmp_path / "right.toml")
        hall.travel()
        run = ("run", "calibrate", "--cell", file, "--runs", tmp_path / "runs", "--unattended")
        done = command(*run, "--json")
        travel = hall.travel()
    assert done.returncode in {2, 3}, done.stderr
    assert code in done.stderr + done.stdout
    assert travel["slide"]["excursion_mm"] < 0.3
    assert max(travel["axes"]["excursion_deg"]) < 1e-6
