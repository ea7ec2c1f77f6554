"""From holes to files per station: a plan never contradicts `compensate`."""

import json
import shutil
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from hilcell.calibration.decision import Guard, judged
from hilcell.calibration.file import write_calibration
from hilcell.calibration.volume import Volume
from hilcell.cell.file import load_cell
from hilcell.commands.cli import main
from hilcell.compensation.targets import write_targets
from hilcell.geometry.frames import pose_from_zyx
from hilcell.planning.holes import NORMALS
from tests.hilcell.calibration.calibrations import LIMITS, calibration
from tests.hilcell.commands.finished_runs import MADE, finished
from tests.hilcell.commands.workplace import read_corrected

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


def planned(capsys: pytest.CaptureFixture[str], path: Path, *words: str) -> list[dict[str, Any]]:
    assert main(["plan", str(path), "--json", *words]) == 0
    found: list[dict[str, Any]] = json.loads(capsys.readouterr().out)["stations"]
    return found


def compensated(folder: Path, station: dict[str, Any]) -> int:
    """Return how `compensate` takes the targets of a plan's station."""
    targets, out = folder / "targets.csv", folder / "out.csv"
    write_targets(targets, station["holes"], np.array(station["targets"]))
    return main(
        ["compensate", str(folder / "calibration.json"), str(targets), "--station",
         station["name"], "-o", str(out)]
    )  # fmt: skip


def test_a_plan_by_a_calibration_is_one_that_compensate_takes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, file = holes(tmp_path, *INSIDE, lean=0.02), made(tmp_path)
    (without,) = planned(capsys, path)  # any turn, any station
    assert compensated(tmp_path, without) == 2
    (by,) = planned(capsys, path, "--calibration", str(file))
    assert by["name"] == "S1100"
    assert sorted(by["holes"]) == ["H1", "H2", "H3"]
    assert compensated(tmp_path, by) == 0


def test_holes_that_compensate_refuses_are_refused_with_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = made(tmp_path)
    outside = holes(tmp_path, *INSIDE, OUTSIDE)
    planned(capsys, outside)
    assert main(["plan", str(outside), "--calibration", str(file)]) == 2
    refusal = capsys.readouterr().err
    assert "1 of 4 holes cannot be drilled" in refusal
    assert "H4: outside the calibrated volume by" in refusal
    leaning = holes(tmp_path, *INSIDE, lean=0.1)
    assert main(["plan", str(leaning), "--calibration", str(file)]) == 2
    assert "from the calibrated orientation at S1100, wanted <= 2 deg" in capsys.readouterr().err


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


def test_free_stations_are_not_calibrated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, file = holes(tmp_path, *INSIDE), made(tmp_path)
    assert main(["plan", str(path), "--free", "--calibration", str(file)]) == 2
    assert "stations that are not calibrated" in capsys.readouterr().err


def prepare(folder: Path, path: Path, *words: str) -> int:
    file = str(folder / "calibration.json")
    return main(["prepare", str(path), "--calibration", file, "-o", str(folder / "out"), *words])


def test_from_holes_to_files_of_corrected_targets(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, file = holes(tmp_path, *INSIDE), made(tmp_path)
    assert prepare(tmp_path, path, "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    out = tmp_path / "out"
    assert sorted(each.name for each in out.iterdir()) == FILES
    assert json.loads((out / "summary.json").read_text()) == facts
    names, command, (stamp,) = read_corrected(out / "S1100.csv")
    assert facts["stations"][0]["holes"] == names
    assert facts["stations"][0]["stamp"] == stamp
    assert 0.0 < facts["stations"][0]["bound95_max_mm"] < 1.0
    (station,) = planned(capsys, path, "--calibration", str(file))
    assert compensated(tmp_path, station) == 0
    _, wanted, _ = read_corrected(tmp_path / "out.csv")
    np.testing.assert_allclose(command, wanted, atol=2e-4)
    for words in (["plan", str(out / "S1100.csv")], ["prepare", str(out / "S1100.csv"),
                  "--calibration", str(file), "-o", str(tmp_path / "more")]):  # fmt: skip
        assert main(words) == 2
        assert "was corrected before" in capsys.readouterr().err


@pytest.mark.parametrize("off_mm", [0.0, 0.001])
def test_a_hole_listed_twice_is_on_the_sheet_and_in_the_summary(
    tmp_path: Path, off_mm: float
) -> None:
    x_mm, y_mm, z_mm = INSIDE[0]
    path = holes(tmp_path, *INSIDE, (x_mm + off_mm, y_mm, z_mm))
    made(tmp_path)
    assert prepare(tmp_path, path) == 0
    (warning,) = json.loads((tmp_path / "out" / "summary.json").read_text())["warnings"]
    assert "H4 and H1 are" in warning
    assert warning in (tmp_path / "out" / "sheet.html").read_text()


def test_files_of_another_job_do_not_stay_among_these(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = holes(tmp_path, *INSIDE)
    made(tmp_path)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "S300.csv").write_text("old")
    assert prepare(tmp_path, path) == 2
    assert "is not empty" in capsys.readouterr().err
    assert [each.name for each in (tmp_path / "out").iterdir()] == ["S300.csv"]
    shutil.rmtree(tmp_path / "out")
    (tmp_path / "out").write_text("a file")
    assert prepare(tmp_path, path) == 2
    assert "is a file; name a folder" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["prepare", "plan"])
def test_a_calibration_that_failed_plans_and_prepares_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    bad = judged(3.7, 5.0, LIMITS, Guard(0.04, 0.05))
    path, file = holes(tmp_path, *INSIDE), made(tmp_path, verdicts={"S1100": bad})
    words = [command, str(path), "--calibration", str(file)]
    words += ["-o", str(tmp_path / "out")] if command == "prepare" else []
    assert main(words) == 2
    assert "validation at S1100: out of tolerance" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert main([*words, "--accept-out-of-tolerance"]) == 0
    assert "accepted although validation at S1100" in capsys.readouterr().err
    if command == "prepare":
        _, _, (stamp,) = read_corrected(tmp_path / "out" / "S1100.csv")
        assert "; OUT OF TOLERANCE (accepted)" in stamp
        page = (tmp_path / "out" / "sheet.html").read_text("utf-8")
        assert "OUT OF TOLERANCE, accepted" in page
        assert "accepted although validation at S1100" in page


def test_another_cell_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = holes(tmp_path, *INSIDE)
    made(tmp_path)
    assert prepare(tmp_path, path, "--cell", "hard") == 2
    assert "it is of cell paper, not hard" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_setting_that_is_not_the_run_s_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The run was made without it, and its journal says so."""
    path, runs = holes(tmp_path, *INSIDE), tmp_path / "runs"
    finished(runs, "1-made", MADE)
    words = ["prepare", str(path), "--runs", str(runs), "--calibration", "1-made"]
    words += ["-o", str(tmp_path / "out"), "--set", "plan.quick=true"]
    assert main(words) == 2
    told = capsys.readouterr().err
    assert "or other --set than its run's" in told
    assert "plan.quick False -> True" in told
