"""Targets CSV: exact round trip, every problem with its line, nothing half written."""

from pathlib import Path

import numpy as np
import pytest

from hilcell.cell.settings import SettingsError
from hilcell.compensation.targets import HEADER, read_targets
from hilcell.fit.measurements import read_measurements
from hilcell.programs.holes import NORMALS, read_holes
from tests.hilcell.fit.test_fit import HEADER as MEASURED
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


CSV_HEAD = ";".join(HEADER)
VALUES = [[1250.5, -300.0, 0.5, 0.0, 75.25, -0.125], [1.234, 2.0, 3.0, 0.0, 0.0, 0.0]]
ROWS = "Träger 1;1250,5;-300;0,5;0;75,25;-0,125\r\nH2;1,234;2;3;0;0;0\r\n"


def refusal(path: Path) -> str:
    with pytest.raises(SettingsError) as raised:
        read_targets(path)
    return "\n".join(raised.value.problems)


def listed(folder: Path, rows: str, head: str = CSV_HEAD, coding: str = "utf-8") -> Path:
    path = folder / "targets.csv"
    path.write_bytes(f"{head}\r\n{rows}".encode(coding))
    return path


@pytest.mark.parametrize("coding", ["utf-8", "utf-8-sig", "cp1252"])
@pytest.mark.parametrize("decimal", [",", "."])
def test_semicolons_with_either_decimal_sign(tmp_path: Path, coding: str, decimal: str) -> None:
    names, values = read_targets(listed(tmp_path, ROWS.replace(",", decimal), coding=coding))
    assert names == ["Träger 1", "H2"]
    np.testing.assert_array_equal(values, VALUES)


@pytest.mark.parametrize("first", ["", "sep=;\r\n", '"SEP=;"\r\n'])
def test_what_spreadsheets_add_is_left_out(tmp_path: Path, first: str) -> None:
    """The line that states the separator, and separators of empty columns and rows."""
    rows = ROWS.replace("\r\n", ";;\r\n") + ";;;;;;;;\r\n"
    path = listed(tmp_path, rows, f"{first}{CSV_HEAD};;")
    names, values = read_targets(path)
    assert names == ["Träger 1", "H2"]
    np.testing.assert_array_equal(values, VALUES)
    assert "9" in refusal(listed(tmp_path, "H1;1;2;3;0;0;0;;9\n"))
    line = 4 if first else 3
    bad = listed(tmp_path, "H1;0,5;2;3;0;0;0\nH2;x;2;3;0;0;0\n", f"{first}{CSV_HEAD}")
    assert f"line {line}: x_mm" in refusal(bad)


def test_a_header_that_differs_names_the_columns(tmp_path: Path) -> None:
    cells = [each for each in HEADER if each != "b_deg"]
    assert "missing: b_deg" in refusal(listed(tmp_path, "", ",".join(cells)))
    assert "'rotation'" in refusal(listed(tmp_path, "", ",".join([*cells, "rotation"])))
    for head in (",".join(HEADER[::-1]), "\t".join(HEADER)):
        assert refusal(listed(tmp_path, "", head))


@pytest.mark.parametrize("sign", "=@")
def test_a_name_that_a_spreadsheet_would_compute_is_refused(tmp_path: Path, sign: str) -> None:
    assert f"'{sign}1'" in refusal(listed(tmp_path, f"{sign}1;0,5;2;3;0;0;0\n"))


def test_holes_and_measurements_are_read_by_the_same_rules(tmp_path: Path) -> None:
    path = listed(tmp_path, "H1;1250,5;-300,0;900;0;-0,707;0,707\n", ";".join(NORMALS))
    np.testing.assert_array_equal(read_holes(path).points_mm, [[1250.5, -300.0, 900.0]])
    row = "1;T1;0,5;-90;90;0;0;0;1000,25;2;3\n"
    measured = read_measurements(listed(tmp_path, row, ";".join(MEASURED)))
    np.testing.assert_array_equal(measured.xyz_mm, [[1000.25, 2.0, 3.0]])


@pytest.mark.parametrize(
    ("rows", "named"),
    [
        ("H1;1,234;2;3;0;0;0\n", "line 2: '1,234'"),
        ("H1;1.234;2;3;0;0;0\n", "line 2: '1.234'"),
        ("H1;1;-1,234,567;3;0;0;0\n", "line 2: '-1,234,567'"),
        ("H1;1.234,5;2;3;0;0;0\n", "line 2: '1.234,5'"),
        ("H1;0,5;2;3;0;0;0\nH2;1.5;2;3;0;0;0\n", "line 3: '1.5'"),
        ("H1;0,5;1,2,3;3;0;0;0\n", "'1,2,3'"),
        ("H1;0,5;1 234;3;0;0;0\n", "'1 234'"),
        ("H1;0,5;2;3;0;0\n", "6"),
        ("H1,0.5,2,3,0,0,0\n", "1"),
    ],
)
def test_what_is_not_certain_is_refused(tmp_path: Path, rows: str, named: str) -> None:
    assert named in refusal(listed(tmp_path, rows))


@pytest.mark.parametrize("row", ['H1,"1,234",2,3,0,0,0\n', "H1,1,5,2,3,0,0,0\n"])
def test_decimal_commas_between_commas_are_refused(tmp_path: Path, row: str) -> None:
    assert "comma" in refusal(listed(tmp_path, row, ",".join(HEADER)))


def test_one_number_proves_the_sign_of_all(tmp_path: Path) -> None:
    """Another count of decimals, as the refusal asks for, is enough."""
    _, values = read_targets(listed(tmp_path, "H1;1,234;2,3450;3;0;0;0\n"))
    np.testing.assert_array_equal(values, [[1.234, 2.345, 3.0, 0.0, 0.0, 0.0]])


def test_a_cell_of_any_length_is_refused_at_once(tmp_path: Path) -> None:
    rows = f"H1;{100_000 * '1'}x;2,5;3;0;0;0\n"
    assert "x_mm is '1111" in refusal(listed(tmp_path, rows))


def test_other_codings_are_named(tmp_path: Path) -> None:
    assert "UTF-16" in refusal(listed(tmp_path, ROWS, coding="utf-16"))
    path = listed(tmp_path, ROWS)
    path.write_bytes(CSV_HEAD.encode() + b"\nH\x81;1;2;3;0;0;0\n")  # undefined in CP1252
    assert "UTF-8" in refusal(path)
