"""A hall that nobody has measured, as a process: it can be calibrated by who knows it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.whole.bench import command
from tests.whole.halls import unknown_hall, write_cell

pytestmark = pytest.mark.process


def test_a_hall_is_the_cell_that_its_right_file_describes(tmp_path: Path) -> None:
    """With a joint 3 that is coupled, and a drive that counts down."""
    with unknown_hall(tmp_path / "sheet", 4) as hall:
        tables = hall.right_cell()
        tables["simulation"] = {"simulator": "unknown", "address": hall.simulation.control}
        tables["plan"] = {"quick": True}
        file = write_cell(tables, tmp_path / "right.toml")
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
    assert len(listed.stdout.splitlines()) == 12
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
