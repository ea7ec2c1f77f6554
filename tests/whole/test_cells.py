"""Other cells, run to the end: other makes, and a robot on the floor without a rail."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hilcell.calibration.file import read_calibration
from hilcell.geometry.frames import pose_from_zyx, to_rotvec
from hilcell.programs.holes import NORMALS
from tests.whole.bench import command, corrected, ran, sets

QUICK = {
    "plan.quick": "true",
    "plan.accept_risk": "0.3",
    "plan.share_above_max": "0.3",
    "base_frame.points": "6",
    "layout.nest_samples": "2",
}

# A total station's noise, and limits within which few targets decide.
COARSE = QUICK | {
    "base_frame.points": "8",
    "layout.nest_samples": "4",
    "touch.poses": "3",
    "validation.mean_tolerance_mm": "2.0",
    "validation.max_tolerance_mm": "4.0",
}
FIXED = ("--cell", "fixed")


@pytest.mark.nightly  # by day: the lab, below; a quick plan's decisions in tests/procedures
def test_another_make_is_calibrated(tmp_path: Path) -> None:
    run = ran(tmp_path, "calibrate", QUICK, "--cell", "six-r", "--machine-seed", "4")
    assert run.end["exit"] == 0
    result = run.result
    figures = result["validation"]["S800"]
    assert figures["chosen"]["mean"] < 0.3 * figures["before"]["mean"]
    assert set(figures["chosen"]) >= set(figures["before"]) > {"mean", "max"}
    for name in ("S800", "others"):
        decision = result["validation"][name]["decision"]
        assert decision["outcome"] == "accepted"
        assert max(decision["targets"]) <= 32
        assert "rising hazard rate" in decision["rule"]
    assert "validate_before" not in result["points"]
    assert figures["points_sent"]["before"] == figures["points"]  # the same targets show both
    assert 0.7 < figures["before"]["mean"] < 1.1  # .9 of the machine
    assert len(result["chosen_poses"]["bounds_mm"]) == 1 + result["points"].get("pose", 0)
    assert 0.025 < result["repeatability"]["rp_robot_mm"] < 0.06  # .04 of the machine


@pytest.mark.waits
def test_a_universal_robot_and_a_total_station(tmp_path: Path) -> None:
    run = ran(tmp_path, "calibrate", COARSE, "--cell", "lab")
    assert run.end["state"] == "finished"
    figures = run.result["validation"]["S750"]
    assert figures["chosen"]["mean"] < 0.5 * figures["before"]["mean"]
    assert figures["decision"]["outcome"] == "accepted"
    check_programs(tmp_path)


def check_programs(runs: Path) -> None:
    (folder,) = runs.glob("*/calibration.json")
    T_W_B = np.array(read_calibration(folder).stations["S750"].T_W_B)
    T_B_T = pose_from_zyx(700.0, 0.0, 420.0, -90.0, 0.0, -160.0)
    source, out, holes = (runs / name for name in ("in.script", "out.script", "holes.csv"))
    turn = ", ".join(f"{each:.9f}" for each in to_rotvec(T_B_T[:3, :3]))
    tcp = "p[0.09, 0.0, 0.07, 0.0, 0.0, 0.0]"
    source.write_text(f"def d():\n  set_tcp({tcp})\n  movel(p[0.7, 0.0, 0.42, {turn}])\nend\n")
    cell: tuple[str | Path, ...] = ("--cell", "lab", "--runs", runs, *sets(COARSE))
    done = corrected("last", source, "S750", out, *cell)
    assert done.returncode == 0, done.stderr
    (written,) = [line for line in out.read_text().splitlines() if "movel" in line]
    assert written.endswith(f", {turn}])")
    moved_mm = 1e3 * np.array(written[10:].split(",")[:3], dtype=float) - T_B_T[:3, 3]
    assert 0.3 < np.linalg.norm(moved_mm) < 4.0
    place, normal = (T_W_B @ T_B_T)[:3, 3], -(T_W_B @ T_B_T)[:3, 2]
    row = ",".join(f"{each:.6f}" for each in (*place, *normal))
    holes.write_text(f"{','.join(NORMALS)}\nH1,{row}\n")
    done = command("prepare", holes, "--calibration", "last", "-o", runs / "out", *cell)
    assert done.returncode == 0, done.stderr
    text = (runs / "out" / "S750.script").read_text("ascii")
    assert text.startswith("def S750():\n  # hilcell: ")
    assert text.count("movej([") == 4


# -- without a rail ---------------------------------------------------------------------------


@pytest.mark.nightly
def test_a_robot_on_the_floor_is_calibrated_and_tested_with_its_correction(tmp_path: Path) -> None:
    quick, machine = {"plan.quick": "true"}, (*FIXED, "--machine-seed", "7")
    made = ran(tmp_path, "calibrate", quick, *FIXED, "--seed", "7", name="made")
    figures = made.result["validation"]
    assert (made.end["exit"], list(figures)) == (0, ["BASE"])
    assert figures["BASE"]["chosen"]["mean"] < 0.1 * figures["BASE"]["before"]["mean"]
    worst_mm = []
    for name, used in (("as-it-is", {}), ("corrected", {"iso9283.calibration": "made"})):
        cycles = {"iso9283.cycles": "5"} | used
        tested = ran(tmp_path, "iso9283", cycles, *machine, "--seed", "8", name=name)
        worst_mm.append(tested.result["iso9283"]["worst"]["ap_mm"])
    assert tested.result["iso9283"]["corrected_by"] == "made"
    assert worst_mm[1] < 0.2 * worst_mm[0]
    holes, out = tmp_path / "holes.csv", tmp_path / "out.csv"
    holes.write_text("name,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg\nH1,0,0,1250,0,75,0\n")
    assert corrected("made", holes, "BASE", out, "--runs", tmp_path).returncode == 0
    again = ran(tmp_path, "calibrate", quick, *machine, "--seed", "9", name="again")
    assert (again.end["exit"], again.result["suspicions"]) == (0, [])
    assert command("compare", "made", "last", "--runs", tmp_path).returncode == 0
