"""Drift of robots over years: trend and steps of their errors, and what the cells said then."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import msgspec
import numpy as np
from sqlalchemy import Connection, and_, or_, select

from hilcell.journal.index import RunRow
from hilcell.journal.log import other_assets
from hilcell.model.events import Asset
from hilcell.plant.cells import CELL, Name, chosen, newest
from hilcell.plant.course import Course, course, hindrance, main_direction
from hilcell.plant.tables import ALARM, DEVICE, FRAME, GRID, RUN, Found
from hilcell.ports import Array
from hilcell.typed import typed

YEAR_S = 365.25 * 86400.0
ARM, BASE = "errors at the grid, in {B}", "base {B} in {W}"


class Change(msgspec.Struct, frozen=True, kw_only=True):
    """A step between two runs, its size (mm) and U, and what the cell said from one to the other.

    ``confirmed`` says that more than one run has seen it.
    """

    what: str
    after: str
    before: str
    since: datetime
    until: datetime
    size_mm: float
    U_mm: float
    confirmed: bool
    said: list[str]


class Drift(msgspec.Struct, frozen=True, kw_only=True):
    """The drift of one quantity, mm a year with U; ``noise_mm`` from one run to the next."""

    what: str
    mm_per_year: float
    U_mm_per_year: float
    drifts: bool
    noise_mm: float


class RobotCourse(msgspec.Struct, frozen=True, kw_only=True):
    """One robot in one cell. ``not_judged`` says by quantity why no drift of it is stated."""

    robot: str
    cell: str
    serial: str
    machine: str
    calibrations: int
    first: datetime
    last: datetime
    left_out: int
    drift: list[Drift]
    not_judged: dict[str, str]
    changes: list[Change]


def robots(connection: Connection, robot: str = "", cell: str = "") -> list[RobotCourse]:
    """Return the course of every robot that was calibrated, or of one by its serial number."""
    base = FRAME.alias("base")
    asked = (
        select(
            *CELL, RUN.c.digest, RUN.c.robot, RUN.c.name, RUN.c.ended,
            GRID.c.places_mm, GRID.c.errors_mm, GRID.c.temperature_c, base.c.matrix,
        )
        .join(GRID, GRID.c.digest == RUN.c.digest)
        .join(base, and_(base.c.digest == RUN.c.digest, base.c.key == "base"))
        .where(newest(), RUN.c.robot != "", *chosen(cell, robot))
        .order_by(RUN.c.ended)
    )  # fmt: skip
    found: defaultdict[tuple[str, Name], list[Found]] = defaultdict(list)
    for row in connection.execute(asked):
        found[row.robot, (row.cell, row.serial, row.machine)].append(row)
    return [_Robots(connection).robot(who, cell, found[who, cell]) for who, cell in sorted(found)]


@dataclass(frozen=True, eq=False)
class _Robots:
    """Robots, as the plant's database knows them."""

    connection: Connection

    def robot(self, robot: str, cell: Name, rows: Sequence[Found]) -> RobotCourse:
        alike = [row for row in rows if row.places_mm == rows[-1].places_mm]  # of the newest grid
        years = np.array([row.ended.timestamp() for row in alike]) / YEAR_S
        air_c = [row.temperature_c for row in alike]
        celsius = None if None in air_c else np.array(air_c, dtype=float)
        errors_mm = np.array([row.errors_mm for row in alike], dtype=float).reshape(len(alike), -1)
        drift: list[Drift] = []
        not_judged: dict[str, str] = {}
        changes: list[Change] = []
        frames: Array = np.array([row.matrix for row in alike], dtype=float)
        origins_mm = frames[:, :3, 3]
        arm_mm = 1000.0  # two points of {B}, this far along its x and y, show how it turns
        points_mm = [origins_mm, *(origins_mm + arm_mm * frames[:, :3, axis] for axis in (0, 1))]
        for what, vectors in ((ARM, errors_mm), (BASE, np.concatenate(points_mm, axis=1))):
            along_mm = main_direction(vectors) / np.sqrt(vectors.shape[1] / 3)  # rms of its points
            seen = course(years, along_mm, celsius)
            if seen is not None:
                drift.append(Drift(
                    what=what, mm_per_year=seen.slope, U_mm_per_year=seen.U, drifts=seen.drifts,
                    noise_mm=seen.noise,
                ))  # fmt: skip
                changes += self._changes(cell, what, alike, seen)
            else:
                not_judged[what] = hindrance(years, along_mm)
        return RobotCourse(
            robot=robot, cell=cell[0], serial=cell[1], machine=cell[2],
            calibrations=len(alike), first=alike[0].ended, last=alike[-1].ended,
            left_out=len(rows) - len(alike), drift=drift,
            not_judged=not_judged, changes=changes,
        )  # fmt: skip

    def _changes(self, cell: Name, what: str, rows: Sequence[Found], seen: Course) -> list[Change]:
        return [
            Change(
                what=what,
                after=rows[step.at - 1].name,
                before=rows[step.at].name,
                since=rows[step.at - 1].ended,
                until=rows[step.at].ended,
                size_mm=step.size,
                U_mm=step.U,
                confirmed=min(step.at, step.after) > 1,
                said=self._said(cell, rows[step.at - 1], rows[step.at]),
            )
            for step in seen.steps
        ]

    def _said(self, cell: Name, first: Found, second: Found) -> list[str]:
        """Return the devices that changed, the alarms and the re-checks that failed, run by run."""
        broken_off = and_(RUN.c.digest == first.digest, RUN.c.state != "finished")  # after its grid
        then = and_(
            *(column == name for column, name in zip(CELL, cell, strict=True)),
            or_(RUN.c.ended > first.ended, broken_off),
            RUN.c.ended <= second.ended,
            newest(),
        )
        before = self._devices(first)
        now = self._devices(second)
        in_both = before.keys() & now.keys()
        found = [
            f"{kind} {before[kind].serial} {before[kind].firmware} -> "
            f"{now[kind].serial} {now[kind].firmware}"
            for kind in other_assets(before, now)
            if kind in in_both
        ]
        for row in self.connection.execute(select(RUN.c.row).where(then).order_by(RUN.c.ended)):
            run = typed(row.row, RunRow)
            if run.facts.recheck == "redo":
                found.append(f"re-check: calibrate again ({run.name})")
        severe = ("warning", "fault")
        alarms = (
            select(ALARM.c.code, ALARM.c.title, RUN.c.name)
            .join(RUN, RUN.c.digest == ALARM.c.digest)
            .where(then, ALARM.c.severity.in_(severe))
            .order_by(ALARM.c.t)
        )
        found += [f"{row.code} {row.title} ({row.name})" for row in self.connection.execute(alarms)]
        return list(dict.fromkeys(found))

    def _devices(self, run: Found) -> dict[str, Asset]:
        asked = select(DEVICE).where(DEVICE.c.digest == run.digest)
        rows = self.connection.execute(asked).mappings()
        return {
            row["kind"]: Asset(
                **{name: row[name] for name in Asset.__struct_fields__ if name in row}
            )
            for row in rows
        }
