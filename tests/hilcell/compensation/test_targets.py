"""Targets CSV: exact round trip, every problem with its line, nothing half written."""

from pathlib import Path

import numpy as np
import pytest

from hilcell.cell.settings import SettingsError
from hilcell.compensation.grid import Grid, OutsideGrid
from hilcell.compensation.targets import HEADER, read_targets, write_targets

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
    assert told.value.problems == [
        "line 3: name 'H1' was used before",
        "line 4: 7 fields are wanted, found 6",
        "line 5: x_mm is 'a', wanted a number like -12.5",
        "line 6: x_mm is 'nan', wanted a finite number",
        "line 7: x_mm is 'inf', wanted a finite number",
        "line 8: x_mm is '1_0', wanted a number like -12.5",
        "line 9: x_mm is '\u0661', wanted a number like -12.5",
        "line 10: z_mm is '-1.1e6', wanted within +-1e+06",
        "line 11: x_mm is '1e308', wanted within +-1e+06",
        f"line 12: x_mm is '{40 * '9'}...', wanted within +-1e+06",
    ]


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("", "name is empty"),
        ("n" * 3000, f"name '{40 * 'n'}...' has 3000 characters, wanted at most 200"),
        (" H1", "name ' H1' has outer spaces"),
        ("H\t1", "name 'H\\t1' has a control character, U+0009"),
        ("H\u202e1", "name 'H\\u202e1' has a control character, U+202E"),
        ("H1\u200d", "name 'H1\\u200d' has a control character, U+200D"),
        ("=H1", "name '=H1' begins with =: a spreadsheet would compute it"),
    ],
)
def test_what_is_wrong_with_a_name(tmp_path: Path, name: str, fault: str) -> None:
    with pytest.raises(SettingsError) as refused:
        read_targets(file_of(tmp_path, HEAD, f"{name},1,2,3,0,0,0"))
    assert refused.value.problems == [f"line 2: {fault}"]


def test_persian_names_with_joiners_are_read(tmp_path: Path) -> None:
    name = "\u0645\u06cc\u200c\u062e"
    assert read_targets(file_of(tmp_path, HEAD, f"{name},1,2,3,0,0,0"))[0] == [name]


def test_tabs_of_a_header_are_shown(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"found name\\tx_mm"):
        read_targets(file_of(tmp_path, HEAD.replace(",", "\t")))


def test_a_list_in_metres_is_asked_for_its_unit() -> None:
    grid = Grid(np.array([900.0, -300.0, 600.0]), 100.0, (4, 4, 4))
    with pytest.raises(OutsideGrid, match="metres or inches"):
        grid.check_inside(np.array([[1.0, 0.2, 0.9]] * 3))
    with pytest.raises(OutsideGrid) as refused:
        grid.check_inside(np.array([[1.0, 0.2, 0.9], [950.0, -250.0, 650.0]]))
    assert "metres" not in str(refused.value)


@pytest.mark.parametrize(
    ("lines", "part"),
    [
        (["name,x,y,z"], "header must be name,x_mm"),
        ([], "header must be"),
        ([HEAD], "no targets"),
    ],
)
def test_what_is_no_target_list(tmp_path: Path, lines: list[str], part: str) -> None:
    with pytest.raises(SettingsError, match=part):
        read_targets(file_of(tmp_path, *lines))


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"cannot be read: No such file or directory$"):
        read_targets(tmp_path / "nowhere.csv")
    with pytest.raises(SettingsError, match=r"is a folder, not a file$"):
        read_targets(tmp_path)
    (tmp_path / "image.png").write_bytes(b"\x89PNG\r\n")
    with pytest.raises(SettingsError, match=r"is no text in UTF-8; save it as UTF-8$"):
        read_targets(tmp_path / "image.png")
