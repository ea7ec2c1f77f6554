"""Training over real processes: one strikes and explains, another runs and resumes."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from fakes.exercises import EXERCISES, cell_exercises, page
from fakes.faults import KNOWN
from hilcell.alarms import catalogue
from hilcell.cell.file import load_cell
from tests.whole.bench import HILCELL, SMALL, command, end_of, sets
from tests.whole.test_alarms import ENDS

PAGE = Path(__file__).parents[2] / "docs/training.md"


@pytest.mark.process
def test_a_fault_is_practised(tmp_path: Path) -> None:
    titles = [each.title for each in EXERCISES]
    number = titles.index("the E-stop was pressed") + 1
    pipe = subprocess.PIPE
    words = [*HILCELL, "sim", "--train", "--speed", "max"]
    with subprocess.Popen(words, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as sim:
        assert sim.stdin is not None
        assert sim.stdout is not None
        assert sim.stderr is not None
        address = json.loads(sim.stdout.readline())["control"]
        sim.stdin.write(f"{number}\n")
        sim.stdin.flush()
        while "press Enter here" not in sim.stderr.readline():
            pass
        values = SMALL | {"simulation.address": address, "base_frame.points": "4"}
        where = ("--json", "--unattended", "--runs", tmp_path)
        done = command("run", "base-frame", "--name", "x", *where, *sets(values))
        assert end_of(done)["error"]["code"] == "HC-B10", done.stderr
        sim.stdin.write("\n")
        sim.stdin.flush()
        said = []
        while "repaired" not in (line := sim.stderr.readline()):
            said.append(line)
        assert "The fault was: the E-stop was pressed.\n" in said
        assert any(catalogue()["HC-B10"].do[0] in line for line in said)
        while "q ends" not in sim.stderr.readline():  # the menu again: the cell is healed
            pass
        resumed = command("resume", "x", *where)
        assert end_of(resumed)["exit"] == 0, resumed.stderr
        sim.stdin.write("q\n")
        sim.stdin.close()
        assert sim.wait() == 0


def test_each_exercise_is_a_fault_that_raises_its_alarm() -> None:
    for each in EXERCISES:
        assert each.fault in KNOWN
        assert catalogue()[each.alarm].specific
        if each.fault in ENDS[""]:
            assert each.alarm in ENDS[""][each.fault][0].split()
    assert len({each.title for each in EXERCISES}) == len(EXERCISES)


@pytest.mark.parametrize(("cell", "alarm"), [("paper", "15"), ("abb", "83"), ("lab", "66")])
def test_an_alarm_is_that_of_the_cell_s_robot(cell: str, alarm: str) -> None:
    found = {each.fault: each.alarm for each in cell_exercises(load_cell(cell))}
    assert found["robot.deselected"] == f"HC-B{alarm}"


def test_the_page_is_of_the_table() -> None:
    assert PAGE.read_text("utf-8") == page()
