"""A calibration that differs from the current one supersedes it when a person has said so."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hilcell.calibration.file import read_calibration
from hilcell.geometry.frames import zyx_from_pose
from hilcell.journal.runs import CALIBRATION
from tests.hilcell.lists import write_targets
from tests.whole.bench import SMALL, command, end_of, sets
from tests.whole.golden import GoldenRuns

pytestmark = pytest.mark.process
SAME_MACHINE = ("--machine-seed", "1", "--unattended", "--json", *sets(SMALL))
BOLTED_AGAIN = ("--set", "simulation.sizes.mounting.bolted_mm=2.2")


def standings(runs: Path) -> dict[str, str]:
    listed = json.loads(command("runs", "--json", "--runs", runs).stdout)["runs"]
    return {each["run"]: each["standing"]["state"] for each in listed}


def calibrated(runs: Path, name: str, *words: str) -> dict[str, Any]:
    told: tuple[str | Path, ...] = ("--name", name, "--runs", runs, *SAME_MACHINE, *words)
    return end_of(command("run", "calibrate", "--seed", "2", *told))


def targets_of(run: Path) -> Path:
    """Write one target in the middle of the calibrated cube."""
    made = read_calibration(run / CALIBRATION)
    middle_mm = (np.array(made.validity.low_mm) + np.array(made.validity.high_mm)) / 2
    pose = np.array(made.stations["S1100"].T_W_B) @ made.poses_at(middle_mm[None])
    write_targets(run.parent / "targets.csv", ["H1"], zyx_from_pose(pose))
    return run.parent / "targets.csv"


def test_a_base_that_was_bolted_again_is_for_a_person_to_decide(
    golden: GoldenRuns, tmp_path: Path
) -> None:
    golden["small"].copied_to(tmp_path)
    end = calibrated(tmp_path, "second", *BOLTED_AGAIN)
    assert end["exit"] == 1
    (found,) = end["result"]["suspicions"]
    assert found["cause"] == "changed since"
    assert "base" in found["unit"]
    assert abs(found["size"]) > 0.5
    assert standings(tmp_path) == {"small": "current", "second": "suspected"}
    words = ("--station", "S1100", "--runs", tmp_path)
    targets, out = targets_of(tmp_path / "second"), tmp_path / "out.csv"
    assert command("compensate", "second", targets, "-o", out, *words).returncode == 2
    why = ("--reason", "the base was bolted again")
    assert command("revoke", "small", "--runs", tmp_path, *why).returncode == 0
    assert standings(tmp_path) == {"small": "revoked", "second": "current"}
    assert command("compensate", "second", targets, "-o", out, *words).returncode == 0


@pytest.mark.nightly  # by day the test above, in which all but the base agrees
def test_one_that_agrees_supersedes(golden: GoldenRuns, tmp_path: Path) -> None:
    golden["small"].copied_to(tmp_path)
    end = calibrated(tmp_path, "second")
    assert (end["exit"], end["result"]["suspicions"]) == (0, [])
    assert standings(tmp_path) == {"small": "superseded", "second": "current"}
