"""The command `fit`: robots of either form in, figures and files out."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from hilcell.commands.cli import main
from hilcell.fit.robot_file import HEADER, Measurements
from tests.hilcell.fit.test_fit import measured
from tests.hilcell.fit.urdfs import PLAIN

ROBOT = '[robot]\nname = "IRB 120"\nconvention = "standard-dh"\n'
ROWS = [(0, -90, 290, 0), (270, 0, 0, -90), (70, -90, 0, 0), (0, 90, 302, 0), (0, -90, 0, 0),
        (0, 0, 72, 180)]  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the same robot in both forms, and 25 measured poses."""
    rows = [
        f"[[robot.joint]]\na_mm = {a}\nalpha_deg = {alpha}\nd_mm = {d}\noffset_deg = {offset}\n"
        for a, alpha, d, offset in ROWS
    ]
    (tmp_path / "robot.toml").write_text(ROBOT + "".join(rows))
    (tmp_path / "robot.urdf").write_text(PLAIN)
    write_rows(tmp_path / "train.csv", measured(1, 25, ["SMR1"]))
    return tmp_path


def write_rows(path: Path, rows: Measurements) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(HEADER)
        for pose, target, joints, xyz in zip(
            rows.pose, rows.target, np.degrees(rows.joints_rad), rows.xyz_mm, strict=True
        ):
            writer.writerow([pose, target, *np.round(joints, 8), *np.round(xyz, 6)])


def fit(folder: Path, robot: str, *words: str) -> int:
    return main(
        ["fit", "--robot", str(folder / robot), "--train", str(folder / "train.csv"), *words]
    )


def test_a_urdf_gives_the_figures_of_its_dh_rows(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = []
    for robot in ("robot.toml", "robot.urdf"):
        assert fit(folder, robot, "--json") == 0
        printed = json.loads(capsys.readouterr().out)
        assert np.shape(printed["covariance"]) == (len(printed["model"]["names"]),) * 2
        found.append(printed["methods"])
    for method, figures in found[0].items():
        assert found[1][method] == pytest.approx(figures, abs=1e-6)


def test_a_tip_is_one_of_a_urdf(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert fit(folder, "robot.urdf", "--tip", "link_6") == 0
    assert fit(folder, "robot.urdf", "--tip", "nose") == 2
    assert "no joint leads to link nose" in capsys.readouterr().err
    assert fit(folder, "robot.toml", "--tip", "tool0") == 2
    assert "--tip tool0 names a link of a URDF" in capsys.readouterr().err


def test_the_identified_arm_is_written(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, table = folder / "c.urdf", folder / "dh.csv"
    assert fit(folder, "robot.urdf", "--urdf-out", str(out), "--dh-out", str(table), "--json") == 0
    printed = capsys.readouterr()
    rigid = json.loads(printed.out)["rigid"]
    assert 0 < rigid["mean_mm"] < rigid["p95_mm"] < rigid["max_mm"] < 0.2
    line = f"By itself it leaves mean {rigid['mean_mm']:.4f}, p95 {rigid['p95_mm']:.4f}, max"
    assert line in printed.err
    assert f"the identified arm is in {out} and {table}" in printed.err
    assert line in out.read_text()
    assert "25 rows of train.csv" in out.read_text()
    assert len(table.read_text().splitlines()) == 31
    assert fit(folder, "c.urdf") == 0


def test_inputs_are_never_written_over(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (folder / "robot.urdf").read_bytes()
    assert fit(folder, "robot.urdf", "--urdf-out", str(folder / "robot.urdf")) == 2
    assert "robot.urdf is what is read; write elsewhere" in capsys.readouterr().err
    both = str(folder / "out")
    assert fit(folder, "robot.urdf", "--urdf-out", both, "--dh-out", both) == 2
    assert (folder / "robot.urdf").read_bytes() == before


def test_rows_that_are_left_out_are_named(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = measured(1, 25, ["SMR1"])
    rows.xyz_mm[3] += [0.0, 6.0, 0.0]
    write_rows(folder / "train.csv", rows)
    assert fit(folder, "robot.urdf", "--test", str(folder / "train.csv")) == 0
    printed = capsys.readouterr()
    assert "pose 1003 target SMR1 contradicts the others by 6" in printed.err
    assert "within 95 % bounds of 0." in printed.out
    assert "chosen: " in printed.out


def test_a_reflector_that_was_knocked_in_between_is_named(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = measured(1, 40, ["SMR1", "SMR2", "SMR3"])
    rows.xyz_mm[:45:3] += [0.0, 2.0, 0.0]
    write_rows(folder / "train.csv", rows)
    assert fit(folder, "robot.urdf") == 0
    said = capsys.readouterr().err
    assert "warning: 15 of 120 training rows are left out, wanted at most 10%" in said
    assert "bounds may be too small; look at reflector SMR1, 15 of them" in said


def test_why_no_robot_is_identified_is_said(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_rows(folder / "train.csv", measured(1, 14, ["SMR1"]))
    assert fit(folder, "robot.urdf") == 0
    assert "no robot is identified: kinematics: 14 poses" in capsys.readouterr().err


def test_test_rows_that_were_learnt_from_are_named(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_rows(folder / "other.csv", measured(2, 5, ["SMR1"]))
    assert fit(folder, "robot.toml", "--test", str(folder / "other.csv")) == 0
    assert "training rows too" not in capsys.readouterr().err
    assert fit(folder, "robot.toml", "--test", str(folder / "train.csv")) == 0
    assert "25 rows of" in capsys.readouterr().err
