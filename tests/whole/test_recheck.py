"""A calibration is checked again on the machine that it was made on, after its zero was lost."""

import json
from pathlib import Path

import pytest

from hilcell.calibration import decision_rule
from hilcell.calibration.file import read_calibration
from hilcell.calibration.recheck import recheck_result
from hilcell.journal.runs import CALIBRATION, read_log
from hilcell.model.verdicts import Limits
from tests.whole.bench import SMALL, command, end_of, events, sets, simulation
from tests.whole.golden import GoldenRuns
from tests.whole.trace import judge

pytestmark = pytest.mark.waits
LOST = '[[fault]]\nname = "robot.lost_zero"\nvalue = 0.02\n'  # 0.35 mrad: 0.7 mm at the cube


def test_a_lost_zero_is_updated_and_the_update_holds(
    golden: GoldenRuns, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    faults, runs = tmp_path / "faults.toml", tmp_path / "runs"
    faults.write_text(LOST)
    with simulation(faults=str(faults)) as cell:
        words = SMALL | {"simulation.address": cell.control}
        first = words | {"recheck.calibration": str(golden["small"].folder)}
        done = command("run", "recheck", "--json", "--name", "R", "--runs", runs, *sets(first))
        again = command("run", "recheck", "--json", "--name", "V", "--runs", runs, *sets(words))
    found = end_of(done)["result"]["recheck"]
    assert done.returncode == 1, done.stderr
    assert found["verdict"] == "update"
    assert abs(found["shift_mm"] - 0.65) < 3 * found["u_mm"]
    assert judge(events(done.stdout)) == []
    points = [event for event in events(done.stdout) if event["kind"] == "point"]
    assert sum(event["group"] != "control" for event in points) <= 10
    updated = read_calibration(runs / "R" / CALIBRATION)
    assert [update.run for update in updated.provenance.updates] == ["R"]
    assert updated.provenance.run == "small"
    assert updated.provenance.written == updated.provenance.updates[-1].written
    found = end_of(again)["result"]["recheck"]
    assert again.returncode == 0, again.stderr
    assert (found["verdict"], found["calibration"]) == ("valid", "R")
    targets, out = tmp_path / "t.csv", tmp_path / "o.csv"
    targets.write_text("name,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg\nH1,0,0,1200,0,75,0\n")
    done = command("compensate", "R", targets, "--station", "S1100", "-o", out, "--runs", runs)
    assert done.returncode == 0, done.stderr
    done = command("compensate", "V", targets, "--station", "S1100", "-o", out, "--runs", runs)
    assert done.returncode == 2
    monkeypatch.setattr(decision_rule, "tolerance_limits", lambda cell: Limits(0.1, 0.11, None))
    for name in ("R", "V"):  # its base moved; as predicted: both out of such a tolerance
        result = recheck_result(read_log(runs / name))
        assert (result.verdict, result.in_tolerance) == ("redo", False)
        assert "Calibrate again: the errors are as predicted, but out of tolerance" in result.text


def test_an_update_that_a_slip_explains_as_well_is_in_doubt(
    golden: GoldenRuns, tmp_path: Path
) -> None:
    faults, runs, targets = tmp_path / "faults.toml", tmp_path / "runs", tmp_path / "t.csv"
    faults.write_text('[[fault]]\nname = "robot.mount_slip"\nvalue = 1.5\n')
    with simulation(faults=str(faults)) as cell:
        words = SMALL | {"simulation.address": cell.control}
        words |= {"recheck.calibration": str(golden["small"].folder)}
        done = command("run", "recheck", "--json", "--name", "R", "--runs", runs, *sets(words))
    assert (done.returncode, end_of(done)["result"]["recheck"]["verdict"]) == (1, "update")
    targets.write_text("name,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg\nH1,0,0,1200,0,75,0\n")
    use = ("compensate", "R", targets, "--station", "S1100", "-o", tmp_path / "o", "--runs", runs)
    done = command(*use)
    assert done.returncode == 2
    assert "slipped by 1.5" in done.stderr
    assert command(*use, "--accept-not-current").returncode == 0
    assert "IN DOUBT (accepted)" in (tmp_path / "o").read_text()


@pytest.mark.nightly
def test_turned_poses_tell_a_slipped_mount_from_a_moved_base(tmp_path: Path) -> None:
    """The calibration that was made for turned targets predicts turned poses, too."""
    words = SMALL | {"plan.tilt_deg": "30.0"}
    done = command("run", "--json", "--name", "C", "--runs", tmp_path, *sets(words))
    assert done.returncode == 0, done.stderr
    found = {}
    for name, value in (("", 0.0), ("robot.mount_slip", 0.5), ("robot.lost_zero", 0.02)):
        faults = tmp_path / "faults.toml"
        faults.write_text(f'[[fault]]\nname = "{name}"\nvalue = {value}\n' if name else "")
        with simulation(faults=str(faults)) as cell:
            there = words | {"simulation.address": cell.control, "recheck.calibration": "C"}
            named = ("--name", name or "none", "--accept-not-current", "--runs", tmp_path)
            done = command("run", "recheck", "--json", *named, *sets(there))
        result = end_of(done)["result"]["recheck"]
        causes = [each["cause"] for each in result["suspicions"]]
        found[name] = (result["verdict"], "mount slipped" in causes)
        said = result["text"]
        assert ("take this re-check back" in said) == (name == "robot.mount_slip")
    assert found == {
        "": ("valid", False),
        "robot.mount_slip": ("redo", True),
        "robot.lost_zero": ("update", False),
    }


def test_without_a_calibration_or_targets_nothing_begins(tmp_path: Path) -> None:
    done = command("run", "targets", "--runs", tmp_path)
    assert done.returncode == 2
    assert "--set targets.file=FILE" in done.stderr
    done = command("run", "recheck", "--json", "--runs", tmp_path)
    assert done.returncode == 2
    assert list(tmp_path.iterdir()) == []


def test_a_dry_run_has_ten_points(golden: GoldenRuns, tmp_path: Path) -> None:
    words = SMALL | {"recheck.calibration": str(golden["small"].folder)}
    done = command("run", "recheck", "--dry-run", "--json", "--runs", tmp_path, *sets(words))
    plan = json.loads(done.stdout.splitlines()[-1])["result"]
    assert plan["points"] == 10
    assert plan["duration_s"] < 120


def six_targets(path: Path) -> Path:
    """Write a list of targets in the volume."""
    rows = [f"H{n},{-200 + 80 * n},{300 - 90 * n},{1000 + 70 * n},0,75,0" for n in range(6)]
    path.write_text("\n".join(["name,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg", *rows]) + "\n")
    return path


def test_targets_on_a_strip_that_jumped_are_not_folded_in(
    golden: GoldenRuns, tmp_path: Path
) -> None:
    """All are within the cell's tolerance, and lie beside where the calibration predicts them."""
    faults, targets = tmp_path / "faults.toml", six_targets(tmp_path / "t.csv")
    faults.write_text('[[fault]]\nname = "rail.strip_jump"\nvalue = 0.2\n')
    with simulation(faults=str(faults)) as cell:
        words = SMALL | {"simulation.address": cell.control, "targets.file": str(targets)}
        words |= {"targets.calibration": str(golden["small"].folder)}
        named = ("--json", "--name", "T", "--runs", tmp_path)
        done = command("run", "targets", *named, *sets(words))
    found = end_of(done)["result"]["targets"]
    assert done.returncode == 1
    assert found["in_tolerance"]
    assert not found["as_predicted"]
    assert abs(found["shift_mm"] - 0.2) < 3 * found["u_mm"]
    assert not (tmp_path / "T" / CALIBRATION).exists()


def test_targets_are_measured_and_folded_in(golden: GoldenRuns, tmp_path: Path) -> None:
    """The machine is that of the calibration, whatever the run's own seed is."""
    targets, runs = six_targets(tmp_path / "t.csv"), tmp_path / "runs"
    small = golden["small"].folder
    words = SMALL | {"targets.file": str(targets), "targets.calibration": str(small)}
    named = ("--json", "--seed", "9", "--name", "T", "--runs", runs)
    done = command("run", "targets", *named, *sets(words))
    found = end_of(done)["result"]["targets"]
    assert done.returncode == 0, done.stderr
    assert judge(events(done.stdout)) == []
    assert found["points"] == 6
    assert found["as_found"]["max"] < 0.5
    assert 0.0 < found["share"] < 1.0
    assert found["bound_after_mm"] < found["bound_before_mm"]
    folded = read_calibration(runs / "T" / CALIBRATION)
    assert folded.targets is not None
    assert folded.targets.passes[0].names == [f"H{n}" for n in range(6)]
    commands = []
    for run in (small, runs / "T"):
        out = tmp_path / "o.csv"
        done = command("compensate", run, targets, "--station", "S1100", "-o", out)
        assert done.returncode == 0, done.stderr
        commands.append(out.read_text().splitlines())
        out.unlink()
    assert commands[0] != commands[1]
    far = tmp_path / "far.csv"
    far.write_text(targets.read_text().replace("H3,40", "H3,4000"))
    words |= {"targets.file": str(far)}
    done = command("run", "targets", "--dry-run", "--runs", runs, *sets(words))
    assert done.returncode == 2
    assert "H3" in done.stderr
