"""From holes to files per station: a plan never contradicts `compensate`."""

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from hilcell.calibration.decision_rule import Guard, decide
from hilcell.calibration.file import write_calibration
from hilcell.cell.file import load_cell
from hilcell.geometry.frames import pose_from_zyx
from hilcell.programs.holes import NORMALS
from hilcell.programs.plan import Volume
from tests.hilcell.calibration.calibrations import LIMITS, T_W_B, calibration
from tests.hilcell.commands.finished_runs import MADE, finished
from tests.hilcell.commands.workplace import read_corrected
from tests.hilcell.lists import write_targets
from tests.whole.bench import command

DIGEST = load_cell("paper").digest
INSIDE = [(0.0, 0.0, 1200.0), (0.0, 50.0, 1250.0), (50.0, -50.0, 1100.0)]
FILES = ["S1100.csv", "S1100.dat", "S1100.src", "sheet.html", "summary.json"]
OUTSIDE = (0.0, 460.0, 1200.0)  # by some 13 mm; reached from S1100 all the same


def made(folder: Path, **changes: Any) -> Path:
    path = folder / "calibration.json"
    write_calibration(msgspec.structs.replace(calibration(digest=DIGEST), **changes), path)
    return path


def holes(folder: Path, *places: tuple[float, float, float], lean: float = 0.0) -> Path:
    """Write holes whose normals point against the calibrated tool, leaning aside by ``lean``."""
    normal = -Volume(calibration()).orientation("S1100")[:, 2] + (0.0, lean, 0.0)
    path = folder / "holes.csv"
    rows = [
        ",".join([f"H{n}", *(f"{each:.6f}" for each in (*place, *normal))])
        for n, place in enumerate(places, start=1)
    ]
    path.write_text("\n".join([",".join(NORMALS), *rows, ""]))
    return path


def planned(path: Path, *words: str | Path) -> list[dict[str, Any]]:
    done = command("plan", path, "--json", *words)
    assert done.returncode == 0, done.stderr
    found: list[dict[str, Any]] = json.loads(done.stdout)["stations"]
    return found


def compensated(folder: Path, station: dict[str, Any]) -> int:
    """Return how `compensate` takes the targets of a plan's station."""
    targets, out = folder / "targets.csv", folder / "out.csv"
    write_targets(targets, station["holes"], np.array(station["targets"]))
    words = ("compensate", folder / "calibration.json", targets, "--station", station["name"])
    return command(*words, "-o", out).returncode


def test_a_plan_by_a_calibration_is_one_that_compensate_takes(tmp_path: Path) -> None:
    path, file = holes(tmp_path, *INSIDE, lean=0.02), made(tmp_path)
    (without,) = planned(path)  # any turn, any station
    assert compensated(tmp_path, without) == 2
    (by,) = planned(path, "--calibration", file)
    assert by["name"] == "S1100"
    assert sorted(by["holes"]) == ["H1", "H2", "H3"]
    assert compensated(tmp_path, by) == 0


def test_holes_that_compensate_refuses_are_refused_with_the_reason(tmp_path: Path) -> None:
    file = made(tmp_path)
    outside = holes(tmp_path, *INSIDE, OUTSIDE)
    planned(outside)
    done = command("plan", outside, "--calibration", file)
    assert done.returncode == 2
    assert "1 of 4" in done.stderr
    assert "H4: " in done.stderr
    leaning = holes(tmp_path, *INSIDE, lean=0.1)
    done = command("plan", leaning, "--calibration", file)
    assert done.returncode == 2
    assert "2 deg" in done.stderr


def test_the_volume_turns_with_the_base() -> None:
    one = calibration()
    T = pose_from_zyx(100.0, 200.0, 0.0, 40.0, 0.0, 10.0)
    turned = msgspec.structs.replace(one.stations["S1100"], T_W_B=T.tolist())
    volume = Volume(msgspec.structs.replace(one, stations={"S1100": turned}))
    pose = T @ pose_from_zyx(1850.0, 0.0, 950.0, 0.0, 75.0, 0.0)
    assert volume.takes("S1100", pose).item()
    np.testing.assert_allclose(volume.orientation("S1100"), pose[:3, :3], atol=1e-12)
    aside = pose @ pose_from_zyx(0.0, 0.0, 0.0, 2.1, 0.0, 0.0)
    assert not volume.takes("S1100", aside).item()


def prepare(folder: Path, path: Path, *words: str | Path) -> subprocess.CompletedProcess[str]:
    file = folder / "calibration.json"
    return command("prepare", path, "--calibration", file, "-o", folder / "out", *words)


def refused(folder: Path, path: Path, *words: str | Path) -> str:
    """Return why nothing is prepared; nothing is written."""
    done = prepare(folder, path, *words)
    assert (done.returncode, (folder / "out").exists()) == (2, False)
    return done.stderr


def test_from_holes_to_files_of_corrected_targets(tmp_path: Path) -> None:
    path, file = holes(tmp_path, *INSIDE), made(tmp_path)
    facts = json.loads(prepare(tmp_path, path, "--json").stdout)
    out = tmp_path / "out"
    assert sorted(each.name for each in out.iterdir()) == FILES
    assert json.loads((out / "summary.json").read_text()) == facts
    names, commands, (stamp,) = read_corrected(out / "S1100.csv")
    assert facts["stations"][0]["holes"] == names
    assert facts["stations"][0]["stamp"] == stamp
    assert 0.0 < facts["stations"][0]["bound95_max_mm"] < 1.0
    (station,) = planned(path, "--calibration", file)
    assert compensated(tmp_path, station) == 0
    _, wanted, _ = read_corrected(tmp_path / "out.csv")
    np.testing.assert_allclose(commands, wanted, atol=2e-4)
    more = ("--calibration", file, "-o", tmp_path / "more")
    assert command("plan", out / "S1100.csv").returncode == 2
    assert command("prepare", out / "S1100.csv", *more).returncode == 2


@pytest.mark.parametrize("off_mm", [0.0, 0.001])
def test_a_hole_listed_twice_is_on_the_sheet_and_in_the_summary(
    tmp_path: Path, off_mm: float
) -> None:
    x_mm, y_mm, z_mm = INSIDE[0]
    path = holes(tmp_path, *INSIDE, (x_mm + off_mm, y_mm, z_mm))
    made(tmp_path)
    assert prepare(tmp_path, path).returncode == 0
    (warning,) = json.loads((tmp_path / "out" / "summary.json").read_text())["warnings"]
    assert "H4 and H1" in warning
    assert warning in (tmp_path / "out" / "sheet.html").read_text()


def test_files_of_another_job_do_not_stay_among_these(tmp_path: Path) -> None:
    path = holes(tmp_path, *INSIDE)
    made(tmp_path)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "S300.csv").write_text("old")
    assert prepare(tmp_path, path).returncode == 2
    assert [each.name for each in (tmp_path / "out").iterdir()] == ["S300.csv"]
    shutil.rmtree(tmp_path / "out")
    (tmp_path / "out").write_text("a file")
    assert prepare(tmp_path, path).returncode == 2


@pytest.mark.parametrize("what", ["prepare", "plan"])
def test_a_calibration_that_failed_plans_and_prepares_nothing(tmp_path: Path, what: str) -> None:
    bad = decide(3.7, 5.0, LIMITS, Guard(0.04, 0.05))
    path, file = holes(tmp_path, *INSIDE), made(tmp_path, verdicts={"S1100": bad})
    out = tmp_path / "out"
    words = (what, path, "--calibration", file, *(("-o", out) if what == "prepare" else ()))
    done = command(*words)
    assert (done.returncode, out.exists()) == (2, False)
    assert "S1100" in done.stderr
    assert command(*words, "--accept-out-of-tolerance").returncode == 0
    if what == "prepare":
        _, _, (stamp,) = read_corrected(out / "S1100.csv")
        assert "; OUT OF TOLERANCE (accepted)" in stamp
        assert "OUT OF TOLERANCE, accepted" in (out / "sheet.html").read_text("utf-8")


def test_what_is_not_the_calibration_s_is_refused(tmp_path: Path) -> None:
    """Free stations, another cell, and a setting that its run's journal has otherwise."""
    path, file, runs = holes(tmp_path, *INSIDE), made(tmp_path), tmp_path / "runs"
    assert command("plan", path, "--free", "--calibration", file).returncode == 2
    assert "hard" in refused(tmp_path, path, "--cell", "hard")
    finished(runs, "1-made", MADE)
    words = ("prepare", path, "--runs", runs, "--calibration", "1-made", "-o", tmp_path / "out")
    done = command(*words, "--set", "plan.quick=true")
    assert done.returncode == 2
    assert "plan.quick False -> True" in done.stderr


def test_a_refusal_names_what_is_beyond_its_limit() -> None:
    """A hole outside has turns of the tool that are inside, and others that are turned right."""
    volume, station = Volume(calibration()), ["S1100"]
    inside, outside = (
        T_W_B @ pose_from_zyx(1850.0, y_mm, 950.0, 0.0, 75.0, 0.0) for y_mm in (0.0, 500.0)
    )
    half = pose_from_zyx(0.0, 0.0, 0.0, 90.0, 0.0, 0.0)
    for poses, words in (
        ([outside, inside @ half], {"50.0 mm"}),
        ([inside @ half], {"90.00 deg"}),
        ([outside @ half], {"50.0 mm", "90.00 deg"}),
    ):
        said = volume.refusal(station, np.array(poses))
        assert {each for each in ("50.0 mm", "90.00 deg") if each in said} == words
        assert ("turned" in said) == ("90.00 deg" in words)


def test_a_tool_across_the_flange_does_not_point_into_the_part() -> None:
    """Turned about its own axis, the flange points back; the normal is right all the same."""
    volume = Volume(calibration())
    at = T_W_B @ pose_from_zyx(1850.0, 500.0, 950.0, 0.0, 75.0, 0.0)
    about_x = np.array([pose_from_zyx(0.0, 0.0, 0.0, 0.0, 0.0, each) for each in (0.0, 180.0)])
    assert volume.points_back(["S1100"], at @ about_x[1:])
    assert not volume.points_back(["S1100"], at @ about_x)
