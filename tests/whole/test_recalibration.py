"""The arm of a run is carried into another: its command line, its refusals, and kills."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from campaigns.kills import killed
from hilcell.calibration.file import read_calibration
from hilcell.calibration.known_arm import seed_after
from hilcell.journal.calibration_status import statuses
from hilcell.journal.index import read_index
from hilcell.journal.runs import CALIBRATION, read_log
from hilcell.model.events import ArmCarried
from procedures.calibrate import CALIBRATE
from tests.whole.bench import command, judge, ran, sets, simulation
from tests.whole.golden import GoldenRuns

pytestmark = pytest.mark.waits


def refusal(runs: Path, *words: str | Path) -> str:
    done = command("run", *words, "--runs", runs, "--dry-run")
    assert done.returncode == 2, done.stdout
    return " ".join(done.stderr.split())


def test_what_it_cannot_start_from_is_refused(golden: GoldenRuns, tmp_path: Path) -> None:
    small = golden["small"].copied_to(tmp_path / "small")
    quick = golden["quick"].copied_to(tmp_path)
    assert "no curves of the gears (axis sweeps)" in refusal(tmp_path, "--from", small)
    assert "--full and --from: expected one of them" in refusal(tmp_path, "--from", quick, "--full")
    assert "--from (plan.calibration) is for calibrate" in refusal(
        tmp_path, "robot-grid", "--from", quick
    )
    for name in ("last", "current"):
        assert f"{name!r} is reserved" in refusal(tmp_path, "--name", name)
    assert "--from: expected a name, got ''" in refusal(tmp_path, "--from", "")
    for key, value in (("plan.quick", "false"), ("plan.calibration", '"other"')):
        assert f"--set {key} and --full, --quick or --from: expected one of them" in refusal(
            tmp_path, "--from", quick, *sets({key: value})
        )
    assert "or name a run or its calibration.json with --from RUN" in refusal(
        tmp_path, "--from", "current", "--cell", "hard"
    )
    assert "'nowhere' not found" in refusal(tmp_path, "--from", "nowhere")
    assert "name differs" in refusal(tmp_path, "--from", quick, "--cell", "hard")
    other = sets({"serial": "HC-2"})
    assert "serial differs" in refusal(tmp_path, "--from", quick, *other)
    tool = sets({"robot.smr_mm": "[99.0, 0.0, 127.0]"})
    assert "robot.smr_mm differs" in refusal(tmp_path, "--from", quick, *tool)
    assert "of simulated machine 1" in refusal(tmp_path, "--from", quick, "--machine-seed", "2")
    looser = sets({"validation.mean_tolerance_mm": "0.1"})
    planned = command("run", "--from", quick, *looser, "--runs", tmp_path, "--dry-run")
    assert planned.returncode == 0, planned.stderr  # a tolerance is no part of the arm
    file = quick / CALIBRATION
    whole = file.read_text()
    file.write_bytes((small / CALIBRATION).read_bytes())
    assert "is not the one that this run wrote" in refusal(tmp_path, "--from", quick)
    file.write_text(whole.replace('"sign_checked": true', '"sign_checked": false', 1))
    assert "its seal does not hold" in refusal(tmp_path, "--from", quick)
    content = json.loads(whole)
    file.write_text(json.dumps(content | {"schema": content["schema"] - 1}))
    assert "calibrate again" in refusal(tmp_path, "--from", quick)
    file.unlink()
    assert "wrote no calibration" in refusal(tmp_path, "--from", quick)


@pytest.mark.process
def test_killed_and_resumed_it_becomes_current(golden: GoldenRuns, tmp_path: Path) -> None:
    quick = golden["quick"].copied_to(tmp_path)
    with simulation() as cell:
        words = ["calibrate", "--from", "current", "--seed", "2"]
        words += sets({"simulation.address": cell.control})
        found = killed(tmp_path, words, [40, 120, 260], later_s=iter([0.0] * 3))
    end = found.journal[-1]
    assert (end["kind"], end["exit"]) == ("end", 0)
    assert end["result"]["known_arm"]["calibration"] == quick.name
    page = tmp_path / "report.html"
    assert command("report", "last", "-o", page, "--runs", tmp_path).returncode == 0
    method = " ".join(page.read_text("utf-8").split())
    assert "measured by laser tracker at 14 poses chosen by what they determine at S1100" in method
    assert f"known from the calibration of run {quick.name};" in method
    assert judge(found.journal) == []
    assert len(found.acknowledged) == len(set(found.acknowledged))
    (run,) = {row.name for row in read_index(tmp_path)} - {quick.name}
    assert statuses(read_index(tmp_path))[run].state == "current"
    assert f"calibrate from {quick.name}" in command("runs", "--runs", tmp_path).stdout
    shown = json.loads(command("show", run, "--runs", tmp_path, "--json").stdout)
    assert shown["from"] == quick.name
    made = read_calibration(tmp_path / run / CALIBRATION).provenance
    assert made.named == f"run {run} (re-calibrated from run {quick.name})"
    revoked = command("revoke", quick.name, "--reason", "bumped", "--runs", tmp_path).stderr
    assert f"that of run {run} has the arm of {quick.name}: current" in revoked


def test_a_redo_leads_to_it(golden: GoldenRuns, tmp_path: Path) -> None:
    """The calibration is revoked by then; its arm is a prior all the same."""
    quick = golden["quick"].copied_to(tmp_path)
    with simulation() as cell:
        cell.strike("robot.lost_zero_2", 0.1)
        values = {"simulation.address": cell.control}
        checked = ran(tmp_path, "recheck", values, name="R")
        assert checked.result["recheck"]["verdict"] == "redo"
        last = checked.done.stderr.splitlines()[-1]
        assert f"hilcell run --from {quick.name}" in last
        done = ran(tmp_path, "calibrate", values, "--from", quick.name, "--seed", "3", name="C")
    assert "zero of axis 2" in done.result["known_arm"]["changed"]
    assert f"Changed since {quick.name}: zero of axis 2 by 0." in CALIBRATE.words(done.result)
    page = tmp_path / "report.html"
    assert command("report", "C", "-o", page, "--runs", tmp_path).returncode == 0
    method = " ".join(page.read_text("utf-8").split())
    assert f"calibration of run {quick.name}, changed since: zero of axis 2 by 0." in method
    assert "; before is the error of the poses that were commanded to them." in method
    assert re.search(r"poses: predicted mean 95 % bound in the cube 0\.0\d+ mm;", method)
    compared = command("compare", quick.name, "C", "--runs", tmp_path).stdout
    assert "robot base" in compared
    assert "grid points" not in compared  # the arm predicts what one of them measured
    assert done.done.returncode in (0, 1), done.done.stderr


def test_a_mount_that_slipped_before_it_is_named_at_once(
    golden: GoldenRuns, tmp_path: Path
) -> None:
    quick = golden["quick"].copied_to(tmp_path)
    with simulation() as cell:
        cell.strike("robot.mount_slip", 0.3)
        values = {"simulation.address": cell.control}
        done = ran(tmp_path, "calibrate", values, "--from", quick.name, name="C")
    (found,) = done.result["suspicions"]
    assert (found["cause"], round(found["size"], 1)) == ("mount slipped", 0.3)
    assert done.done.returncode == 1
    seed = seed_after(read_calibration(quick / CALIBRATION))
    assert read_log(tmp_path / "C").inputs.seed == seed  # none was stated
    assert f"seed {seed}, from that calibration" in done.done.stderr
    (carried,) = (each for each in done.events if each.get("what") == "arm carried")
    assert carried["content"]["points"] == 27  # a summary in place of 200 kB
    (whole,) = read_log(tmp_path / "C").happened(ArmCarried)
    assert whole.content["provenance"]["run"] == quick.name
    assert statuses(read_index(tmp_path))["C"].state == "suspected"
    assert statuses(read_index(tmp_path))[quick.name].state == "current"
