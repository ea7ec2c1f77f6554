"""Cells of other makes, run to the end with a quick plan."""

from __future__ import annotations

from pathlib import Path

from tests.whole.bench import command, end_of, sets

QUICK = {
    "plan.quick": "true",
    "plan.accept_risk": "0.3",
    "plan.share_above_max": "0.3",
    "base_frame.points": "6",
    "layout.nest_samples": "2",
}


def test_another_make_is_calibrated(tmp_path: Path) -> None:
    words = ("--json", "--cell", "six-r", "--runs", tmp_path, "--machine-seed", "4")
    end = end_of(command("run", *words, *sets(QUICK)))
    assert end["exit"] == 0
    figures = end["result"]["validation"]["S800"]
    assert figures["chosen"]["mean"] < 0.3 * figures["before"]["mean"]
    assert set(figures["chosen"]) >= set(figures["before"]) > {"mean", "max"}
    for name in ("S800", "others"):
        decision = end["result"]["validation"][name]["decision"]
        assert decision["outcome"] == "accepted"
        assert max(decision["targets"]) <= 32
    assert end["result"]["points"]["validate_before"] == 8 * len(end["result"]["stations"])
    bounds_mm = end["result"]["chosen_poses"]["bounds_mm"]
    assert len(bounds_mm) == 1 + end["result"]["points"].get("pose", 0)
    assert 0.025 < end["result"]["repeatability"]["rp_robot_mm"] < 0.06  # .04 of the machine


def test_a_universal_robot_and_a_total_station(tmp_path: Path) -> None:
    quick = {key: value for key, value in QUICK.items() if key.startswith("plan.")}
    words = ("--json", "--cell", "lab", "--runs", tmp_path)
    end = end_of(command("run", *words, *sets(quick)))
    assert end["state"] == "finished"
    figures = end["result"]["validation"]["S750"]
    assert figures["chosen"]["mean"] < 0.5 * figures["before"]["mean"]
