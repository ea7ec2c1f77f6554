"""A cell of another make, run to the end with a small plan."""

from __future__ import annotations

from pathlib import Path

from tests.whole.bench import end_of, hilcell, sets

SMALL = {
    "validation.per_cell": "1",
    "validation.others": "2",
    "base_frame.points": "6",
    "layout.nest_samples": "2",
}


def test_another_make_is_calibrated(tmp_path: Path) -> None:
    words = ("--json", "--cell", "six-r", "--runs", tmp_path, "--machine-seed", "4")
    end = end_of(hilcell("run", *words, *sets(SMALL)))
    assert end["exit"] == 0
    figures = end["result"]["validation"]["S800"]
    assert figures["chosen"]["mean"] < 0.3 * figures["before"]["mean"]
    assert 0.025 < end["result"]["repeatability"]["rp_robot_mm"] < 0.06  # .04 of the machine
