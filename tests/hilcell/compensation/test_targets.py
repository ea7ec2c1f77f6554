"""Targets CSV: exact round trip, every problem with its line, nothing half written."""

from pathlib import Path

import numpy as np
import pytest

from hilcell.cell.settings import SettingsError
from hilcell.compensation.targets import HEADER, read_targets
from tests.hilcell.lists import write_targets

HEAD = ",".join(HEADER)


def file_of(folder: Path, *lines: str) -> Path:
    path = folder / "targets.csv"
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return path


def test_round_trip(tmp_path: Path) -> None:
    values = np.array([[1.25, -2.5, 3.0, 10.0, 75.5, -0.125], [0.0001, 0, 0, 0, 0, 0]])
    write_targets(tmp_path / "out.csv", ["H1", "H2"], values)
    names, back = read_targets(tmp_path / "out.csv")
    assert names == ["H1", "H2"]
    np.testing.assert_array_equal(back, values)
    assert [p.name for p in tmp_path.iterdir()] == ["out.csv"]


def test_all_problems_are_told_with_their_lines(tmp_path: Path) -> None:
    path = file_of(
        tmp_path, HEAD, "H1,1,2,3,0,0,0", "H1,1,2,3,0,0,0", "H2,1,2,3,0,0", "H3,a,2,3,0,0,0",
        "H4,nan,2,3,0,0,0", "H5,inf,2,3,0,0,0", "H6,1_0,2,3,0,0,0", "H7,\u0661,2,3,0,0,0",
        "H8,1,2,-1.1e6,0,0,10001", "H9,1e308,2,3,0,0,0", f"H10,{300 * '9'},2,3,0,0,0",
    )  # fmt: skip
    with pytest.raises(SettingsError) as told:
        read_targets(path)
    places = ["name 'H1'", "6 fields, expected 7", *5 * ["x_mm"], "z_mm", *2 * ["x_mm"]]
    for line, (problem, place) in enumerate(zip(told.value.problems, places, strict=True), start=3):
        assert problem.startswith(f"line {line}: {place}")
        assert len(problem) < 120


@pytest.mark.parametrize(
    "name", ["", "n" * 3000, " H1", "H\t1", "H\u202e1", "H1\u200d", "=H1"], ids=repr
)
def test_what_is_wrong_with_a_name(tmp_path: Path, name: str) -> None:
    with pytest.raises(SettingsError) as refused:
        read_targets(file_of(tmp_path, HEAD, f"{name},1,2,3,0,0,0"))
    (problem,) = refused.value.problems
    assert problem.startswith("line 2: name ")
    assert len(problem) < 120


def test_persian_names_with_joiners_are_read(tmp_path: Path) -> None:
    name = "\u0645\u06cc\u200c\u062e"
    assert read_targets(file_of(tmp_path, HEAD, f"{name},1,2,3,0,0,0"))[0] == [name]


@pytest.mark.parametrize("lines", [["name,x,y,z"], [HEAD.replace(",", "\t")], [], [HEAD]])
def test_what_is_no_target_list(tmp_path: Path, lines: list[str]) -> None:
    with pytest.raises(SettingsError):
        read_targets(file_of(tmp_path, *lines))


def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    image = tmp_path / "image.png"
    image.write_bytes(b"\x89PNG\r\n")
    for path in (tmp_path / "nowhere.csv", tmp_path, image):
        with pytest.raises(SettingsError):
            read_targets(path)


@pytest.mark.parametrize(
    "header",
    [
        "Name;X;Y;Z;A;B;C", "NAME;X [mm];Y [mm];Z [mm];A [deg];B [deg];C [deg]",
        "name;X (mm);y_mm;Z;A (\u00b0);B;C_DEG",
    ],
)  # fmt: skip
def test_headers_of_spreadsheets_are_read(tmp_path: Path, header: str) -> None:
    names, values = read_targets(file_of(tmp_path, header, "H1;1250,5;-2;3;0;75,25;0"))
    assert names == ["H1"]
    np.testing.assert_array_equal(values, [[1250.5, -2.0, 3.0, 0.0, 75.25, 0.0]])


@pytest.mark.parametrize("column", ["X [m]", "X (inch)", "x_m", "X [deg]", "X mm", "", "x_"])
def test_a_column_of_another_unit_is_refused(tmp_path: Path, column: str) -> None:
    with pytest.raises(SettingsError, match="missing: x_mm"):
        read_targets(file_of(tmp_path, f"Name;{column};Y;Z;A;B;C", "H1;1;2;3;0;0;0"))
