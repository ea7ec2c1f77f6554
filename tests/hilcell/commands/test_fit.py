"""The command `fit`: robots of either form in, figures and files out."""

import csv
import json
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hilcell.fit.measurements import Measurements
from tests.hilcell.fit.test_fit import HEADER, measured
from tests.hilcell.fit.urdfs import PLAIN
from tests.whole.bench import command

ROBOT = '[robot]\nname = "IRB 120"\nconvention = "standard-dh"\n'
ROWS = [(0, -90, 290, 0), (270, 0, 0, -90), (70, -90, 0, 0), (0, 90, 302, 0), (0, -90, 0, 0),
        (0, 0, 72, 180)]  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the same robot in both forms, and 25 measured poses."""
    write_dh(tmp_path / "robot.toml")
    (tmp_path / "robot.urdf").write_text(PLAIN)
    write_rows(tmp_path / "train.csv", measured(1, 25, ["SMR1"]))
    return tmp_path


def write_dh(path: Path) -> None:
    """Write the robot of `PLAIN` by its DH rows."""
    rows = [
        f"[[robot.joint]]\na_mm = {a}\nalpha_deg = {alpha}\nd_mm = {d}\noffset_deg = {offset}\n"
        for a, alpha, d, offset in ROWS
    ]
    path.write_text(ROBOT + "".join(rows))


def write_rows(path: Path, rows: Measurements) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(HEADER)
        for pose, target, joints, xyz in zip(
            rows.pose, rows.target, np.degrees(rows.joints_rad), rows.xyz_mm, strict=True
        ):
            writer.writerow([pose, target, *np.round(joints, 8), *np.round(xyz, 6)])


def fit(folder: Path, robot: str, *words: str | Path) -> subprocess.CompletedProcess[str]:
    train = folder / "train.csv"
    return command("fit", "--robot", folder / robot, "--train", train, *words)


def test_a_urdf_gives_the_figures_of_its_dh_rows(folder: Path) -> None:
    found = []
    for robot in ("robot.toml", "robot.urdf"):
        printed = json.loads(fit(folder, robot, "--json").stdout)
        assert np.shape(printed["covariance"]) == (len(printed["model"]["names"]),) * 2
        found.append(printed["methods"])
    for method, figures in found[0].items():
        assert found[1][method] == pytest.approx(figures, abs=1e-6)


def test_rows_a_whole_turn_off_are_told(folder: Path) -> None:
    rows = measured(1, 25, ["SMR1"])
    assert "whole turn" not in fit(folder, "robot.toml").stderr
    rows.joints_rad[[3, 9], 5] += 2.0 * np.pi
    write_rows(folder / "test.csv", rows)
    said = fit(folder, "robot.toml", "--test", folder / "test.csv").stderr
    assert re.search(
        r"joint 6 of .*test\.csv: 2 of 25 rows are a whole turn from most training rows", said
    )


def test_a_tip_is_one_of_a_urdf(folder: Path) -> None:
    assert fit(folder, "robot.urdf", "--tip", "link_6").returncode == 0
    for robot, tip in (("robot.urdf", "nose"), ("robot.toml", "tool0")):
        done = fit(folder, robot, "--tip", tip)
        assert done.returncode == 2
        assert tip in done.stderr


def test_the_identified_arm_is_written(folder: Path) -> None:
    out, table = folder / "c.urdf", folder / "dh.csv"
    done = fit(folder, "robot.urdf", "--urdf-out", out, "--dh-out", table, "--json")
    rigid = json.loads(done.stdout)["rigid"]
    assert 0 < rigid["mean_mm"] < rigid["p95_mm"] < rigid["max_mm"] < 0.2
    for words in (done.stderr, out.read_text()):
        assert f"mean {rigid['mean_mm']:.4f}, p95 {rigid['p95_mm']:.4f}" in words
    assert "train.csv" in out.read_text()
    assert len(table.read_text().splitlines()) == 31
    assert fit(folder, "c.urdf").returncode == 0


def test_inputs_are_never_written_over(folder: Path) -> None:
    before = (folder / "robot.urdf").read_bytes()
    assert fit(folder, "robot.urdf", "--urdf-out", folder / "robot.urdf").returncode == 2
    both = folder / "out"
    assert fit(folder, "robot.urdf", "--urdf-out", both, "--dh-out", both).returncode == 2
    assert (folder / "robot.urdf").read_bytes() == before


def test_copied_rows_are_warned_of_and_count_once(folder: Path) -> None:
    """As in a file that was joined twice."""
    write_rows(folder / "test.csv", measured(2, 20, ["SMR1"]))
    words = ("--test", folder / "test.csv", "--json")
    once = fit(folder, "robot.toml", *words)
    head, *lines = (folder / "train.csv").read_text().splitlines()
    (folder / "train.csv").write_text("\n".join([head, *(10 * lines)]))
    done = fit(folder, "robot.toml", *words)
    assert "225 of 250 rows" in done.stderr
    assert "rows of" not in once.stderr
    found, wanted = (json.loads(each.stdout) | {"seconds": 0} for each in (done, once))
    assert found == wanted


def test_rows_that_are_left_out_are_named(folder: Path) -> None:
    rows = measured(1, 25, ["SMR1"])
    rows.xyz_mm[3] += [0.0, 6.0, 0.0]
    write_rows(folder / "train.csv", rows)
    done = fit(folder, "robot.urdf", "--test", folder / "train.csv")
    assert done.returncode == 0
    assert "pose 1003 target SMR1" in done.stderr
    assert "25 rows of" in done.stderr, "the test rows were learnt from"


def mistyped(lines: list[str], *numbers: int) -> list[str]:
    """Return the lines with another reflector in those of these numbers, from 1."""
    return [
        line.replace("SMR1", "SMR2") if number in numbers else line
        for number, line in enumerate(lines, start=1)
    ]


def at_one_place(lines: list[str]) -> list[str]:
    header, first, *_ = lines
    place = first.split(",")[8:]
    return [header, *(",".join([*line.split(",")[:8], *place]) for line in lines[1:])]


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (at_one_place, "train.csv: measured positions: .*one place"),
        (lambda lines: lines[:4],
         "train.csv lines 2, 3, 4: target SMR1 is measured in 3 poses, expected at least 10"),
        (lambda lines: lines[:2], "measured in 1 pose, "),
        (lambda lines: [lines[0].replace("j2_deg", "j2_grad"), *lines[1:]],
         "missing: j2_deg; not understood: j2_grad"),
    ],
)  # fmt: skip
def test_rows_that_no_robot_can_be_fitted_to_are_named(
    folder: Path, spoil: Callable[[list[str]], list[str]], said: str
) -> None:
    lines = spoil((folder / "train.csv").read_text().splitlines())
    (folder / "train.csv").write_text("\n".join(lines) + "\n")
    done = fit(folder, "robot.toml")
    assert done.returncode == 2
    assert re.search(said, done.stderr)


@pytest.mark.parametrize(
    ("numbers", "where"),
    [((5,), "line 5: target SMR2 is measured in 1 pose"),
     ((5, 10, 14), "lines 5, 10, 14: target SMR2 is measured in 3 poses")],
)  # fmt: skip
def test_a_reflector_of_few_poses_leaves_out_what_cannot_be_learnt(
    folder: Path, numbers: tuple[int, ...], where: str
) -> None:
    lines = mistyped((folder / "train.csv").read_text().splitlines(), *numbers)
    (folder / "train.csv").write_text("\n".join(lines) + "\n")
    done = fit(folder, "robot.toml", "--json")
    result = json.loads(done.stdout)
    assert set(result["methods"]) == {"nominal", "mdh", "elastic", "tool", "gp"}
    assert result["methods"][result["chosen"]]["max_mm"] < 0.5
    assert where in result["refused"]["idw"]
    assert where in fit(folder, "robot.toml").stderr


def test_a_test_row_of_an_unknown_reflector_is_named_with_its_line(folder: Path) -> None:
    lines = (folder / "train.csv").read_text().splitlines()
    lines[2] = lines[2].replace("SMR1", "SMR9")
    (folder / "test.csv").write_text("\n".join(lines))
    done = fit(folder, "robot.toml", "--test", folder / "test.csv")
    assert done.returncode == 2
    assert "test.csv line 3: no training row measures target SMR9" in done.stderr
