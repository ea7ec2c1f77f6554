"""Lists as people have them: the same rows in any form are read alike."""

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import xlsxwriter
from hypothesis import given
from hypothesis import strategies as st

from hilcell.cell.settings import SettingsError
from hilcell.fit.columns import read_names
from hilcell.fit.measurements import Measurements, read_measurements
from hilcell.fit.robot_file import Robot
from hilcell.geometry.frames import from_rotvec, matrix, zyx_from_pose
from tests.hilcell.fit.test_fit import HEADER, IRB120, measured

Table = list[list[str]]
ROWS = measured(5, 7, ["SMR1", "SMR2"])
SEPARATORS = [(",", "."), (";", "."), (";", ",")]


def table_of(rows: Measurements) -> Table:
    numbers = np.hstack([np.degrees(rows.joints_rad), rows.xyz_mm])
    return [HEADER] + [
        [pose, target, *(f"{value:.9f}" for value in line)]
        for pose, target, line in zip(rows.pose, rows.target, numbers, strict=True)
    ]


TABLE = table_of(ROWS)


def text_of(table: Table, separator: str = ",", decimal: str = ".") -> bytes:
    text = io.StringIO()
    rows = [table[0], *([cell.replace(".", decimal) for cell in line] for line in table[1:])]
    csv.writer(text, delimiter=separator).writerows(rows)
    return text.getvalue().encode()


def read(
    path: Path, content: bytes, names: str = "", said: list[str] | None = None
) -> Measurements:
    path.write_bytes(content)
    columns = read_names(names) if names else None
    return read_measurements(path, columns, robot=IRB120, say=(said or []).append)


def same(found: Measurements, rows: Measurements = ROWS) -> None:
    assert found.target == rows.target
    np.testing.assert_allclose(found.joints_rad, rows.joints_rad, atol=1e-10)
    np.testing.assert_allclose(found.xyz_mm, rows.xyz_mm, atol=1e-5)


@given(order=st.permutations(range(11)), form=st.sampled_from(SEPARATORS), extra=st.integers(0, 11))
def test_any_order_and_separator_is_read_alike(
    order: list[int], form: tuple[str, str], extra: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    table = [[line[n] for n in order] for line in TABLE]
    for line in table:
        line.insert(extra, "Operator" if line is table[0] else "a, b; 1.5")
    said: list[str] = []
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(text_of(table, *form))
    found = read_measurements(path, say=said.append)
    same(found)
    assert found.pose == ROWS.pose
    assert "14 rows, 7 poses, reflectors SMR1, SMR2" in said[0]
    assert said[0].endswith("ignored columns: Operator")


def scaled(quantities: str, factor: float, unit: str) -> Table:
    """The table with some columns in another unit."""
    places = [n for n, name in enumerate(HEADER) if name[0] in quantities and name[1].isdigit()]
    places += [n for n, name in enumerate(HEADER) if name[0] in quantities and name[1] == "_"]
    header = [name.split("_")[0] + unit if n in places else name for n, name in enumerate(HEADER)]
    rows = [
        [repr(float(cell) * factor) if n in places else cell for n, cell in enumerate(line)]
        for line in TABLE[1:]
    ]
    return [header, *rows]


@pytest.mark.parametrize(
    ("table", "says"),
    [
        (scaled("xyz", 0.001, "_m"), "positions in m"),
        (scaled("xyz", 1 / 25.4, " [in]"), "positions in in"),
        (scaled("xyz", 1.0, ""), "positions in mm"),
        (scaled("j", np.pi / 180, "_rad"), "6 joints in rad"),
        (scaled("j", 1.0, " [\u00b0]"), "6 joints in deg"),
    ],
)
def test_units_of_the_header(tmp_path: Path, table: Table, says: str) -> None:
    said: list[str] = []
    path = tmp_path / "a.csv"
    path.write_bytes(text_of(table))
    same(read_measurements(path, say=said.append))
    assert says in said[0]


def wide(rows: Measurements, seen: Callable[[int, str], bool]) -> Table:
    """A row a pose, a group of columns a reflector, blank where not ``seen``."""
    groups = ["SMR1", "Nest b"]
    table = [[*HEADER[2:8], *(f"{name}_{axis}_mm" for name in groups for axis in "xyz")]]
    for n in range(0, len(rows), 2):
        line = [f"{value:.9f}" for value in np.degrees(rows.joints_rad[n])]
        for k, name in enumerate(groups):
            place = [f"{value:.9f}" for value in rows.xyz_mm[n + k]]
            line += place if seen(n // 2, name) else ["", " ", ""]
        table.append(line)
    return table


def test_a_wide_list_has_a_group_of_columns_a_reflector(tmp_path: Path) -> None:
    named = replace(ROWS, target=["SMR1", "Nest b"] * 7)
    found = read(tmp_path / "a.csv", text_of(wide(ROWS, lambda pose, name: True)))
    same(found, named)
    assert found.pose == [line for line in map(str, range(2, 9)) for _ in range(2)]
    some = read(
        tmp_path / "a.csv", text_of(wide(ROWS, lambda pose, name: name == "SMR1" or pose == 3))
    )
    same(some, named.at([0, 2, 4, 6, 7, 8, 10, 12]))


def test_pose_and_target_may_be_left_out(tmp_path: Path) -> None:
    found = read(tmp_path / "a.csv", text_of([line[2:] for line in TABLE]))
    np.testing.assert_allclose(found.xyz_mm, ROWS.xyz_mm, atol=1e-5)
    assert set(found.target) == {"SMR"}
    assert found.pose == [str(line) for line in range(2, 15, 2) for _ in range(2)]


def test_foreign_names_are_mapped(tmp_path: Path) -> None:
    foreign = dict(zip(HEADER, ["no", "SMR", *"ABCDEF", "East", "x_mm", "z_mm"], strict=True))
    names = {"x_mm": "East", "y_mm": "x_mm"} | {f"j{n}_deg": "ABCDEF"[n - 1] for n in range(1, 7)}
    names |= {"pose": "no", "target": "SMR"}
    content = text_of([list(foreign.values()), *TABLE[1:]])
    same(read(tmp_path / "a.csv", content, ",".join(f"{k}={v}" for k, v in names.items())))
    file = tmp_path / "names.toml"
    file.write_text("".join(f'{ours} = "{theirs}"\n' for ours, theirs in names.items()))
    same(read(tmp_path / "a.csv", content, str(file)))
    with pytest.raises(SettingsError, match="x_mm: no column 'West' among no, SMR"):
        read(tmp_path / "a.csv", content, "x_mm=West")
    for wrong in ("x_cm=East", "x_mm="):
        with pytest.raises(SettingsError, match="--columns: "):
            read_names(wrong)


def workbook(
    path: Path, table: Sequence[Sequence[object]], merged: str = "", sheets: int = 1
) -> bytes:
    book = xlsxwriter.Workbook(path)
    for n in range(sheets):
        sheet = book.add_worksheet(f"Data {n}")
        for row, line in enumerate(table if n == 0 else [["other"]]):
            for place, cell in enumerate(line):
                if str(cell).startswith("="):
                    sheet.write_formula(row + 2, place + 1, str(cell), None, "")
                else:
                    sheet.write(row + 2, place + 1, cell)
    if merged:
        book.worksheets()[0].merge_range(merged, "Joints")
    book.close()
    return path.read_bytes()


def typed(table: Table) -> list[list[str | float]]:
    rows: list[list[str | float]] = [[*table[0]]]
    rows.extend([*line[:2], *map(float, line[2:])] for line in table[1:])
    return rows


def test_a_workbook_is_read_by_its_first_sheet(tmp_path: Path) -> None:
    path, said = tmp_path / "a.xlsx", list[str]()
    workbook(path, [["", *line] for line in typed(TABLE)], sheets=2)
    found = read_measurements(path, say=said.append)
    same(found)
    assert found.lines[0] == 4
    assert "sheet Data 0, the first of 2: 14 rows" in said[0]


@pytest.mark.parametrize(
    ("table", "merged", "says"),
    [
        (typed(TABLE), "B3:C3", "merged cells .*B3:C3"),
        ([["Joints"], *typed(TABLE)], "B3:E3", "the header is in line 4; remove the lines before"),
        ([HEADER, ["1", "A", *["=1+1"] * 9]], "", "D4 is a formula without its result"),
        ([HEADER, ["1", "A", *["#N/A"] * 9]], "", "line 4: j1_deg is '#N/A'"),
    ],
)
def test_a_workbook_that_is_no_list_is_refused(
    tmp_path: Path, table: list[list[str | float]], merged: str, says: str
) -> None:
    workbook(tmp_path / "a.xlsx", table, merged)
    with pytest.raises(SettingsError, match=says):
        read_measurements(tmp_path / "a.xlsx")


def test_a_broken_workbook_is_refused(tmp_path: Path) -> None:
    content = workbook(tmp_path / "a.xlsx", typed(TABLE))
    for broken in (content[:2000], content[:-300], b"PAR1" + content):
        (tmp_path / "a.xlsx").write_bytes(broken)
        with pytest.raises(SettingsError, match="is not"):
            read_measurements(tmp_path / "a.xlsx")


def test_parquet_is_read(tmp_path: Path) -> None:
    columns = zip(*typed(TABLE)[1:], strict=True)
    pq.write_table(pa.table(dict(zip(HEADER, map(list, columns), strict=True))), tmp_path / "a")
    found = read_measurements(tmp_path / "a")
    same(found)
    assert found.pose == ROWS.pose
    row = {f"j{n}_deg": [1.0, 2.0] for n in range(1, 7)}
    unseen = {f"{smr}_{axis}_mm": [5.0, np.nan] for smr in "AB" for axis in "xyz"}
    unseen["A_x_mm"], unseen["A_y_mm"], unseen["A_z_mm"] = [[5.0, 6.0]] * 3
    pq.write_table(pa.table(row | unseen), tmp_path / "b")
    assert read_measurements(tmp_path / "b").target == ["A", "B", "A"]


def quaternions_of(v: np.ndarray) -> np.ndarray:
    angle = np.linalg.norm(v, axis=1, keepdims=True)
    return np.hstack([np.cos(angle / 2), np.sin(angle / 2) * v / angle])


def zyx_of(v: np.ndarray) -> np.ndarray:
    return zyx_from_pose(matrix(from_rotvec(v), v))[:, 3:]


@pytest.mark.parametrize(
    ("kind", "names", "of"),
    [
        ("rotation vector", "rx_rad,ry_rad,rz_rad", lambda v: v),
        ("rotation vector", "rx_deg,ry_deg,rz_deg", np.degrees),
        ("quaternion", "qw,qx,qy,qz", quaternions_of),
        ("Z-Y-X angles", "A,B [deg],c_deg", zyx_of),
        ("roll, pitch, yaw", "yaw_deg,pitch_deg,roll_deg", zyx_of),
    ],
)
def test_orientations_by_their_names(
    tmp_path: Path, kind: str, names: str, of: Callable[[np.ndarray], np.ndarray]
) -> None:
    vectors = np.random.default_rng(3).uniform(-1, 1, (14, 3))
    cells = [[f"{value:.12f}" for value in line] for line in of(vectors)]
    cells[4] = [""] * len(cells[4])
    header = [*HEADER, *names.split(","), "u_deg"]
    table = [line + more + ["0.01"] for line, more in zip(TABLE[1:], cells, strict=True)]
    said: list[str] = []
    (tmp_path / "a.csv").write_bytes(text_of([header, *table]))
    found = read_measurements(tmp_path / "a.csv", say=said.append)
    assert f"orientation: {kind}" in said[0]
    assert found.R is not None
    assert found.u_rad is not None
    known = np.arange(14) != 4
    np.testing.assert_allclose(found.R[known], from_rotvec(vectors[known]), atol=1e-9)
    assert np.isnan(found.R[4]).all()
    np.testing.assert_allclose(found.u_rad[known], np.radians(0.01))


def test_weights_by_row_coordinate_and_group(tmp_path: Path) -> None:
    def u_mm(names: str, cells: str, table: Table = TABLE) -> np.ndarray:
        rows = [[*line, *cells.split(",")] for line in table[1:]]
        found = read(tmp_path / "a.csv", text_of([[*table[0], *names.split(",")], *rows]))
        assert found.covariance_mm2 is not None
        u_mm = np.sqrt(np.diagonal(found.covariance_mm2, axis1=1, axis2=2))
        np.testing.assert_allclose(found.covariance_mm2, u_mm[:, :, None] ** 2 * np.eye(3))
        return np.asarray(u_mm[:2])

    np.testing.assert_allclose(u_mm("u_mm", "0.02"), 0.02)
    np.testing.assert_allclose(u_mm("u [\u00b5m]", "20"), 0.02)
    np.testing.assert_allclose(u_mm("u_z_mm,u_x_mm,u_y_mm", "3,1,2"), [[1, 2, 3]] * 2)
    both = wide(ROWS, lambda pose, name: True)
    np.testing.assert_allclose(u_mm("SMR1_u_mm,u_mm", "1,2", both), [[1] * 3, [2] * 3])


def test_joints_are_those_of_the_robot(tmp_path: Path) -> None:
    """A rail or column is a prismatic joint; its values are m."""
    robot = Robot.from_dh("on a rail", [[0, 90, 0, 0]] * 7, prismatic=[True] + 6 * [False])
    header = [*HEADER[:2], "j1_mm", *(f"j{n}_deg" for n in range(2, 8)), *HEADER[8:]]
    table = [header, *([*line[:2], "1500", *line[2:]] for line in TABLE[1:])]
    path = tmp_path / "a.csv"
    path.write_bytes(text_of(table))
    found = read_measurements(path, robot=robot)
    np.testing.assert_array_equal(found.joints_rad[:, 0], 1.5)
    other = [[name.replace("j1_mm", "j1_rad") for name in header], *table[1:]]
    for wrong, first in ((other, "j1_rad"), (TABLE, "j1_deg")):
        path.write_bytes(text_of(wrong))
        with pytest.raises(SettingsError, match=f"joints j1_mm, .* of on a rail, got {first}"):
            read_measurements(path, robot=robot)


@pytest.mark.parametrize(
    ("names", "ignored"),
    [
        ("nominal_x_mm,nominal_y_mm,nominal_z_mm", "nominal_x_mm, nominal_y_mm, nominal_z_mm"),
        ("Anchor,distance_mm", "Anchor, distance_mm"),
        ("C,u_deg,rx,SMR1_u_deg", "rx, SMR1_u_deg, u_deg, C"),
        ("qw,qx,qy,qz,a_deg,b_deg,c_deg", "a_deg, b_deg, c_deg"),
        ("x_note,j7_grad", "x_note, j7_grad"),
    ],
)
def test_what_does_not_count_is_named(tmp_path: Path, names: str, ignored: str) -> None:
    more = ["1", *["0"] * names.count(",")]
    said: list[str] = []
    table = [[*TABLE[0], *names.split(",")], *([*line, *more] for line in TABLE[1:])]
    (tmp_path / "a.csv").write_bytes(text_of(table))
    same(read_measurements(tmp_path / "a.csv", say=said.append))
    assert f"; ignored columns: {ignored}" in said[0]
