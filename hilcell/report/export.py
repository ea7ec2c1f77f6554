"""A run's points, frames and results for other programs, as CSV, XLSX or JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from datetime import datetime
from operator import attrgetter

import msgspec
import numpy as np

from hilcell.calibration.orientation import last_orientation_errors, seats_of
from hilcell.geometry.frames import apply, zyx_from_pose
from hilcell.journal.journal import Record
from hilcell.journal.log import Log, commanded_rad, positions_mm
from hilcell.model.point import Point
from hilcell.ports import Array
from hilcell.present.renderers import csv_content, xlsx_of
from hilcell.present.table import Column, Table, Value, listed, vector
from hilcell.report.budgets import target_budget
from hilcell.report.facts import Facts
from hilcell.report.tables import ACCURACY, FRAMES, Posed, Tables

COMPARED = "before and after"


@dataclass(frozen=True, slots=True)
class Measured:
    """A point and the record that wrote it, and as far as they are known: its place and its error
    e = actual - nominal (3,) in {W}, the robot's pose as x, y, z, A, B, C (6,) in {B}, the
    95 % bound of the error of a corrected target, by how much the tool was turned.
    """

    record: Record
    point: Point
    world_mm: Array | None
    error_mm: Array | None
    zyx: Array | None
    bound_mm: float | None
    turned_deg: float | None

    @property
    def settled_s(self) -> float | None:
        return None if self.point.readings is None else self.point.readings.settled_s

    @property
    def norm_mm(self) -> float | None:
        return None if self.error_mm is None else float(np.linalg.norm(self.error_mm))

    @property
    def inside(self) -> str | None:
        """Return whether the error keeps its bound, as yes or no."""
        if self.bound_mm is None or self.norm_mm is None:
            return None
        return _yes(self.norm_mm <= self.bound_mm)


def _plain(*names: str, unit: str = "") -> Iterator[Column[Measured]]:
    """Yield a column for each attribute of the point; its name ends in the unit, if it has one."""
    for name in names:
        yield Column(name, attrgetter(f"point.{name}_{unit}".rstrip("_")), unit)


def _age(name: str) -> Callable[[Measured], Value]:
    def value(row: Measured) -> Value:
        taken = getattr(row.point.readings, name, None)
        return None if taken is None else float(taken.age_s)

    return value


_AXES = [f"a{axis}" for axis in range(1, 7)]
POINTS: tuple[Column[Measured], ...] = (
    Column("seq", attrgetter("record.seq")),
    Column("t", attrgetter("record.t"), "utc"),
    *_plain("key", "group", "station", "session", "reflector", "frame"),
    *vector("", "xyz", "mm", "point.xyz_mm"),
    *vector("std_", "xyz", "mm", "point.std_mm"),
    *_plain("samples", "temperature_c", "pressure_mbar", "humidity_percent"),
    *_plain("rail", "strip", unit="mm"),
    *vector("world_", "xyz", "mm", "world_mm"),
    *vector("nominal_", "xyz", "mm", "point.nominal_mm"),
    *vector("error_", "xyz", "mm", "error_mm"),
    Column("error", attrgetter("norm_mm"), "mm"),
    Column("seat", attrgetter("point.id.seat")),
    *vector("nominal_", "abc", "°", "point.nominal_deg"),
    Column("orientation_error", attrgetter("turned_deg"), "°"),
    *vector("smr_", "xyz", "mm", "point.smr_mm"),
    *vector("commanded_", _AXES, "°", "point.commanded_deg"),
    *vector("read_", _AXES, "°", "point.joints_deg"),
    *vector("pose_", "xyz", "mm", "zyx"),
    *vector("pose_", "abc", "°", "zyx", first=3),
    *(Column(f"{name}_age", _age(name), "s") for name in ("tracker", "rail", "robot")),
    Column("settled", attrgetter("settled_s"), "s"),
    Column("bound95", attrgetter("bound_mm"), "mm"),
    Column("inside", attrgetter("inside")),
)


def points(facts: Facts) -> list[Measured]:
    wrote = {record.key: record for record in facts.records if record.kind == "point"}
    world = facts.log.matrix("world") if "world" in facts.log.frames else None
    bounds_mm = target_budget(facts.log, facts.run).points_mm
    turns_deg = _turns_deg(facts.log)
    rows = []
    for key, point in facts.log.points.items():
        record = wrote[key]
        world_mm = None if world is None else apply(world, np.array([point.xyz_mm]))[0]
        known = world_mm is not None and point.nominal_mm is not None
        error_mm = world_mm - np.array(point.nominal_mm) if known else None
        pose = record.body.get("pose")
        zyx = None if pose is None else zyx_from_pose(np.array(pose))
        figures = bounds_mm.get(key), turns_deg.get(key)
        rows.append(Measured(record, point, world_mm, error_mm, zyx, *figures))
    return rows


def _turns_deg(log: Log) -> dict[str, float]:
    seats = seats_of(log)
    if seats is None:
        return {}
    turned = last_orientation_errors(log, list(log.points.values()), seats)
    keys = (point.key for point in turned.points)
    return dict(zip(keys, turned.angles_deg.tolist(), strict=True))


def results_table(facts: Facts) -> Table:
    """Return the result as one row a figure; its path names the unit where it has one."""
    return Table(listed("figure", "value"), _leaves("", facts.result), "results")


def _leaves(path: str, value: object) -> Iterable[tuple[str, Value]]:
    if isinstance(value, dict):
        pairs: Iterable[tuple[object, object]] = value.items()
    elif isinstance(value, (list, tuple)):
        pairs = enumerate(value)
    else:
        yield path, value if isinstance(value, int | float | None) else str(value)
        return
    for name, each in pairs:
        yield from _leaves(f"{path}.{name}" if path else str(name), each)


def run_table(facts: Facts) -> Table:
    inputs = facts.inputs
    rows: list[tuple[str, Value]] = [
        ("run", facts.run),
        ("procedure", inputs.procedure),
        ("cell", inputs.cell["name"]),
        ("digest", inputs.digest),
        ("journal", facts.fingerprint),
        ("seed", inputs.seed),
        ("machine_seed", "" if inputs.machine_seed is None else inputs.machine_seed),
        ("simulated", _yes(inputs.simulated)),
        ("operator", inputs.operator),
        ("job", inputs.job),
        ("state", facts.log.state),
        ("began_utc", facts.records[0].t),
        ("ended_utc", facts.last.t),
    ]
    rows += [(f"version.{name}", version) for name, version in inputs.versions.items()]
    rows += [(f"device.{asset.device}", asset.text) for asset in facts.log.assets]
    for asset in facts.log.assets:
        for name in ("maker", "model", "serial", "firmware"):
            rows.append((f"asset.{asset.kind}.{name}", getattr(asset, name)))
    if facts.log.link is not None:
        rows.append(("link", facts.log.link.counts))
        if facts.log.link.warning:
            rows.append(("link_warning", facts.log.link.warning))
    return Table(listed("name", "value"), rows, "run")


def csv_bytes(facts: Facts) -> bytes:
    """Return the points as CSV in UTF-8."""
    simulated = Column[Measured]("simulated", lambda row: _yes(facts.inputs.simulated))
    return csv_content(Table((*POINTS, simulated), points(facts)))


def _yes(holds: bool) -> str:
    return "yes" if holds else "no"


def sheets(facts: Facts) -> list[Table]:
    """Return the tables run, points, frames, results and before and after, as titled."""
    compared = Table(ACCURACY, Tables(facts).validated_rows(), COMPARED)
    entries = (f"{row}{column}" for row in range(4) for column in range(4))
    columns: tuple[Column[Posed], ...] = (*FRAMES, *vector("m", entries, "", "matrix.flat"))
    frames = Table(columns, Tables(facts).posed(), "frames")
    measured = Table(POINTS, points(facts), "points")
    return [run_table(facts), measured, frames, results_table(facts), compared]


def xlsx_bytes(facts: Facts) -> bytes:
    """Return a workbook with `sheets`."""
    begun = datetime.fromisoformat(facts.records[0].t)
    return xlsx_of(sheets(facts), begun, {COMPARED: "before_after"})


def urdf_of_run(facts: Facts) -> bytes:
    """Return the arm as `hilcell fit` identifies it from the run's points; raises `HilcellError`.

    Its base is the robot's, its limits are the cell file's. It has link parameters alone: the
    calibration has more.
    """
    from hilcell.fit.measurements import Measurements  # all load long
    from hilcell.fit.methods import fit_robot
    from hilcell.fit.rigid_arm import alone, rigid_arm, urdf_bytes
    from hilcell.fit.robot_file import Robot

    log, robot = facts.log, facts.cell.robot
    kinds = ("grid", "oriented", "pose", "base")  # the circles alone turn the flange
    station = facts.cell.grid.station
    learnt = [each for kind in kinds for each in log.select(kind, station)]
    rows = Measurements.from_arrays(commanded_rad(learnt), positions_mm(learnt))
    nominal = Robot(
        robot.name,
        replace(robot.arm(), tool=np.eye(4)),
        limits_rad=np.radians([(each.min_deg, each.max_deg) for each in robot.joint]).T,
        speeds_rad_s=np.radians([each.speed_deg_s for each in robot.joint]),
    )
    fitted = rigid_arm(fit_robot(nominal, rows))
    remarks = [f"{len(rows)} poses of run {facts.run}.", *alone(fitted.figures)]
    return urdf_bytes(nominal, fitted, remarks)


def json_bytes(facts: Facts) -> bytes:
    """Return everything: inputs, states, points, frames, verdicts, events and the result."""
    log, table = facts.log, Table(POINTS, points(facts))
    keys, plan = table.keys, msgspec.to_builtins(log.inputs)
    del plan["order"]  # of the folder of runs, no fact of this one
    whole = {
        "run": facts.run,
        "journal": facts.fingerprint,
        "plan": plan,
        "states": log.states,
        "sessions": log.session,
        "fault": log.fault,
        "points": [dict(zip(keys, row, strict=True)) for row in table.rows],
        "frames": log.frames,
        "verdicts": {key: record.body for key, record in log.verdict_records.items()},
        "events": [record.event(facts.run) for record in log.events],
        "result": facts.result,
    }
    return msgspec.json.encode(whole) + b"\n"
