"""Runs whose tracker is behind SpatialAnalyzer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.spatialanalyzer.t2sa_points import main as write_points
from hilcell.journal.runs import read_log
from tests.whole.bench import SMALL, command, end_of, sets

T2SA = {"tracker.driver": "t2sa", "sweeps.enabled": "true"}


@pytest.mark.nightly  # by day a recorded run of a shorter list repeats: test_record_wire
def test_a_calibration_with_a_list_that_was_written_for_the_cell(tmp_path: Path) -> None:
    listed = tmp_path / "points.csv"
    assert write_points(["paper", str(listed)]) == 0
    words = sets(SMALL | T2SA | {"tracker.options.points": str(listed)})
    done = command("run", "--unattended", "--runs", tmp_path, "--name", "x", "--json", *words)
    assert done.returncode in (0, 1), done.stderr
    result = end_of(done)["result"]
    figures = result["validation"]["S1100"]
    assert figures["chosen"]["mean"] < figures["before"]["mean"]
    assert "'t2sa'" in result["sweeps"]["left_out"]
    log = read_log(tmp_path / "x")
    assert {point.samples for point in log.points.values()} >= {2}
    stds_mm = np.array([point.std_mm for point in log.points.values()])
    assert 0.001 < np.median(np.linalg.norm(stds_mm, axis=1)) < 0.05
    assert log.assets[-1].model.endswith("by SpatialAnalyzer")


def test_a_list_that_does_not_cover_the_cell_is_refused(tmp_path: Path) -> None:
    listed = tmp_path / "points.csv"
    listed.write_text("P1,4000.0,0.0,0.0\n", "ascii")
    words = sets(T2SA | {"tracker.options.points": str(listed), "plan.unattended_wait_s": "0"})
    done = command("run", "world-frame", "--unattended", "--runs", tmp_path, "--json", *words)
    end = end_of(done)
    assert (end["exit"], end["error"]["code"]) == (3, "HC-T74")
