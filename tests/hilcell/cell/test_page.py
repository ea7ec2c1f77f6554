"""The page on cell files is kept true by the structs that read them."""

from __future__ import annotations

import re
from pathlib import Path

import msgspec

from hilcell.cell import file, layout, robot, surroundings
from hilcell.cell import file as cell
from hilcell.cell.file import Iso9283Table, RoomTable
from hilcell.cell.settings import range_text
from hilcell.cell.tables import Frozen
from hilcell.cell.uncertainty import UncertaintyTable

PAGE = (Path(__file__).parents[3] / "docs" / "cell-file.md").read_text("utf-8")
SECTIONS: dict[str, type[msgspec.Struct]] = {
    "[rail]": cell.RailTable,
    "[robot]": robot.RobotTable,
    "[[robot.joint]]": cell.Joint,
    "[robot.envelope]": surroundings.EnvelopeTable,
    "[[robot.envelope.capsule]]": surroundings.CapsuleTable,
    "[tracker]": cell.TrackerTable,
    "A pose": cell.Pose,
    "[layout]": layout.Layout,
    "A nest": cell.Nest,
    "A length": layout.KnownLength,
    "[[station]]": cell.Station,
    "[grid]": cell.GridTable,
    "[base_frame]": cell.BaseFrameTable,
    "[survey]": cell.SurveyTable,
    "[sweeps]": cell.SweepsTable,
    "[validation]": cell.ValidationTable,
    "[plan]": cell.PlanTable,
    "[room]": RoomTable,
    "[touch]": cell.TouchTable,
    "[settle]": cell.SettleTable,
    "[[keep_out]]": cell.KeepOut,
    "[[tool]]": cell.ToolTable,
    "[uncertainty]": UncertaintyTable,
    "[certificate]": cell.CertificateTable,
    "[notify]": file.NotifyTable,
    "[recheck]": file.RecheckTable,
    "[iso9283]": Iso9283Table,
    "[targets]": file.TargetsTable,
    "[volumes]": cell.VolumesTable,
    "[campaign]": cell.CampaignTable,
    "[simulation]": cell.SimulationTable,
}


def default_of(field: msgspec.structs.FieldInfo) -> str:
    if field.required:
        return "required"
    if field.default is msgspec.NODEFAULT or field.default is None:
        return "none"
    return f"{field.default:g}" if isinstance(field.default, float) else f"{field.default!r}"


def limits_of(field: msgspec.structs.FieldInfo) -> str:
    """Return a range as the page writes it: ``0 .. 10``, ``> 0 .. 10``, ``±10``."""
    text = range_text(field.type).replace("1e+06", "1e6")
    if match := re.fullmatch(r">= -(\S+), <= \1", text):
        return f"±{match[1]}"
    if match := re.fullmatch(r"(>=|>) (\S+), <= (\S+)", text):
        return f"{match[2]} .. {match[3]}" if match[1] == ">=" else f"> {match[2]} .. {match[3]}"
    return text


def rows(section: str) -> dict[str, tuple[str, str]]:
    """Return default and range by key, as the page's section states them."""
    (text,) = re.findall(
        rf"^## {re.escape(section)}\n(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL
    )
    cells = [[c.strip() for c in line.split("|")[1:-1]] for line in text.splitlines()]
    return {row[0].strip("`"): (row[1], row[2]) for row in cells if row and row[0][:1] == "`"}


def test_every_key_stands_there_with_its_default_and_range() -> None:
    for section, table in SECTIONS.items():
        fields = msgspec.structs.fields(table)
        assert rows(section) == {f.name: (default_of(f), limits_of(f)) for f in fields}


def test_no_table_is_left_out() -> None:
    tables = {
        kind
        for kind in (vars(cell) | vars(layout) | vars(surroundings)).values()
        if isinstance(kind, type) and issubclass(kind, Frozen) and kind is not Frozen
    }
    assert tables == {*SECTIONS.values(), cell.Cell}


def test_the_required_keys_of_the_file_are_named() -> None:
    (required,) = re.findall(r"^## The whole file\n\n(.*)\n", PAGE, re.MULTILINE)
    fields = msgspec.structs.fields(cell.Cell)
    assert re.findall(r"`(\w+)`", required) == [each.name for each in fields if each.required]
