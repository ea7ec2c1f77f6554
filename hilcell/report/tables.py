"""The tables of a report: words and rounded figures, every column with its unit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hilcell.calibration.errors import OTHERS, Errors, places, reduction, validation
from hilcell.geometry.frames import zyx_from_pose
from hilcell.report.budget import Budget
from hilcell.report.facts import Facts
from hilcell.report.figures import series_name
from hilcell.report.uncertainty import Contribution

CONDITIONS = (
    ("air temperature", "temperature_c", "°C", 2),
    ("air pressure", "pressure_mbar", "mbar", 1),
    ("relative humidity", "humidity_percent", "%", 1),
)


@dataclass(frozen=True, slots=True)
class Sheet:
    """One table: the first ``words`` columns are text, the others figures."""

    title: str
    headers: list[str]
    rows: list[list[str]]
    words: int = 1
    note: str = ""


def accuracy(facts: Facts) -> Sheet | None:
    """Return the errors before and after per place, and both ratios of the paper's abstract."""
    rows: list[list[str]] = []
    for place, stations in places(facts.cell).items():
        series = validation(facts.log, stations)
        rows += [
            _accuracy_row(facts, place if number == 0 else "", series, how)
            for number, how in enumerate(series)
        ]
    if not rows:
        return None
    headers = ["station", "error", "targets", "mean mm", "p95 mm", "max mm",
               "removed by means %", "removed by maxima %"]  # fmt: skip
    floor = facts.result.get("repeatability", {}).get("floor_mm")
    rp_robot = facts.result.get("repeatability", {}).get("rp_robot_mm")
    note = "Removed: 1 − after / before. Every figure is of targets really sent and measured."
    if floor is not None:
        note += f" Repeatability and tracker noise alone would leave {floor:.4f} mm (mean)."
    if rp_robot is not None:
        note += f" RP of the robot (ISO 9283), tracker noise taken off: {rp_robot:.3f} mm."
    return Sheet("Before and after", headers, rows, 2, note)


def _accuracy_row(facts: Facts, place: str, series: Mapping[str, Errors], how: str) -> list[str]:
    errors, before = series[how], series.get("before")
    removed = ["", ""]
    if before is not None and how != "before":
        removed = [
            f"{100 * reduction(before.figures.mean, errors.figures.mean):.1f}",
            f"{100 * reduction(before.figures.max, errors.figures.max):.1f}",
        ]
    name = "others together" if place == OTHERS else place
    return [name, series_name(how, facts), str(len(errors)), *_mm(*errors.figures), *removed]


def stations(facts: Facts) -> Sheet | None:
    """Return what each station's frame is good for."""
    rows = [
        [
            station.name,
            f"{station.rail_mm:.2f}",
            f"{station.strip_mm:.2f}",
            f"{frame['strip_mm']:.2f}",
            *_mm(frame["rms_mm"], frame["tool_uncertainty_mm"]),
        ]
        for station in facts.cell.station
        for frame in (facts.log.frames.get(f"station.{station.name}"),)
        if frame is not None
    ]
    headers = [
        "station",
        "rail mm",
        "strip, wanted mm",
        "strip, found mm",
        "fit rms mm",
        "tool point u mm",
    ]
    note = "Tool point: the grid's centre as the station frame carries it, 3D, 1 σ."
    return Sheet("Stations", headers, rows, 1, note) if rows else None


def frames(facts: Facts) -> Sheet | None:
    """Return every measured frame as position and Z-Y-X angles in {W}."""
    rows = []
    for name, frame in facts.log.frames.items():
        x, y, z, a, b, c = zyx_from_pose(np.array(frame["matrix"], dtype=float))
        rows.append([name, f"{x:.4f}", f"{y:.4f}", f"{z:.4f}", f"{a:.5f}", f"{b:.5f}", f"{c:.5f}"])
    headers = ["frame", "x mm", "y mm", "z mm", "A °", "B °", "C °"]
    note = "In {W}; “world” is the tracker in {W}. Angles Z-Y-X."
    return Sheet("Frames", headers, rows, 1, note) if rows else None


def circles(facts: Facts) -> Sheet | None:
    """Return how round the circles of axes 1 and 6 were."""
    base = facts.log.frames.get("base", {})
    if "circle_rms_mm" not in base:
        return None
    pairs = zip(base["radius_mm"], base["circle_rms_mm"], strict=True)
    rows = [[f"axis {axis}", *_mm(*pair)] for axis, pair in zip((1, 6), pairs, strict=True)]
    return Sheet("Base frame: circles", ["circle", "radius mm", "residual rms mm"], rows)


def conditions(facts: Facts) -> Sheet | None:
    """Return the air at the tracker, smallest, largest and mean over all points."""
    points = list(facts.log.points.values())
    if not points:
        return None
    rows = []
    for name, field, unit, digits in CONDITIONS:
        values = np.array([getattr(point, field) for point in points])
        figures = (values.min(), values.max(), values.mean())
        rows.append([f"{name} {unit}", *(f"{each:.{digits}f}" for each in figures)])
    return Sheet("Air at the tracker", ["quantity", "least", "most", "mean"], rows)


def devices(facts: Facts) -> Sheet | None:
    """Return who answered."""
    rows = [
        [each["device"], each["model"], each["serial"], each["address"]] for each in facts.devices
    ]
    headers = ["device", "model", "serial", "address"]
    link = facts.log.link
    note = f"CAN link in the last session: {link.text}." if link is not None else ""
    if link is not None and link.warning:
        note += f" Warning: {link.warning}."
    return Sheet("Devices", headers, rows, 4, note) if rows else None


def software(facts: Facts) -> Sheet:
    """Return the versions that measured."""
    rows = [[name, version] for name, version in facts.inputs.versions.items()]
    return Sheet("Software that measured", ["package", "version"], rows, 2)


def groups(facts: Facts) -> Sheet | None:
    """Return how many points of each group were measured."""
    counts: dict[str, int] = {}
    for point in facts.log.points.values():
        counts[point.group] = counts.get(point.group, 0) + 1
    rows = [[name.replace("_", " "), str(count)] for name, count in sorted(counts.items())]
    return Sheet("Points", ["group", "points"], rows) if rows else None


def verdicts(facts: Facts) -> Sheet | None:
    """Return what was judged, with the figures it was judged by."""
    rows = [
        [name, "holds" if body["holds"] else "does not hold", _facts_of(body)]
        for name, body in facts.log.verdicts.items()
    ]
    return Sheet("Verdicts", ["judged", "verdict", "by"], rows, 3) if rows else None


def course(facts: Facts) -> Sheet:
    """Return how the run went: its states, and events on the way."""
    rows = []
    for record in facts.records:
        when, body = record.t[:19].replace("T", " "), record.body
        if record.kind == "state":
            what = f"{body['machine']}: {body['to'].replace('_', ' ')}"
            rows.append([when, what, str(body.get("reason", ""))])
        elif record.kind == "event" and body["what"] not in ("connected", "closed"):
            rows.append([when, body["what"], _facts_of(body)])
    return Sheet("Course of the run", ["UTC", "what", "why, how"], rows, 3)


def paper_rows(facts: Facts) -> Sheet | None:
    """Return the paper's figures beside this run's, where the procedure compares them."""
    found = facts.result.get("rows")
    if not isinstance(found, list):
        return None
    rows = [
        [
            row["row"],
            row["fails"],
            _figure(row["paper"]),
            _figure(row["here"]),
            row["unit"],
            row["criterion"],
            "set" if row["set"] else "holds" if row["holds"] else "does not hold",
        ]
        for row in found
    ]
    headers = ["figure of the paper", "fails when", "paper", "here", "unit", "holds if", "verdict"]
    note = "Set: brought about by the cell file or the simulated machine, so that it cannot fail."
    return Sheet("The paper, row by row", headers, rows, 2, note)


def own_table(facts: Facts) -> Sheet | None:
    """Return the procedure's own table of its result."""
    if facts.table is None:
        return None
    headers, rows = facts.table
    return Sheet(facts.procedure.summary.capitalize(), headers, rows)


def contributions(title: str, lines: Iterable[Contribution]) -> Sheet:
    """Return budget lines: estimate, distribution, standard uncertainty, source."""
    rows = [
        [
            line.name,
            f"{line.how}; {line.source}",
            line.distribution,
            line.clause,
            *_mm(line.estimate_mm, line.u_mm),
        ]
        for line in lines
    ]
    headers = ["contribution", "source", "distribution", "GUM", "estimate mm", "u mm"]
    return Sheet(title, headers, rows, 4)


def budget_sheets(budget: Budget) -> list[Sheet]:
    """Return the budget's tables, each with its sum."""
    sheets = [
        _summed(
            contributions("A measured position", budget.measurement),
            budget.measurement_u_mm,
            budget.measurement_U_mm,
        )
    ]
    if budget.target:
        sheet = contributions("A corrected target, besides", budget.target)
        sheets.append(_summed(sheet, budget.target_u_mm, budget.target_U_mm))
    return sheets


def _summed(sheet: Sheet, u_mm: float, expanded_mm: float) -> Sheet:
    sheet.rows.append(
        ["combined u", "root of the sum of all squares so far", "", "5.1.2", "", f"{u_mm:.4f}"]
    )
    sheet.rows.append(
        ["expanded U", "U = k u, k = 2, about 95 %", "normal", "6.2.1", "", f"{expanded_mm:.4f}"]
    )
    return sheet


def _mm(*values_mm: float) -> list[str]:
    return [f"{value:.4f}" for value in values_mm]


def _facts_of(body: Mapping[str, Any]) -> str:
    known = ("holds", "what")
    return ", ".join(
        _with_unit(name, value)
        for name, value in body.items()
        if name not in known and not isinstance(value, dict | list)
    )


def _with_unit(name: str, value: object) -> str:
    words = name.removesuffix("_mm").replace("_", " ")
    return f"{words} {_text(value)}{' mm' if name.endswith('_mm') else ''}"


def _figure(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4f}" if isinstance(value, float) else str(value)
