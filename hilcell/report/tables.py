"""The tables of a report: each column is defined once, and its unit stands in its header."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np

from hilcell.calibration.errors import OTHERS, Errors, places, reduction, validation
from hilcell.cell.file import Station
from hilcell.geometry.frames import zyx_from_pose
from hilcell.geometry.statistics import Figures
from hilcell.journal.asset import Asset
from hilcell.journal.point_words import counted_words
from hilcell.journal.ways_sent import Sent
from hilcell.ports import Array
from hilcell.present.table import Column, Table, Value
from hilcell.report.drawings.paper_figures import series_name
from hilcell.report.facts import Facts

Pair = tuple[str, str]

CONDITIONS = (
    ("air temperature", "temperature_c", "°C", 1),
    ("air pressure", "pressure_mbar", "mbar", 1),
    ("relative humidity", "humidity_percent", "%", 1),
)


@dataclass(frozen=True, slots=True)
class Validated:
    """Targets of one place sent in one way; ``before`` are the same without a correction."""

    place: str
    way: Sent
    how: str  # the way in words
    errors: Errors
    before: Errors | None

    def removed_percent(self, figure: str) -> float | None:
        """Return which share of a figure of the errors before was removed."""
        if self.before is None or self.before is self.errors:
            return None
        before, after = (getattr(each.figures, figure) for each in (self.before, self.errors))
        return 100 * reduction(before, after)


ACCURACY: tuple[Column[Validated], ...] = (
    Column("station", attrgetter("place")),
    Column("error", attrgetter("how")),
    Column("targets", lambda row: len(row.errors), form="d"),
    *(Column(name, attrgetter(f"errors.figures.{name}"), "mm", ".3f") for name in Figures._fields),
    Column("removed by means", lambda row: row.removed_percent("mean"), "%", ".1f"),
    Column("removed by maxima", lambda row: row.removed_percent("max"), "%", ".1f"),
)


def validated_rows(facts: Facts) -> list[Validated]:
    """Return each series of targets with its place."""
    return [
        Validated(
            "others together" if place == OTHERS else place,
            how,
            series_name(how, facts),
            errors,
            series.get(Sent.BEFORE),
        )
        for place, stations in places(facts.cell).items()
        for series in (validation(facts.log, stations),)
        for how, errors in series.items()
    ]


def accuracy(facts: Facts) -> Table:
    """Return the errors before and after per place, and both ratios of the paper's abstract."""
    rows, last = [], ""
    for row in validated_rows(facts):
        rows.append(replace(row, place="") if row.place == last else row)
        last = row.place
    floor = facts.result.get("repeatability", {}).get("floor_mm")
    rp_robot = facts.result.get("repeatability", {}).get("rp_robot_mm")
    note = "Removed: 1 − after / before. Every figure is of targets really sent and measured."
    if floor is not None:
        note += f" Repeatability and tracker noise alone would leave {floor:.3f} mm (mean)."
    if rp_robot is not None:
        note += f" RP of the robot (ISO 9283), tracker noise taken off: {rp_robot:.3f} mm."
    return Table(ACCURACY, rows, "Before and after", note)


# A station, and its frame's record.
STATIONS: tuple[Column[tuple[Station, Mapping[str, Any]]], ...] = (
    Column("station", lambda row: row[0].name),
    Column("rail", lambda row: row[0].rail_mm, "mm", ".3f"),
    Column("strip, wanted", lambda row: row[0].strip_mm, "mm", ".3f"),
    Column("strip, found", lambda row: row[1]["strip_mm"], "mm", ".3f"),
    Column("fit rms", lambda row: row[1]["rms_mm"], "mm", ".3f"),
    Column("tool point u", lambda row: row[1]["tool_uncertainty_mm"], "mm", ".4f"),
    Column("worst corner u", lambda row: row[1]["cube_uncertainty_mm"], "mm", ".4f"),
    Column("nests left out", lambda row: ", ".join(row[1].get("left_out", [])) or "none"),
)


def stations(facts: Facts) -> Table:
    """Return the quality of each station's frame that this run measured, of no adopted one."""
    if not facts.cell.has_rail:
        return Table((), ())
    found = ((each, facts.log.frames.get(f"station.{each.name}")) for each in facts.cell.station)
    rows = ((station, frame) for station, frame in found if frame and "strip_mm" in frame)
    note = (
        "Tool point: the grid's centre as the station frame carries it, 3D, 1 σ. Left out: nests "
    )
    note += "whose distances to the others changed since the grid's station."
    return Table(STATIONS, rows, "Stations", note)


# A station, and the record of the last visit on which its base was touched.
TOUCHES: tuple[Column[tuple[Station, Mapping[str, Any]]], ...] = (
    Column("station", lambda row: row[0].name),
    Column("poses", lambda row: row[1]["poses"], form="d"),
    Column("along the rail", lambda row: row[1]["along_rail_mm"], "mm", "+.4f"),
    Column("shift", lambda row: float(np.linalg.norm(row[1]["shift_mm"])), "mm", ".4f"),
    Column("turn", lambda row: float(np.linalg.norm(row[1]["turn_urad"])), "µrad", ".1f"),
    Column("u before", lambda row: row[1]["u_before_mm"], "mm", ".4f"),
    Column("u after", lambda row: row[1]["u_after_mm"], "mm", ".4f"),
    Column("found / expected", lambda row: row[1]["pull"], form=".1f"),
)


def touches(facts: Facts) -> Table:
    """Return what the touch poses found at each station."""
    found = ((each, facts.log.frames.get(f"touch.{each.name}")) for each in facts.cell.station)
    rows = ((station, frame) for station, frame in found if frame is not None)
    note = (
        "By how much the base was moved for the commands of that visit, at the grid's centre. "
        "u: tool point, 3D, 1 σ. Found / expected: the motion found, relative to what the "
        "uncertainty before lets expect. Targets stay where the station frame has them."
    )
    return Table(TOUCHES, rows, "Touch poses", note)


@dataclass(frozen=True, slots=True)
class Posed:
    """A measured frame: its name, its matrix (4, 4) in {W}, its x, y, z, A, B, C (6,)."""

    name: str
    matrix: Array
    zyx: Array


def _element(n: int) -> Callable[[Posed], Value]:
    return lambda row: float(row.zyx[n])


FRAMES: tuple[Column[Posed], ...] = (
    Column("frame", attrgetter("name")),
    *(Column(name, _element(n), "mm", ".3f") for n, name in enumerate("xyz")),
    *(Column(name, _element(n), "°", ".4f") for n, name in enumerate("ABC", start=3)),
)


def posed(facts: Facts) -> list[Posed]:
    """Return every measured frame."""
    matrices = {name: facts.log.matrix(name) for name in facts.log.frames}
    return [Posed(name, matrix, zyx_from_pose(matrix)) for name, matrix in matrices.items()]


def frames(facts: Facts) -> Table:
    """Return every measured frame as position and Z-Y-X angles in {W}."""
    note = "In {W}; “world” is the tracker in {W}. Angles Z-Y-X."
    named = Column[Posed]("frame", lambda row: row.name.replace("_", " ").replace(".", ", "))
    return Table((named, *FRAMES[1:]), posed(facts), "Frames", note)


CIRCLES: tuple[Column[tuple[str, float, float]], ...] = (
    Column("circle", itemgetter(0)),
    Column("radius", itemgetter(1), "mm", ".4f"),
    Column("residual rms", itemgetter(2), "mm", ".4f"),
)


def circles(facts: Facts) -> Table:
    """Return how round the circles of axes 1 and 6 were."""
    base = facts.log.frames.get("base", {})
    if "circle_rms_mm" not in base:
        return Table((), ())
    rows = zip(("axis 1", "axis 6"), base["radius_mm"], base["circle_rms_mm"], strict=True)
    return Table(CIRCLES, rows, "Base frame: circles")


@dataclass(frozen=True, slots=True)
class Condition:
    """One quantity of the air over all points (N,), shown with ``digits`` decimals."""

    name: str
    unit: str
    values: Array
    digits: int

    def shown(self, value: float) -> str:
        """Return a value of this quantity as text."""
        return f"{value:.{self.digits}f}"


AIR: tuple[Column[Condition], ...] = (
    Column("quantity", lambda row: f"{row.name} {row.unit}"),
    Column("least", lambda row: row.shown(row.values.min()), form="s"),
    Column("most", lambda row: row.shown(row.values.max()), form="s"),
    Column("mean", lambda row: row.shown(row.values.mean()), form="s"),
)


def air(facts: Facts) -> list[Condition]:
    """Return the air at the tracker over all points; nothing where not measured."""
    measured = [point.air for point in facts.log.points.values() if point.air]
    return [
        Condition(name, unit, np.array([getattr(each, field) for each in measured]), digits)
        for name, field, unit, digits in CONDITIONS
        if measured
    ]


def conditions(facts: Facts) -> Table:
    """Return the air at the tracker, smallest, largest and mean."""
    return Table(AIR, air(facts), "Air at the tracker")


DEVICES: tuple[Column[Asset], ...] = tuple(
    Column(name, attrgetter(name))
    for name in ("kind", "maker", "model", "serial", "firmware", "address")
)


def devices(facts: Facts) -> Table:
    """Return the devices that answered."""
    link = facts.log.link
    note = f"CAN link: {link.text}." if link is not None else ""
    if link is not None and link.warning:
        note += f" Warning: {link.warning}."
    return Table(DEVICES, facts.log.assets, "Devices", note)


SOFTWARE: tuple[Column[Pair], ...] = (
    Column("package", itemgetter(0)),
    Column("version", itemgetter(1)),
)
GROUPS: tuple[Column[tuple[str, int]], ...] = (
    Column("kind", itemgetter(0)),
    Column("points", itemgetter(1), form="d"),
)


def software(facts: Facts) -> Table:
    """Return the versions that measured."""
    return Table(SOFTWARE, facts.inputs.versions.items(), "Software that measured")


def groups(facts: Facts) -> Table:
    """Return how many points of each kind were measured, in the order of the run."""
    counts = Counter(counted_words(point.id) for point in facts.log.points.values())
    return Table(GROUPS, counts.items(), "Points")


PAPER: tuple[Column[Mapping[str, Any]], ...] = (
    Column("figure of the paper", itemgetter("row")),
    Column("fails when", itemgetter("fails")),
    Column("paper", itemgetter("paper"), form=".4g"),
    Column("here", itemgetter("here"), form=".4g"),
    Column("chosen", lambda row: row.get("chosen"), form=".4g"),
    Column("unit", itemgetter("unit")),
    Column("holds if", itemgetter("criterion")),
    Column(
        "verdict",
        lambda row: "set" if row["set"] else "holds" if row["holds"] else "does not hold",
    ),
)


def paper_rows(facts: Facts) -> Table:
    """Return the paper's figures beside this run's, where the procedure compares them."""
    found = facts.result.get("rows")
    note = "Set: brought about by the cell file or the simulated machine, so that it cannot fail."
    return Table(PAPER, found if isinstance(found, list) else [], "The paper, row by row", note)


def own_table(facts: Facts) -> Table:
    """Return the procedure's own table of its result."""
    found = facts.procedure.table(facts.result) if facts.result else Table((), ())
    found.title = facts.procedure.summary.capitalize()
    found.note = facts.procedure.words(facts.result) if facts.result else ""
    return found
