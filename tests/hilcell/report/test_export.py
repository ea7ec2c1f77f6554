"""Exports: every column, units in the headers, nothing that a spreadsheet would run."""

import csv
import io
import json
import re
import xml.etree.ElementTree as ET
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hilcell.calibration.grid import grid_of
from hilcell.cell.file import load_cell
from hilcell.commands.cli import main
from hilcell.fit.urdf_file import read_robot
from hilcell.geometry.frames import apply, from_zyx, matrix
from hilcell.geometry.kinematics import forward
from hilcell.model.point import PointId
from hilcell.report.export import (
    POINTS,
    csv_bytes,
    json_bytes,
    results_table,
    urdf_of_run,
    xlsx_bytes,
)
from tests.hilcell.fit.urdfs import reached_m
from tests.hilcell.report.journals import Writer, validated_run

POINT_KEYS = [column.key for column in POINTS]
SHEET = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"


def test_points_as_csv(tmp_path: Path) -> None:
    rows = list(
        csv.DictReader(io.StringIO(csv_bytes(validated_run(tmp_path / "r").facts()).decode()))
    )
    assert list(rows[0]) == [*POINT_KEYS, "simulated"]
    assert {row["simulated"] for row in rows} <= {"yes", "no"}
    assert len(rows) == 16
    second = rows[1]
    assert second["key"] == "validate/S1100/before/001"
    assert float(second["x_mm"]) == float(second["world_x_mm"]) == 100.0
    assert float(second["y_mm"]) == 52.0
    assert float(second["error_y_mm"]) == pytest.approx(2.0)
    assert float(second["error_mm"]) == pytest.approx(2.0)
    assert float(second["commanded_a6_deg"]) == 6.0
    assert second["pose_x_mm"] == ""
    assert float(second["temperature_c"]) == 22.0


def test_readings_have_their_age_at_use(tmp_path: Path) -> None:
    tracker, robot = (
        {"taken_s": 12.0, "age_s": 0.02},
        {"taken_s": 11.0, "age_s": 1.0, "ended_s": 9.5},
    )
    rail = {"taken_s": 12.0, "age_s": 0.01, "ended_s": 4.0}
    writer = Writer(tmp_path / "r").began()
    times = {"tracker": tracker, "rail": rail}
    writer.point(PointId("grid"), (0, 0, 0), readings=times | {"robot": robot})
    writer.point(PointId("world"), (0, 0, 0), readings=times)
    writer.point(PointId("old"), (0, 0, 0))
    names = ("tracker_age_s", "rail_age_s", "robot_age_s", "settled_s")
    rows = csv.DictReader(io.StringIO(csv_bytes(writer.facts()).decode()))
    assert [[row[name] for name in names] for row in rows] == [
        ["0.02", "0.01", "1.0", "2.5"],
        ["0.02", "0.01", "", "8.0"],
        ["", "", "", ""],
    ]


def test_a_run_s_arm_is_a_urdf_with_its_base_and_reflector(tmp_path: Path) -> None:
    """The grid has one orientation of the flange: only the circles tell base from reflector."""
    cell, writer = load_cell("paper"), Writer(tmp_path / "r").began()
    arm, station, rng = cell.robot.arm(), cell.grid.station, np.random.default_rng(3)
    true = replace(arm, a_mm=arm.a_mm + [0.0, 0.8, -0.5, 0.0, 0.0, 0.0])
    T_L_B = matrix(from_zyx([170.0, 0.0, 0.0]), np.array([4000.0, 300.0, -900.0]))
    vertices_mm = grid_of(cell).serpentine_mm()
    grid_rad = cell.robot.nominal().joints_for(
        matrix(cell.grid.centre.matrix()[:3, :3], vertices_mm)
    )
    circles_rad = np.radians(np.tile(cell.base_frame.axis_1_deg, (10, 1)))
    circles_rad[:5, 0] += np.radians([-60.0, -30.0, 0.0, 30.0, 60.0])
    circles_rad[5:, 5] += np.radians([-150.0, -75.0, 0.0, 75.0, 150.0])
    ids = [PointId("grid", vertex=(n, 0, 0)) for n in range(len(grid_rad))]
    ids += [PointId("base", axis=1 if n < 5 else 6, number=n) for n in range(10)]
    joints_rad = np.vstack([grid_rad, circles_rad])
    seen_mm = apply(T_L_B, forward(true, joints_rad)[:, :3, 3]) + rng.normal(0, 0.02, (len(ids), 3))
    for id, joints, xyz_mm in zip(ids, joints_rad, seen_mm, strict=True):
        writer.point(id, xyz_mm, station, commanded_deg=tuple(np.degrees(joints).tolist()))
    urdf = tmp_path / "arm.urdf"
    urdf.write_bytes(urdf_of_run(writer.facts()))
    (root,) = re.findall(r"xyz in m, rpy in rad: (.*);", urdf.read_text())
    (smr,) = re.findall(r"Reflector SMR in the tip link, in m: (.*) -->", urdf.read_text())
    root_mm, smr_mm = (1000.0 * np.array(each.split(), dtype=float) for each in (root, smr))
    assert np.linalg.norm(root_mm - T_L_B[:3, 3]) < 2.0
    assert np.linalg.norm(smr_mm - cell.robot.smr_mm) < 1.0
    flange = read_robot(urdf).poses(grid_rad) @ matrix(np.eye(3), smr_mm)
    ends_rad = np.radians([(each.min_deg, each.max_deg) for each in cell.robot.joint]).T
    stated = ET.fromstring(urdf.read_bytes()).findall("joint[@type='revolute']/limit")
    found = np.array(
        [[float(each.attrib[key]) for key in ("lower", "upper", "velocity")] for each in stated]
    ).T
    np.testing.assert_allclose(found[:2], ends_rad, atol=1e-8)
    speeds_deg_s = [each.speed_deg_s for each in cell.robot.joint]
    np.testing.assert_allclose(np.degrees(found[2]), speeds_deg_s, atol=1e-6)
    assert {each.attrib["effort"] for each in stated} == {"0"}
    places_mm = []
    for ends in found[:2]:
        tip = reached_m(urdf.read_text(), {f"joint_{n}": q for n, q in enumerate(ends, start=1)})
        places_mm.append((tip @ [*smr_mm / 1000.0, 1.0])[:3] * 1000.0)
    gone_mm = np.diff(places_mm, axis=0)[0]
    assert np.linalg.norm(gone_mm - np.diff(forward(true, ends_rad)[:, :3, 3], axis=0)[0]) < 5.0
    from_first_mm = flange[:, :3, 3] - flange[0, :3, 3]
    true_mm = forward(true, grid_rad)[:, :3, 3]
    off_mm = np.linalg.norm(from_first_mm, axis=1) - np.linalg.norm(true_mm - true_mm[0], axis=1)
    assert np.abs(off_mm).max() < 0.1


def test_a_formula_stays_text(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "r").began()
    writer.point(PointId("=1+1"), (-1, 0, 0), reflector="@x\u202e")
    facts = writer.facts()
    row = next(csv.DictReader(io.StringIO(csv_bytes(facts).decode())))
    assert row["key"] == "'=1+1"
    assert row["reflector"] == "'@x\ufffd"
    assert row["x_mm"] == "-1.0"
    with zipfile.ZipFile(io.BytesIO(xlsx_bytes(facts))) as book:
        assert b"<f>" not in book.read("xl/worksheets/sheet2.xml")


def test_a_workbook_can_be_worked_with(tmp_path: Path) -> None:
    facts = validated_run(tmp_path / "r").facts()
    content = xlsx_bytes(facts)
    assert content == xlsx_bytes(facts)
    with zipfile.ZipFile(io.BytesIO(content)) as book:
        names = [each.get("name") for each in _tree(book, "workbook.xml").iter(f"{SHEET}sheet")]
        words = ["".join(each.itertext()) for each in _tree(book, "sharedStrings.xml")]
        points, frames, compared = (_tree(book, f"worksheets/sheet{n}.xml") for n in (2, 3, 5))
        table = _tree(book, "tables/table1.xml")
        styles = book.read("xl/styles.xml").decode()
    assert names == ["run", "points", "frames", "results", "before and after"]
    rows = list(points.iter(f"{SHEET}row"))
    assert len(rows) == 1 + 16
    assert [words[int(value)] for value in values(rows[0])] == POINT_KEYS
    assert points.find(f"{SHEET}autoFilter") is not None
    cells = {cell.get("r"): cell for cell in points.iter(f"{SHEET}c")}
    column = (rows[0][POINT_KEYS.index("x_mm")].get("r") or "").rstrip("1")
    assert float(cells[f"{column}2"].findtext(f"{SHEET}v", "nan")) == 1.0
    days = float(cells["B2"].findtext(f"{SHEET}v", "nan"))  # a date is a number of days
    assert 40_000 < days < 80_000
    assert cells["B2"].get("s") not in (None, "0")
    assert "yyyy-mm-dd hh:mm:ss" in styles
    assert '"0.0000"' in styles
    assert table.get("displayName") == "before_after"
    headers = [each.get("name") for each in table.iter(f"{SHEET}tableColumn")]
    assert headers[:4] == ["station", "error", "targets", "mean_mm"]
    assert float(values(list(compared.iter(f"{SHEET}row"))[1])[3]) == pytest.approx(2.0)
    world = values(list(frames.iter(f"{SHEET}row"))[1])
    assert list(map(float, world[1:7])) == [0.0] * 6
    assert ["points.validate_before", 8] in results_table(facts).rows


def values(row: ET.Element) -> list[str]:
    return [cell.findtext(f"{SHEET}v", "") for cell in row]


def _tree(book: zipfile.ZipFile, name: str) -> ET.Element:
    return ET.fromstring(book.read(f"xl/{name}"))


def test_everything_as_json(tmp_path: Path) -> None:
    facts = validated_run(tmp_path / "r").facts()
    whole = json.loads(json_bytes(facts))
    assert whole["result"] == facts.result
    assert whole["result"]["points"] == {"validate_before": 8, "validate_chosen": 8}
    assert whole["journal"] == facts.fingerprint
    assert whole["plan"]["operator"] == "A. Technician"
    assert [each["key"] for each in whole["points"]] == list(facts.log.points)
    assert whole["frames"]["world"]["matrix"][3] == [0.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize("words", [("export", "--csv"), ("report",)])
def test_what_is_written_of_an_unfinished_run_is_said_to_be_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    validated_run(tmp_path / "cut").left()
    validated_run(tmp_path / "over").ended()
    said = {}
    for run in ("cut", "over"):
        out = str(tmp_path / ("r.html" if words == ("report",) else "r.csv"))
        assert main([*words, run, "--runs", str(tmp_path), "-o", out]) == 0
        said[run] = "the run is running, engine gone, not finished" in capsys.readouterr().err
    assert said == {"cut": True, "over": False}
