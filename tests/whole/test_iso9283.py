"""The pose test of ISO 9283 as its users run it, on a robot without a rail."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hilcell.cell.file import load_cell
from hilcell.geometry.statistics import lengths_mm
from hilcell.ports import HilcellError
from hilcell.report.budgets import TargetBudget
from hilcell.report.facts import read_facts
from hilcell.report.first_page import Certificate, FirstPage
from procedures.iso9283 import PoseCycle
from tests.hilcell.report.test_every_procedure import assert_references_resolve
from tests.whole.bench import SEATS, command, cut, end_of, events, ran, simulation
from tests.whole.golden import POSES, GoldenRun, GoldenRuns

pytestmark = pytest.mark.waits
CYCLES = int(POSES["iso9283.cycles"])
FIXED = ("--cell", "fixed")
SHORT = {key: value for key, value in POSES.items() if not key.endswith("limit_mm")}


@pytest.fixture
def tested(golden: GoldenRuns) -> GoldenRun:
    return golden["pose-test"]


def exported(runs: Path, name: str, file: Path) -> dict[str, Any]:
    assert command("export", name, "--runs", runs, "--json", "-o", file).returncode == 0
    found: dict[str, Any] = json.loads(file.read_text("utf-8"))
    return found


def test_a_pose_is_approached_from_the_one_before_it(tested: GoldenRun) -> None:
    intents = [event for event in tested.events if event["kind"] == "intent"]
    moves = [event for event in intents if event.get("key", "").startswith("iso")]
    assert [move["key"].split("/")[1] for move in moves] == ["P5", "P4", "P3", "P2", "P1"] * CYCLES
    for before, move in zip([moves[-1], *moves], moves, strict=False):
        assert move["from_deg"] == before["joints_deg"]


def test_its_figures_are_those_of_the_exported_points(tested: GoldenRun, tmp_path: Path) -> None:
    found = tested.result["iso9283"]
    whole = exported(tested.runs, "pose-test", tmp_path / "whole.json")
    T = np.array(whole["frames"]["base"]["matrix"])
    to_base = np.linalg.inv(T)
    clouds: dict[str, Any] = {}
    for point in whole["points"]:
        if point["group"] == "iso9283":
            at_mm = to_base @ [*(point[f"world_{axis}_mm"] for axis in "xyz"), 1.0]
            clouds.setdefault(point["key"].split("/")[1], []).append(at_mm[:3])
    assert {name: len(cloud) for name, cloud in clouds.items()} == dict.fromkeys(clouds, CYCLES)
    for name, each in found["poses"].items():
        cloud = np.array(clouds[name])
        off = cloud.mean(axis=0) - each["commanded_mm"]
        assert [each[f"ap_{axis}_mm"] for axis in "xyz"] == pytest.approx(off, abs=1e-8)
        assert each["ap_mm"] == pytest.approx(np.linalg.norm(off), abs=1e-8)
        l_mm = lengths_mm(cloud - cloud.mean(axis=0))
        assert each["rp_mm"] == pytest.approx(l_mm.mean() + 3 * l_mm.std(ddof=1), abs=1e-8)
    ways = lengths_mm(np.array(clouds["P2"]) - np.array(clouds["P4"]))
    wanted = np.linalg.norm(
        np.subtract(found["poses"]["P2"]["commanded_mm"], found["poses"]["P4"]["commanded_mm"])
    )
    assert found["distance"]["ad_mm"] == pytest.approx(ways.mean() - wanted, abs=1e-8)
    assert found["distance"]["rd_mm"] == pytest.approx(3 * ways.std(ddof=1), abs=1e-8)
    assert found["worst"]["ap_mm"] == max(each["ap_mm"] for each in found["poses"].values())


def test_a_killed_test_measures_the_missing_points_from_the_pose_before(
    tested: GoldenRun, tmp_path: Path
) -> None:
    printed = tested.events
    last = next(e for e in printed if e["kind"] == "point" and e["key"] == "iso9283/P3/002")
    cut(tested.folder, tmp_path / "cut", last["seq"])
    done = command("resume", "cut", "--runs", tmp_path, "--json", "--unattended")
    assert end_of(done)["exit"] == 0, done.stderr
    moves = [e for e in events(done.stdout) if e["kind"] == "intent" and "from_deg" in e]
    assert [move["key"] for move in moves[:2]] == ["iso9283/P2/002", "iso9283/P1/002"]
    assert len(moves) == 2 + 5  # of the third cycle, and the fourth
    before = next(e for e in printed if e["kind"] == "intent" and e.get("key") == last["key"])
    assert moves[0]["from_deg"] == before["joints_deg"]
    departures = end_of(done)["result"]["iso9283"]["deviations"]
    assert any("interrupted once" in each for each in departures)
    again = end_of(done)["result"]["iso9283"]["poses"]
    for name, each in tested.result["iso9283"]["poses"].items():
        assert again[name]["ap_mm"] == pytest.approx(each["ap_mm"], abs=0.1)
    checked = command("show", "cut", "--runs", tmp_path, "--check", "--json")
    assert all(
        rule["holds"] is not False for rule in json.loads(checked.stdout)["invariants"].values()
    )


def test_stated_limits_make_a_verdict(tmp_path: Path) -> None:
    strict = SHORT | {"iso9283.rp_limit_mm": "0.01", "iso9283.cycles": "3"}
    done = ran(tmp_path, "iso9283", strict, *FIXED)
    assert (done.end["exit"], done.end["state"]) == (1, "finished")
    assert done.result["iso9283"]["limits"] == {"rp_limit_mm": 0.01}
    facts = read_facts(done.folder)
    assert FirstPage(facts).verdict_title() == "WOULD FAIL"
    assert FirstPage(facts).status() == ("bad", "out of tolerance")
    assert Certificate(facts).conformity().startswith("guard band")
    sheet = FirstPage(facts).results_table(TargetBudget("none"))
    assert sheet is not None
    assert [row[-1] for row in sheet.rows] == ["not judged", "(fail)", "not judged", "not judged"]


def test_several_reflectors_give_the_repeatability_of_angles(tmp_path: Path) -> None:
    """Against scipy's Kabsch rotations of the exported readings."""
    three = {key: value for key, value in SEATS.items() if key == "robot.more_smr_mm"}
    limits = {"iso9283.rp_limit_deg": "0.5", "iso9283.cycles": "3"}
    done = ran(tmp_path, "iso9283", SHORT | three | limits, *FIXED, name="angles")
    assert done.end["exit"] == 0, done.done.stderr
    found = done.result["iso9283"]
    assert found["not_measured"] == ["AP_a", "AP_b", "AP_c"]
    whole = exported(tmp_path, "angles", tmp_path / "angles.json")
    R_W_B = np.array(whole["frames"]["base"]["matrix"])[:3, :3]
    at_mm = {
        point["key"]: [point[f"world_{axis}_mm"] for axis in "xyz"]
        for point in whole["points"] if point["key"].startswith("iso9283/")
    }  # fmt: skip
    assert len(at_mm) == 3 * 5 * 3
    for name, each in found["orientation"].items():
        keys = [f"iso9283/{name}/{cycle:03}" for cycle in range(3)]
        seen = np.array([[at_mm[k], at_mm[f"{k}/seat2"], at_mm[f"{k}/seat3"]] for k in keys])
        seen -= seen.mean(axis=1, keepdims=True)
        turns = [Rotation.align_vectors(one @ R_W_B, seen[0] @ R_W_B)[0] for one in seen]
        angles_deg = np.array([turn.as_rotvec(degrees=True) for turn in turns])
        rp_deg = 3.0 * angles_deg.std(axis=0, ddof=1)
        assert list(each["rp_deg"].values()) == pytest.approx(rp_deg, abs=1e-5, rel=1e-2)
        assert "ap_deg" not in each
    report_of(tmp_path, "angles")


def test_a_load_above_the_rated_one_is_refused(tmp_path: Path) -> None:
    cell = load_cell("fixed", {"iso9283.load_kg": "120", "iso9283.rated_load_kg": "100"})
    with pytest.raises(HilcellError, match="load_kg"):
        PoseCycle().plan(cell, 1)


def report_of(runs: Path, name: str) -> str:
    page = runs / f"{name}.html"
    done = command("report", name, "--runs", runs, "-o", page)
    assert done.returncode == 0, done.stderr
    return page.read_text("utf-8")


def test_its_report_has_its_figures(tested: GoldenRun, tmp_path: Path) -> None:
    tested.copied_to(tmp_path)
    found, page = tested.result["iso9283"], report_of(tmp_path, "pose-test")
    assert_references_resolve(page)
    for figure in ("figure-pose-test", "figure-attained"):
        assert f'id="{figure}"' in page
    assert all(each in page for each in found["deviations"])
    assert f"{found['worst']['ap_mm']:.3f} mm" in page
    assert f"{found['distance']['commanded_mm']:.3f}" in page
    assert f"{0.8 * 3**0.5 * 900:.3f}" in page  # P2 to P4: 80 % of the diagonal


@pytest.mark.nightly
def test_a_bumped_tracker_costs_the_cycles_since_its_proof(
    tested: GoldenRun, tmp_path: Path
) -> None:
    with simulation(values=SHORT, name="fixed") as cell:
        bumped: list[str] = []

        def hear(event: dict[str, Any]) -> None:
            if event.get("key") == "iso9283/P3/001" and event["kind"] == "point" and not bumped:
                bumped.append(event["key"])
                cell.strike("tracker.drift_step", 0.5)

        values = SHORT | {"simulation.address": cell.control}
        done = ran(tmp_path, "iso9283", values, *FIXED, hear=hear)
    assert done.end["exit"] == 0, done.done.stderr
    assert done.result["tracker"]["moved"] == 1
    moves = [e for e in done.events if e["kind"] == "intent" and "from_deg" in e]
    assert len(moves) == 2 * 5 * CYCLES
    again = done.result["iso9283"]["poses"]
    for name, each in tested.result["iso9283"]["poses"].items():
        assert again[name]["count"] == CYCLES
        assert again[name]["ap_mm"] == pytest.approx(each["ap_mm"], abs=0.1)
        assert again[name]["rp_mm"] < 0.2
