"""A robot on the floor and a tracker: runs without a rail keep every invariant."""

from __future__ import annotations

from pathlib import Path

import pytest

from hilcell.journal.index import find_run
from hilcell.journal.runs import read_log
from tests.whole.bench import SMALL, command, end_of, events, sets, simulation
from tests.whole.trace import judge

SHORT = SMALL | {"grid.pitch_mm": "900.0", "base_frame.points": "4"}


def test_the_grid_is_measured_without_a_rail(tmp_path: Path) -> None:
    with simulation(values=SHORT, name="fixed") as cell:
        words = sets(SHORT | {"simulation.address": cell.control})
        where = ("--cell", "fixed", "--runs", tmp_path)
        done = command("run", "robot-grid", "--json", "--unattended", *where, *words)
    assert end_of(done)["state"] == "finished", done.stderr
    assert judge(events(done.stdout)) == []
    log = read_log(find_run(tmp_path, "last"))
    assert {each.kind for each in log.assets} == {"robot", "tracker"}
    assert len(log.select("grid")) == 8
    assert not [event for event in log.events if event.body["what"] == "station held"]
    report = tmp_path / "report.html"
    assert command("report", "last", "--runs", tmp_path, "-o", report).returncode == 0
    assert "on the floor, without a rail" in report.read_text("utf-8")


def test_a_procedure_of_a_rail_is_refused(tmp_path: Path) -> None:
    done = command("run", "touch", "--cell", "fixed", "--runs", tmp_path)
    assert done.returncode == 2
    assert "touch refused before anything moves: cell fixed has no rail" in done.stderr


@pytest.mark.nightly
def test_a_robot_on_the_floor_is_calibrated_and_tested_with_its_correction(tmp_path: Path) -> None:
    where = ("--json", "--unattended", "--cell", "fixed", "--runs", tmp_path)
    quick = sets({"plan.quick": "true"})
    made = end_of(command("run", *where, "--seed", "7", "--name", "made", *quick))
    figures = made["result"]["validation"]
    assert (made["exit"], list(figures)) == (0, ["BASE"])
    assert figures["BASE"]["chosen"]["mean"] < 0.1 * figures["BASE"]["before"]["mean"]
    worst = {}
    for name, used in (("as it is", ()), ("corrected", sets({"iso9283.calibration": "made"}))):
        seeds = ("--seed", "8", "--machine-seed", "7", *sets({"iso9283.cycles": "5"}))
        found = end_of(command("run", "iso9283", *where, *seeds, *used))["result"]["iso9283"]
        worst[name] = found["worst"]["ap_mm"]
    assert found["corrected_by"] == "made"
    assert worst["corrected"] < 0.2 * worst["as it is"]
    holes = tmp_path / "holes.csv"
    holes.write_text("name,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg\nH1,0,0,1250,0,75,0\n")
    out = tmp_path / "out.csv"
    words = ("made", holes, "--station", "BASE", "-o", out, "--runs", tmp_path)
    assert command("compensate", *words).returncode == 0
    again = end_of(command("run", *where, "--seed", "9", "--machine-seed", "7", *quick))
    assert (again["exit"], again["result"]["suspicions"]) == (0, [])
    assert command("compare", "made", "last", "--runs", tmp_path).returncode == 0
