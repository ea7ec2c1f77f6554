"""A calibration is checked again on its machine, and its drill targets are measured."""

import json
import math
import re
from pathlib import Path

import pytest

from hilcell.calibration import decision_rule
from hilcell.calibration.file import read_calibration
from hilcell.calibration.recheck import RecheckResult
from hilcell.journal.runs import CALIBRATION, read_log
from hilcell.model.verdicts import Limits
from tests.whole.bench import SMALL, command, corrected, ran, sets, simulation
from tests.whole.golden import GoldenRuns

pytestmark = pytest.mark.waits
HEAD = "name,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg\n"


def one_target(path: Path) -> Path:
    path.write_text(HEAD + "H1,0,0,1200,0,75,0\n")
    return path


def test_a_lost_zero_is_updated_and_the_update_is_valid(
    golden: GoldenRuns, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs, small = tmp_path / "runs", str(golden["small"].folder)
    with simulation() as cell:
        cell.strike("robot.lost_zero", 0.02)  # 0.35 mrad: 0.7 mm at the cube
        values = SMALL | {"simulation.address": cell.control}
        first = ran(runs, "recheck", values | {"recheck.calibration": small}, name="R")
        again = ran(runs, "recheck", values, name="V")
    recheck = first.result["recheck"]
    assert first.done.returncode == 1, first.done.stderr
    assert recheck["verdict"] == "update"
    assert abs(recheck["shift_mm"] - 0.65) < 3 * recheck["u_mm"]
    points = [event for event in first.events if event["kind"] == "point"]
    assert sum(event["group"] != "control" for event in points) <= 10
    provenance = read_calibration(first.folder / CALIBRATION).provenance
    assert [update.run for update in provenance.updates] == ["R"]
    assert provenance.run == "small"
    assert provenance.written == provenance.updates[-1].written
    recheck = again.result["recheck"]
    assert again.done.returncode == 0, again.done.stderr
    assert (recheck["verdict"], recheck["calibration"]) == ("valid", "R")
    targets, out = one_target(tmp_path / "t.csv"), tmp_path / "o.csv"
    assert corrected("R", targets, "S1100", out, "--runs", runs).returncode == 0
    assert corrected("V", targets, "S1100", out, "--runs", runs).returncode == 2
    monkeypatch.setattr(decision_rule, "tolerance_limits", lambda cell: Limits(0.1, 0.11, None))
    for run in (first, again):  # its base moved; as predicted: both out of such a tolerance
        result = RecheckResult.of(run.log)
        assert (result.verdict, result.in_tolerance) == ("redo", False)
        assert "Calibrate again: the errors are as predicted, but out of tolerance" in result.text


def test_an_update_that_a_slip_explains_as_well_is_in_doubt(
    golden: GoldenRuns, tmp_path: Path
) -> None:
    with simulation() as cell:
        cell.strike("robot.mount_slip", 1.5)
        values = SMALL | {"simulation.address": cell.control}
        values |= {"recheck.calibration": str(golden["small"].folder)}
        run = ran(tmp_path, "recheck", values, name="R")
    assert (run.done.returncode, run.result["recheck"]["verdict"]) == (1, "update")
    use = ("R", one_target(tmp_path / "t.csv"), "S1100", tmp_path / "o", "--runs", tmp_path)
    done = corrected(*use)
    assert done.returncode == 2
    slip = re.search(r"slipped by (\S+) mm on its mount", done.stderr)
    assert slip
    assert float(slip[1]) == pytest.approx(1.5, abs=0.06)  # U of some ten readings
    assert corrected(*use, "--accept-not-current").returncode == 0
    assert "IN DOUBT (accepted)" in (tmp_path / "o").read_text()


@pytest.mark.nightly
def test_reoriented_poses_tell_a_slipped_mount_from_a_moved_base(tmp_path: Path) -> None:
    """The calibration that was made for reoriented targets predicts reoriented poses, too."""
    tilted = SMALL | {"plan.tilt_deg": "30.0"}
    made = ran(tmp_path, "calibrate", tilted, name="C")
    assert made.done.returncode == 0, made.done.stderr
    found = {}
    for name, value in (("", 0.0), ("robot.mount_slip", 0.5), ("robot.lost_zero", 0.02)):
        with simulation() as cell:
            if name:
                cell.strike(name, value)
            values = tilted | {"simulation.address": cell.control, "recheck.calibration": "C"}
            run = ran(tmp_path, "recheck", values, "--accept-not-current", name=name or "none")
        recheck = run.result["recheck"]
        causes = [each["cause"] for each in recheck["suspicions"]]
        found[name] = (recheck["verdict"], "mount slipped" in causes)
        assert ("take this re-check back" in recheck["text"]) == (name == "robot.mount_slip")
    assert found == {
        "": ("valid", False),
        "robot.mount_slip": ("redo", True),
        "robot.lost_zero": ("update", False),
    }


def test_a_dry_run_has_ten_points(golden: GoldenRuns, tmp_path: Path) -> None:
    values = SMALL | {"recheck.calibration": str(golden["small"].folder)}
    done = ran(tmp_path, "recheck", values, "--dry-run").done
    plan = json.loads(done.stdout.splitlines()[-1])["result"]
    assert plan["points"] == 10
    assert plan["duration_s"] < 120


# -- targets ----------------------------------------------------------------------------------


def six_targets(path: Path) -> Path:
    rows = [f"H{n},{-200 + 80 * n},{300 - 90 * n},{1000 + 70 * n},0,75,0" for n in range(6)]
    path.write_text(HEAD + "\n".join(rows) + "\n")
    return path


def test_targets_on_a_strip_that_jumped_are_not_folded_in(
    golden: GoldenRuns, tmp_path: Path
) -> None:
    """All are within the cell's tolerance, and lie beside where the calibration predicts them."""
    with simulation() as cell:
        cell.strike("rail.strip_jump", 0.2)
        values = SMALL | {
            "simulation.address": cell.control,
            "targets.file": str(six_targets(tmp_path / "t.csv")),
            "targets.calibration": str(golden["small"].folder),
        }
        run = ran(tmp_path, "targets", values)
    result = run.result["targets"]
    assert run.done.returncode == 1
    assert result["in_tolerance"]
    assert not result["as_predicted"]
    assert abs(result["shift_mm"] - 0.2) < 3 * result["u_mm"]
    assert not (run.folder / CALIBRATION).exists()


def test_targets_are_measured_and_folded_in(golden: GoldenRuns, tmp_path: Path) -> None:
    """The machine is that of the calibration, whatever the run's own seed is."""
    targets, runs = six_targets(tmp_path / "t.csv"), tmp_path / "runs"
    small = golden["small"].folder
    values = SMALL | {"targets.file": str(targets), "targets.calibration": str(small)}
    run = ran(runs, "targets", values, "--seed", "9")
    result = run.result["targets"]
    assert run.done.returncode == 0, run.done.stderr
    assert result["points"] == 6
    assert result["as_found"]["max"] < 0.5
    assert 0.0 < result["share"] < 1.0
    assert result["bound_after_mm"] < result["bound_before_mm"]
    folded = read_calibration(run.folder / CALIBRATION)
    assert folded.targets is not None
    assert folded.targets.passes[0].names == [f"H{n}" for n in range(6)]
    before, after = tmp_path / "before.csv", tmp_path / "after.csv"
    for calibration, out in ((small, before), (run.folder, after)):
        done = corrected(calibration, targets, "S1100", out)
        assert done.returncode == 0, done.stderr
    assert before.read_text() != after.read_text()
    far = tmp_path / "far.csv"
    far.write_text(targets.read_text().replace("H3,40", "H3,4000"))
    values |= {"targets.file": str(far)}
    done = command("run", "targets", "--dry-run", "--runs", runs, *sets(values))
    assert done.returncode == 2
    assert "H3" in done.stderr


def test_a_simulated_recheck_reads_noise_of_its_own(golden: GoldenRuns, tmp_path: Path) -> None:
    """Else two runs of one machine agree to the last digit, and no false alarm ever shows."""
    quick = golden["quick"].copied_to(tmp_path)
    checked = read_log(ran(tmp_path, "recheck", {}, "--seed", "7", name="R").folder)
    before = read_log(quick).points
    both = [key for key in checked.points if key in before]
    assert len(both) >= 3
    assert any(key.startswith("held") for key in both)  # drift moves the others
    for key in both:
        assert math.dist(checked.points[key].xyz_mm, before[key].xyz_mm) > 1e-3
