"""Lists of measured targets: strict, all problems at once, with lines."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hilcell.fit.measurements import Measurements, read_measurements
from hilcell.fit.methods import fit_robot, worse_than_nominal
from hilcell.fit.placement import FitError
from hilcell.geometry.statistics import Figures
from tests.hilcell.fit.test_fit import HEADER, IRB120, measured
from tests.hilcell.fit.test_robot_file import Write, file_problems

LINE = "518,SMR1,-10,33.9,-0.3,-49.5,-15.8,3.5,2439.1,83.2,-289.9"


def test_measurements_are_read(written: Write) -> None:
    header = ",".join(HEADER)
    rows = read_measurements(
        written(f"\ufeff{header}\r\n{LINE}\r\n{LINE.replace('SMR1', 'SMR2')}\r\n")
    )
    assert (rows.pose, rows.target, len(rows)) == (["518", "518"], ["SMR1", "SMR2"], 2)
    np.testing.assert_allclose(np.degrees(rows.joints_rad[0]), [-10, 33.9, -0.3, -49.5, -15.8, 3.5])
    np.testing.assert_array_equal(rows.xyz_mm[1], [2439.1, 83.2, -289.9])
    assert rows.at([1]).target == ["SMR2"]


def test_an_undecodable_list_is_refused(tmp_path: Path) -> None:
    (tmp_path / "given").write_bytes("ü".encode("latin-1"))
    assert "UTF-8" in file_problems(read_measurements, tmp_path / "given")


def test_every_bad_line_is_named(written: Write) -> None:
    lines = [
        ",".join(HEADER),
        LINE,
        LINE.replace("33.9", "nan"),
        LINE.replace("33.9", "33,9"),
        LINE.replace("2439.1", "inf"),
        LINE.replace("2439.1", "2439.1 mm"),
        LINE.replace("SMR1", " "),
        "518",
        LINE.replace("2439.1", "1e999"),
        LINE.replace("2439.1", "1_0"),
        LINE.replace("2439.1", "\u0661\u0662"),
        LINE.replace("2439.1", "1e308"),
    ]
    said = file_problems(read_measurements, written("\n".join(lines)))
    assert "line 2:" not in said
    places = {3: "j2_deg", 4: "12", 5: "x_mm", 6: "x_mm", 7: "target", 8: "1", 9: "x_mm"}
    for line, place in (places | dict.fromkeys((10, 11, 12), "x_mm")).items():
        assert f"line {line}: {place} " in said
    far = "\n".join([lines[0], LINE.replace("33.9", "10001")])
    assert "line 2: j2_deg " in file_problems(read_measurements, written(far))


def test_a_long_list_of_bad_lines_is_cut(written: Write) -> None:
    said = file_problems(read_measurements, written(",".join(HEADER) + 50 * "\nx"))
    assert "and 10 more" in said
    assert said.count("\n") == 41


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "line 1: "),
        (LINE, "line 1: "),
        (",".join(HEADER) + ",j1_rad\n" + LINE + ",1", "j1_deg and j1_rad"),
        (",".join(HEADER) + ",x_mm\n" + LINE + ",1", "x_mm and x_mm"),
        (",".join(HEADER).replace("j3_deg", "j3_grad") + "\n" + LINE, "j3_deg; .*: j3_grad"),
        ("pose,target,x_mm,y_mm,z_mm\n1,A,1,2,3", "missing: j1_deg"),
        ("pose;joints;;x_mm\n" + ";".join(HEADER), "in line 2; remove"),
        ("# of\n# today, 9:00\n\n" + ",".join(HEADER) + "\n" + LINE, "in line 4; remove"),
        ("\t".join(HEADER), "tabs"),
        (",".join(HEADER) + ",u_mm\n" + LINE + ",0", "line 2: u_mm is 0"),
        (",".join(HEADER) + ",u_mm,u_x_mm\n" + LINE + ",1,1", "u_mm and u_x_mm"),
        (",".join(HEADER) + ",qw,qx,qy,qz\n" + LINE + ",1,1,0,0", "line 2: quaternion .* 1.414"),
        (",".join(HEADER) + ",a_deg,b_deg\n" + LINE + ",1,1", "missing: c_deg"),
        (",".join(HEADER).replace("x_mm", "S1_x_mm") + "\n" + LINE, "missing: x_mm"),
        (",".join(HEADER) + "\n", "no measured target"),
    ],
)
def test_measurements_are_refused(written: Write, text: str, says: str) -> None:
    assert re.search(says, file_problems(read_measurements, written(text)))


def test_blanks_and_empty_lines_are_read_as_in_lists_of_holes(written: Write) -> None:
    text = "\n".join([",".join(HEADER), LINE, LINE.replace("SMR1", "SMR2")])
    plain = read_measurements(written(text))
    spread = text.replace(",", " , ").replace("pose", "Pose").replace("x_mm", "X [mm]")
    for other in (spread, f"{text}\n\n \n", text.replace("\n", "\n\n"), text.replace(",", ", ")):
        read = read_measurements(written(other))
        assert (read.pose, read.target) == (plain.pose, plain.target)
        np.testing.assert_array_equal(read.joints_rad, plain.joints_rad)
        np.testing.assert_array_equal(read.xyz_mm, plain.xyz_mm)


def test_a_reflector_at_zero_was_not_seen(written: Write) -> None:
    line, said = LINE.split(","), list[str]()
    unseen, on_an_axis = [*line[:-3], "0", "0.0", "0"], [*line[:-3], "0", "0", "5"]
    lines = map(",".join, (HEADER, line, unseen, on_an_axis))
    rows = read_measurements(written("\n".join(lines)), say=said.append)
    assert rows.lines == [2, 4]
    assert "(1 line without a measurement) (1 position 0, 0, 0 taken as not seen)" in said[0]


def test_lines_without_a_measurement_and_reused_labels_are_said(written: Write) -> None:
    first, unseen = LINE.split(","), LINE.split(",")
    unseen[-3:] = ["", "", ""]
    other = [first[0], "SMR2", str(float(first[2]) + 5.0), *first[3:]]
    said: list[str] = []
    lines = [LINE, "", ",".join(unseen), ",".join(other)]
    read_measurements(written("\n".join([",".join(HEADER), *lines])), say=said.append)
    assert "2 rows" in said[0]
    assert "(2 lines without a measurement)" in said[0]
    assert "line 5: pose 518 has other joints" in said[1]


def test_rows_that_repeat_another_exactly_count_once(written: Write) -> None:
    other = LINE.replace("2439.1", "2439.1001")
    lines = [LINE, other, LINE, LINE.replace("518", "7"), LINE.replace("SMR1", "SMR2"), LINE]
    rows = read_measurements(written("\n".join([",".join(HEADER), *lines])))
    once = rows.once()
    assert (len(rows), once.target, once.pose) == (6, ["SMR1", "SMR1", "SMR2"], ["518"] * 3)
    np.testing.assert_array_equal(once.xyz_mm, rows.xyz_mm[[0, 1, 4]])
    assert once.source == rows.source


def copied(rows: Measurements, times: int) -> Measurements:
    """The same poses again in further rounds, with pose numbers of their own, noise and joints that
    the controller reports a little differently.
    """
    rng = np.random.default_rng(6)
    again = rows.at(np.tile(np.arange(len(rows)), times))
    turn = np.repeat(np.arange(times), len(rows))
    return replace(
        again,
        pose=[f"{pose}.{n}" for pose, n in zip(again.pose, turn, strict=True)],
        joints_rad=again.joints_rad + np.radians(0.002) * rng.uniform(-1, 1, (len(again), 6)),
        xyz_mm=again.xyz_mm + rng.normal(0, 0.01, again.xyz_mm.shape),
    )


def test_poses_measured_again_do_not_flatter_a_method() -> None:
    """Their errors are known from the copy, whatever the pose's number."""
    rows, test = measured(1, 22, ["SMR1"]), measured(2, 40, ["SMR1"])
    once, thrice = (
        fit_robot(IRB120, rows, test).result,
        fit_robot(IRB120, copied(rows, 3), test).result,
    )
    assert thrice["chosen"] not in ("nominal", "idw")
    for result in (once, thrice):
        idw = result["coverage"]["idw"]
        assert idw["share"] >= 0.85
        assert idw["bound_mm"] > 0.8 * once["coverage"]["idw"]["bound_mm"]
    assert thrice["coverage"][thrice["chosen"]]["share"] >= 0.85


def test_a_pose_counts_once_however_often_it_is_measured() -> None:
    result = fit_robot(IRB120, copied(measured(1, 15, ["SMR1"]), 4)).result
    assert "15 poses" in result["refused"]["tool"]
    with pytest.raises(FitError, match="8"):
        fit_robot(IRB120, copied(measured(1, 8, ["SMR1"]), 4))


def test_the_order_of_rows_decides_nothing() -> None:
    rows, test = measured(1, 22, ["SMR1", "SMR2"]), measured(2, 20, ["SMR1", "SMR2"])
    rows.xyz_mm[7, 0] += 10.0
    first = fit_robot(IRB120, rows, test).result
    shuffled = rows.at(np.random.default_rng(4).permutation(len(rows)))
    again = fit_robot(IRB120, shuffled, test).result
    assert (again["chosen"], again["reason"]) == (first["chosen"], first["reason"])
    assert len(again["outliers"]) == len(first["outliers"]) == 1
    for method, figures in first["methods"].items():
        assert again["methods"][method] == pytest.approx(figures, rel=1e-5)
        assert again["coverage"][method] == pytest.approx(first["coverage"][method], rel=1e-5)


def test_test_rows_that_contradict_the_training_rows_are_refused() -> None:
    """A tracker whose lengths are 0.05 % too long."""
    rows, test = measured(1, 22, ["SMR1", "SMR2"]), measured(2, 20, ["SMR1", "SMR2"])
    other = replace(test, xyz_mm=1.0005 * test.xyz_mm, source="test.csv")
    with pytest.raises(FitError, match=r"test\.csv: .*40 rows"):
        fit_robot(IRB120, rows, other)


def test_a_choice_worse_than_nominal_on_the_test_rows_is_not_kept() -> None:
    """The reproduction: 6.1 against 5.3 mm, chosen without a word."""
    means_mm = (("nominal", 5.3), ("idw", 6.1), ("tool", 0.1))
    judged = {name: Figures(mean_mm, 7.0, 9.0) for name, mean_mm in means_mm}
    assert worse_than_nominal("idw", judged)
    assert not worse_than_nominal("tool", judged)
    assert not worse_than_nominal("nominal", judged)
    assert worse_than_nominal("idw", judged | {"idw": Figures(float("nan"), 7.0, 9.0)})
