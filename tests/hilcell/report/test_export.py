"""Exports: every column, units in the headers, nothing that a spreadsheet would run."""

import csv
import io
import json
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import pytest

from hilcell.journal.point_id import PointId
from hilcell.report.export import (
    POINT_HEADERS,
    csv_bytes,
    frames_table,
    json_bytes,
    results_table,
    xlsx_bytes,
)
from tests.hilcell.report.journals import Writer, validated_run

SHEET = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"


def test_points_as_csv(tmp_path: Path) -> None:
    rows = list(
        csv.DictReader(io.StringIO(csv_bytes(validated_run(tmp_path / "r").facts()).decode()))
    )
    assert list(rows[0]) == [*POINT_HEADERS, "simulated"]
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


def test_workbook(tmp_path: Path) -> None:
    facts = validated_run(tmp_path / "r").facts()
    content = xlsx_bytes(facts)
    assert content == xlsx_bytes(facts)
    with zipfile.ZipFile(io.BytesIO(content)) as book:
        names = [each.get("name") for each in _tree(book, "workbook.xml").iter(f"{SHEET}sheet")]
        words = ["".join(each.itertext()) for each in _tree(book, "sharedStrings.xml")]
        cells = list(_tree(book, "worksheets/sheet2.xml").iter(f"{SHEET}row"))
    assert names == ["run", "points", "frames", "results"]
    assert set(POINT_HEADERS) <= set(words)
    assert len(cells) == 1 + 16
    first = {cell.get("r"): cell for cell in cells[1]}
    value = first["I2"].find(f"{SHEET}v")
    assert POINT_HEADERS[8] == "x_mm"
    assert value is not None
    assert float(value.text or "nan") == 1.0


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


def test_frames_and_results_are_flat(tmp_path: Path) -> None:
    facts = validated_run(tmp_path / "r").facts()
    assert frames_table(facts)[0][:7] == ["world", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert ["points.validate_before", 8] in results_table(facts)
