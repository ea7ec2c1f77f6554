"""Cells of other makes, run to the end with a quick plan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hilcell.calibration.file import read_calibration
from hilcell.geometry.frames import pose_from_zyx, to_rotvec
from hilcell.programs.holes import NORMALS
from tests.whole.bench import command, end_of, sets

QUICK = {
    "plan.quick": "true",
    "plan.accept_risk": "0.3",
    "plan.share_above_max": "0.3",
    "base_frame.points": "6",
    "layout.nest_samples": "2",
}

# A total station's noise, and limits within which few targets tell.
COARSE = {
    "base_frame.points": "8",
    "layout.nest_samples": "4",
    "touch.poses": "3",
    "validation.mean_tolerance_mm": "2.0",
    "validation.max_tolerance_mm": "4.0",
}


@pytest.mark.nightly  # by day: the lab, below; a quick plan's decisions in tests/procedures
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


@pytest.mark.waits
def test_a_universal_robot_and_a_total_station(tmp_path: Path) -> None:
    words = ("--json", "--cell", "lab", "--runs", tmp_path)
    end = end_of(command("run", *words, *sets(QUICK | COARSE)))
    assert end["state"] == "finished"
    figures = end["result"]["validation"]["S750"]
    assert figures["chosen"]["mean"] < 0.5 * figures["before"]["mean"]
    assert figures["decision"]["outcome"] == "accepted"
    check_programs(tmp_path)


def check_programs(runs: Path) -> None:
    """Correct a program by the lab's calibration, and write one for holes."""
    (folder,) = runs.glob("*/calibration.json")
    T_W_B = np.array(read_calibration(folder).stations["S750"].T_W_B)
    T_B_T = pose_from_zyx(700.0, 0.0, 420.0, -90.0, 0.0, -160.0)
    source, out, holes = (runs / name for name in ("in.script", "out.script", "holes.csv"))
    turn = ", ".join(f"{each:.9f}" for each in to_rotvec(T_B_T[:3, :3]))
    tcp = "p[0.09, 0.0, 0.07, 0.0, 0.0, 0.0]"
    source.write_text(f"def d():\n  set_tcp({tcp})\n  movel(p[0.7, 0.0, 0.42, {turn}])\nend\n")
    cell: tuple[str | Path, ...] = ("--cell", "lab", "--runs", runs, *sets(QUICK | COARSE))
    done = command("compensate", "last", source, "--station", "S750", "-o", out, *cell)
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
