"""A run's points, frames and results for other programs: CSV, XLSX or JSON, units in the headers.

Spreadsheets run text that begins like a formula, so such text is quoted.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from datetime import datetime
from typing import Any

import msgspec
import numpy as np

from hilcell.clean import harmless
from hilcell.geometry.frames import apply, zyx_from_pose
from hilcell.journal.log import Point
from hilcell.report.facts import Facts

Value = str | int | float | None
Row = list[Value]

_XYZ = ("x_mm", "y_mm", "z_mm")
_JOINTS = [f"a{axis}_deg" for axis in range(1, 7)]
POINT_HEADERS = [
    "seq", "t_utc", "key", "group", "station", "session", "reflector", "frame",
    *_XYZ, *(f"std_{axis}" for axis in _XYZ), "samples",
    "temperature_c", "pressure_mbar", "humidity_percent", "rail_mm", "strip_mm",
    *(f"world_{axis}" for axis in _XYZ), *(f"nominal_{axis}" for axis in _XYZ),
    *(f"error_{axis}" for axis in _XYZ), "error_mm", *(f"smr_{axis}" for axis in _XYZ),
    *(f"commanded_{joint}" for joint in _JOINTS), *(f"read_{joint}" for joint in _JOINTS),
    *(f"pose_{axis}" for axis in _XYZ), "pose_a_deg", "pose_b_deg", "pose_c_deg",
]  # fmt: skip
FRAME_HEADERS = [
    "frame",
    *_XYZ,
    "a_deg",
    "b_deg",
    "c_deg",
    *(f"m{row}{column}" for row in range(4) for column in range(4)),
]


def points_table(facts: Facts) -> list[Row]:
    """Return every point, first measured first; ``world_*`` and ``error_*`` are in {W}."""
    wrote = {record.key: record for record in facts.records if record.kind == "point"}
    return [
        [wrote[key].seq, wrote[key].t, *_point_row(facts, point)]
        for key, point in facts.log.points.items()
    ]


def _point_row(facts: Facts, point: Point) -> Row:
    world_mm: Sequence[float] | None = None
    error_mm: Sequence[float] | None = None
    if "world" in facts.log.frames:
        world = apply(facts.log.matrix("world"), np.array([point.xyz_mm]))[0]
        world_mm = world.tolist()
        if point.nominal_mm is not None:
            error_mm = (world - np.array(point.nominal_mm)).tolist()
    pose = None if point.pose is None else zyx_from_pose(np.array(point.pose)).tolist()
    return [
        point.key, point.group, point.station, point.session, point.reflector, point.frame,
        *point.xyz_mm, *point.std_mm, point.samples,
        point.temperature_c, point.pressure_mbar, point.humidity_percent,
        point.rail_mm, point.strip_mm,
        *_or_blank(world_mm, 3), *_or_blank(point.nominal_mm, 3), *_or_blank(error_mm, 3),
        None if error_mm is None else float(np.linalg.norm(error_mm)),
        *_or_blank(point.smr_mm, 3), *_or_blank(point.commanded_deg, 6),
        *_or_blank(point.joints_deg, 6), *_or_blank(pose, 6),
    ]  # fmt: skip


def _or_blank(values: Sequence[float] | None, count: int) -> Sequence[float | None]:
    return [None] * count if values is None else values


def frames_table(facts: Facts) -> list[Row]:
    """Return every frame in {W}: position, Z-Y-X angles, and its matrix row by row."""
    rows: list[Row] = []
    for name, frame in facts.log.frames.items():
        matrix = np.array(frame["matrix"], dtype=float)
        rows.append([name, *zyx_from_pose(matrix).tolist(), *matrix.ravel().tolist()])
    return rows


def results_table(facts: Facts) -> list[Row]:
    """Return the result as one row a figure; its path names the unit where it has one."""
    return [[path, value] for path, value in _leaves("", facts.result)]


def _leaves(path: str, value: Any) -> Iterable[tuple[str, Value]]:
    if isinstance(value, dict):
        pairs: Iterable[tuple[object, Any]] = value.items()
    elif isinstance(value, list | tuple):
        pairs = enumerate(value)
    else:
        yield path, value if isinstance(value, int | float | None) else str(value)
        return
    for name, each in pairs:
        yield from _leaves(f"{path}.{name}" if path else str(name), each)


def run_table(facts: Facts) -> list[Row]:
    """Return what identifies the run."""
    inputs = facts.inputs
    rows: list[Row] = [
        ["run", facts.run],
        ["procedure", inputs.procedure],
        ["cell", inputs.cell["name"]],
        ["digest", inputs.digest],
        ["journal", facts.fingerprint],
        ["seed", inputs.seed],
        ["machine_seed", "" if inputs.truth_seed is None else inputs.truth_seed],
        ["simulated", _yes(inputs.simulated)],
        ["operator", inputs.operator],
        ["job", inputs.job],
        ["state", facts.log.states["run"]],
        ["began_utc", facts.records[0].t],
        ["ended_utc", facts.records[-1].t],
    ]
    rows += [[f"version.{name}", version] for name, version in inputs.versions.items()]
    for each in facts.devices:
        rows.append([f"device.{each['device']}", f"{each['model']}, serial {each['serial']}"])
    if facts.log.link is not None:
        rows.append(["link", facts.log.link.text])
        if facts.log.link.warning:
            rows.append(["link_warning", facts.log.link.warning])
    return rows


def csv_bytes(facts: Facts) -> bytes:
    """Return the points as CSV in UTF-8."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    simulated = _yes(facts.inputs.simulated)
    writer.writerow([*POINT_HEADERS, "simulated"])
    writer.writerows([*map(_quoted, row), simulated] for row in points_table(facts))
    return text.getvalue().encode()


def _yes(holds: bool) -> str:
    return "yes" if holds else "no"


def _quoted(value: Value) -> Value:
    if not isinstance(value, str):
        return value
    shown = harmless(value)
    return f"'{shown}" if shown.startswith(("=", "+", "-", "@")) else shown


def xlsx_bytes(facts: Facts) -> bytes:
    """Return a workbook with the sheets run, points, frames and results."""
    from xlsxwriter import Workbook

    file = io.BytesIO()
    with Workbook(file, {"in_memory": True, "nan_inf_to_errors": True}) as book:
        book.set_properties({"created": datetime.fromisoformat(facts.records[0].t)})
        bold = book.add_format({"bold": True})
        for name, headers, rows in (
            ("run", ["name", "value"], run_table(facts)),
            ("points", POINT_HEADERS, points_table(facts)),
            ("frames", FRAME_HEADERS, frames_table(facts)),
            ("results", ["figure", "value"], results_table(facts)),
        ):
            sheet = book.add_worksheet(name)
            sheet.freeze_panes(1, 0)
            sheet.set_column(0, len(headers) - 1, 16)
            _write_row(sheet, 0, list(headers), bold)
            for number, row in enumerate(rows, start=1):
                _write_row(sheet, number, row)
    return file.getvalue()


def _write_row(sheet: Any, number: int, row: Row, style: Any = None) -> None:
    for column, value in enumerate(row):
        if isinstance(value, str):
            sheet.write_string(number, column, harmless(value), style)
        elif isinstance(value, bool):
            sheet.write_boolean(number, column, value, style)
        elif value is not None:
            sheet.write_number(number, column, value, style)


def json_bytes(facts: Facts) -> bytes:
    """Return everything: inputs, states, points, frames, verdicts, events and the result."""
    log = facts.log
    whole = {
        "run": facts.run,
        "journal": facts.fingerprint,
        "plan": log.inputs,
        "states": log.states,
        "sessions": log.session,
        "fault": log.fault,
        "points": [dict(zip(POINT_HEADERS, row, strict=True)) for row in points_table(facts)],
        "frames": log.frames,
        "verdicts": log.verdicts,
        "events": [record.event(facts.run) for record in log.events],
        "result": facts.result,
    }
    return msgspec.json.encode(whole) + b"\n"
