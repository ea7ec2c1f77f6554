"""CSV of German and French spreadsheets: read where it is certain, refused with the reason else."""

from pathlib import Path

import numpy as np
import pytest

from hilcell.cell.settings import SettingsError
from hilcell.compensation.targets import HEADER, read_targets
from hilcell.fit import robot_file
from hilcell.programs.holes import NORMALS, read_holes

HEAD = ";".join(HEADER)
VALUES = [[1250.5, -300.0, 0.5, 0.0, 75.25, -0.125], [1.234, 2.0, 3.0, 0.0, 0.0, 0.0]]
ROWS = "Träger 1;1250,5;-300;0,5;0;75,25;-0,125\r\nH2;1,234;2;3;0;0;0\r\n"


def refusal(path: Path) -> str:
    with pytest.raises(SettingsError) as raised:
        read_targets(path)
    return "\n".join(raised.value.problems)


def listed(folder: Path, rows: str, head: str = HEAD, coding: str = "utf-8") -> Path:
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
    path = listed(tmp_path, rows, f"{first}{HEAD};;")
    names, values = read_targets(path)
    assert names == ["Träger 1", "H2"]
    np.testing.assert_array_equal(values, VALUES)
    assert "9" in refusal(listed(tmp_path, "H1;1;2;3;0;0;0;;9\n"))
    line = 4 if first else 3
    bad = listed(tmp_path, "H1;0,5;2;3;0;0;0\nH2;x;2;3;0;0;0\n", f"{first}{HEAD}")
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
    measured = robot_file.read_measurements(listed(tmp_path, row, ";".join(robot_file.HEADER)))
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
    path.write_bytes(HEAD.encode() + b"\nH\x81;1;2;3;0;0;0\n")  # undefined in CP1252
    assert "UTF-8" in refusal(path)
