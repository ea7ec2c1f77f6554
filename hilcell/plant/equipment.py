"""The equipment over years: robots that drift, stations that get worse, instruments, alarms.

Of a robot it has trend and steps of its errors, and what its cell said when they came. The model
is a straight line, one coefficient for the temperature where it is known to vary, and steps. A step
is taken in where an F test at 1 %, divided by the number of places at which it could have been
(Bonferroni), rejects the model without it; the best one first, again and again. Noise is estimated
from what the model leaves, so no stated uncertainty is trusted.

Of many coordinates one is judged: the direction in which they differ most over all runs (the first
principal component). It does not depend on the order of the runs, so it prefers no trend or step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import combinations
from typing import Self

import msgspec
import numpy as np
from sqlalchemy import Connection, and_, func, or_, select

from hilcell.decoding import Json, typed
from hilcell.identity import Identity
from hilcell.journal.index import RunRow
from hilcell.journal.log import changed_asset_kinds
from hilcell.model.verdicts import OTHERS, VALIDATION
from hilcell.plant.cells import CELL, chosen, newest
from hilcell.plant.record import TRACKER
from hilcell.plant.tables import ALARM, DEVICE, FRAME, GRID, LENGTH, RUN, VERDICT, Found, grouped
from hilcell.ports import Array

YEAR_S = 365.25 * 86400.0
ARM, BASE = "errors at the grid, in {B}", "base {B} in {W}"
SIGNIFICANCE = 0.01
CONFIDENCE = 0.95
FEWEST = 6  # runs

# -- the course of a measured quantity -------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Step:
    """A step before observation ``at``, with its expanded uncertainty; ``after`` are later ones."""

    at: int
    size: float
    U: float
    after: int


@dataclass(frozen=True, slots=True)
class Course:
    """The trend a year with its expanded uncertainty, whether it is one, the steps, the noise."""

    slope: float
    U: float
    drifts: bool
    noise: float
    steps: list[Step]


def hindrance(years: Array, values: Array) -> str:
    """Return why calibrations with values (N,) at times (N,) in years have no course, or ""."""
    if len(values) < FEWEST:
        return f"{len(values)} of the {FEWEST} calibrations that are needed"
    if not float(np.ptp(years)) > 0.0:
        return "all calibrations ended at the same time"
    least_range = 1e-9
    if not float(np.ptp(values)) > least_range:  # a test would judge their rounding
        return "all calibrations found the same"
    return ""


def course(years: Array, values: Array, temperatures_c: Array | None = None) -> Course | None:
    """Return the course of values (N,) at times (N,) in years; None where `hindrance` says why."""
    from scipy import stats  # it takes half a second to import, and most questions need none

    if hindrance(years, values):
        return None
    count = len(values)
    base = [np.ones(count), years - years.mean()]
    least_span_k = 1.0  # less says nothing of how a quantity follows the temperature
    if temperatures_c is not None and float(np.ptp(temperatures_c)) >= least_span_k:
        base.append(temperatures_c - temperatures_c.mean())
    steps: list[int] = []
    while len(steps) < 5 and (at := _next(base, steps, values)) is not None:
        steps.append(at)
    fitted = _Fit.of(base, steps, values)
    factor = float(stats.t.ppf(0.5 + CONFIDENCE / 2, fitted.degrees))
    U = factor * np.sqrt(np.diag(fitted.covariance))
    found = [
        Step(at, float(fitted.values[n]), float(U[n]), count - at)
        for n, at in enumerate(steps, start=len(base))
    ]
    slope, slope_U = float(fitted.values[1]), float(U[1])
    sure = float(stats.t.ppf(1 - SIGNIFICANCE / 2, fitted.degrees)) / factor
    noise = float(np.sqrt(fitted.rest / fitted.degrees))
    steps_found = sorted(found, key=lambda step: step.at)
    return Course(slope, slope_U, abs(slope) > sure * slope_U, noise, steps_found)


def main_direction(vectors: Array) -> Array:
    """Return the coordinate (N,) of vectors (N, D) along the direction in which they differ most.

    It grows from the first to the last.
    """
    centred = vectors - vectors.mean(axis=0)
    along: Array = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    return along if along[-1] >= along[0] else -along


@dataclass(frozen=True, slots=True)
class _Fit:
    values: Array
    covariance: Array
    rest: float
    degrees: int

    @classmethod
    def of(cls, base: list[Array], steps: list[int], values: Array) -> Self:
        """Return the least squares of values (N,) on columns (N,), and a level from each step."""
        places = np.arange(len(base[0]))
        design = np.column_stack([*base, *((places >= at).astype(float) for at in steps)])
        solved = np.linalg.lstsq(design, values, rcond=None)
        found: Array = np.asarray(solved[0], dtype=float)
        rank = solved[2]
        rest, degrees = float(np.sum((values - design @ found) ** 2)), len(values) - int(rank)
        covariance: Array = np.linalg.pinv(design.T @ design) * rest / max(degrees, 1)
        return cls(found, covariance, rest, degrees)


def _next(base: list[Array], steps: list[int], values: Array) -> int | None:
    """Return where the best further step is, if it is one."""
    from scipy import stats

    without = _Fit.of(base, steps, values)
    degrees = without.degrees - 1
    places = [at for at in range(1, len(values)) if at not in steps]
    least_degrees = 3  # of freedom that remain for the noise
    if degrees < least_degrees or not places:
        return None
    rests = [_Fit.of(base, [*steps, at], values).rest for at in places]
    best = int(np.argmin(rests))
    gain = without.rest - rests[best]
    if not gain > 0.0:
        return None
    ratio = gain * degrees / max(rests[best], np.finfo(float).tiny)
    return places[best] if stats.f.sf(ratio, 1, degrees) * len(places) < SIGNIFICANCE else None


# -- robots ----------------------------------------------------------------------------------------


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


class RobotTrend(msgspec.Struct, frozen=True, kw_only=True):
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


def robots(connection: Connection, robot: str = "", cell: str = "") -> list[RobotTrend]:
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
    by_robot = grouped(connection, asked, "robot", "cell", "serial", "machine")
    return [_Robots(connection).robot(rows) for _, rows in sorted(by_robot.items())]


@dataclass(frozen=True, eq=False)
class _Robots:
    """Robots, as the plant's database knows them."""

    connection: Connection

    def robot(self, rows: Sequence[Found]) -> RobotTrend:
        newest = rows[-1]
        alike = [row for row in rows if row.places_mm == newest.places_mm]  # of the newest grid
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
                changes += [self._change(what, alike, step) for step in seen.steps]
            else:
                not_judged[what] = hindrance(years, along_mm)
        return RobotTrend(
            robot=newest.robot, cell=newest.cell, serial=newest.serial, machine=newest.machine,
            calibrations=len(alike), first=alike[0].ended, last=alike[-1].ended,
            left_out=len(rows) - len(alike), drift=drift,
            not_judged=not_judged, changes=changes,
        )  # fmt: skip

    def _change(self, what: str, rows: Sequence[Found], step: Step) -> Change:
        first, second = rows[step.at - 1], rows[step.at]
        return Change(
            what=what, after=first.name, before=second.name,
            since=first.ended, until=second.ended,
            size_mm=step.size, U_mm=step.U, confirmed=min(step.at, step.after) > 1,
            said=self._said(first, second),
        )  # fmt: skip

    def _said(self, first: Found, second: Found) -> list[str]:
        """Return the devices that changed, the alarms and the re-checks that failed, run by run."""
        broken_off = and_(RUN.c.digest == first.digest, RUN.c.state != "finished")  # after its grid
        then = and_(
            *(column == getattr(first, column.name) for column in CELL),
            or_(RUN.c.ended > first.ended, broken_off),
            RUN.c.ended <= second.ended,
            newest(),
        )
        before, now = self._devices(first), self._devices(second)
        found = [
            f"{kind} {before[kind].serial} {before[kind].firmware} -> "
            f"{now[kind].serial} {now[kind].firmware}"
            for kind in changed_asset_kinds(before, now)
            if kind in before and kind in now
        ]
        for row in self.connection.execute(select(RUN.c.row).where(then).order_by(RUN.c.ended)):
            run = typed(row.row, RunRow)
            if run.facts.recheck == "redo":
                found.append(f"re-check: calibrate again ({run.name})")
        alarms = (
            select(ALARM.c.code, ALARM.c.title, RUN.c.name)
            .join(RUN, RUN.c.digest == ALARM.c.digest)
            .where(then, ALARM.c.severity.in_(("warning", "fault")))
            .order_by(ALARM.c.t)
        )
        found += [f"{row.code} {row.title} ({row.name})" for row in self.connection.execute(alarms)]
        return list(dict.fromkeys(found))

    def _devices(self, run: Found) -> dict[str, Identity]:
        asked = select(DEVICE).where(DEVICE.c.digest == run.digest)
        names = [name for name in Identity.__struct_fields__ if name in DEVICE.c]
        return {
            row.kind: Identity(**{name: getattr(row, name) for name in names})
            for row in self.connection.execute(asked)
        }


class StationTrend(msgspec.Struct, frozen=True, kw_only=True):
    """A station whose mean error after correction grows: Kendall's test, Theil-Sen's slope.

    ``low`` and ``high`` bound the slope with 95 %; ``out_in_years`` is when its mean would leave
    the tolerance at that slope, None where it is out already.
    """

    cell: str
    serial: str
    machine: str
    station: str
    calibrations: int
    mean_mm: float
    tolerance_mm: float | None
    mm_per_year: float
    low_mm_per_year: float
    high_mm_per_year: float
    out_in_years: float | None


class Instrument(msgspec.Struct, frozen=True, kw_only=True):
    """A device by its serial number, in all cells that it was in.

    ``scale_ppm`` is what a tracker adds to certified lengths, with its standard uncertainty u;
    ``disagrees_with`` are trackers that agree with one another and not with it.
    """

    kind: str
    maker: str
    model: str
    serial: str
    firmware: list[str]
    cells: list[str]
    runs: int
    first: datetime
    last: datetime
    scale_ppm: float | None = None
    u_ppm: float | None = None
    disagrees_with: list[str] = []


class AlarmCount(msgspec.Struct, frozen=True, kw_only=True):
    """How often an alarm was in the last session of a run."""

    code: str
    title: str
    severity: str
    count: int
    cells: list[str]
    last: datetime


def worse_stations(connection: Connection, cell: str = "", robot: str = "") -> list[StationTrend]:
    """Return the stations whose error after correction grows from calibration to calibration."""
    asked = (
        select(*CELL, RUN.c.ended, VERDICT.c.key, VERDICT.c.mean_mm, VERDICT.c.mean_tolerance_mm)
        .join(VERDICT, VERDICT.c.digest == RUN.c.digest)
        .where(newest(), VERDICT.c.key.startswith(VALIDATION), VERDICT.c.mean_mm.is_not(None))
        .where(*chosen(cell, robot))
        .order_by(RUN.c.ended)
    )
    found = grouped(connection, asked, "cell", "serial", "machine", "key")
    judged = {
        (*cell, station): rows
        for (*cell, key), rows in found.items()
        if (station := key.removeprefix(VALIDATION)) != OTHERS and len(rows) >= FEWEST
    }
    courses = (_worse(place, rows, len(judged)) for place, rows in sorted(judged.items()))
    return [each for each in courses if each is not None]


def _worse(place: tuple[str, ...], rows: Sequence[Found], judged: int) -> StationTrend | None:
    from scipy import stats  # it takes half a second to import, and most questions need none

    years = np.array([row.ended.timestamp() for row in rows]) / YEAR_S
    means_mm = np.array([row.mean_mm for row in rows])
    grows = stats.kendalltau(years, means_mm, alternative="greater").pvalue
    if not grows * judged < SIGNIFICANCE:
        return None
    slope, intercept, low, high = map(float, stats.theilslopes(means_mm, years, CONFIDENCE))
    now_mm, tolerance_mm = intercept + slope * float(years[-1]), rows[-1].mean_tolerance_mm
    left_mm = None if tolerance_mm is None else tolerance_mm - now_mm
    cell, serial, machine, station = place
    return StationTrend(
        cell=cell, serial=serial, machine=machine, station=station, calibrations=len(rows),
        mean_mm=now_mm, tolerance_mm=tolerance_mm, mm_per_year=slope,
        low_mm_per_year=low, high_mm_per_year=high,
        out_in_years=left_mm / slope if left_mm is not None and left_mm > 0 and slope > 0 else None,
    )  # fmt: skip


def instruments(connection: Connection, cell: str = "", robot: str = "") -> list[Instrument]:
    """Return all devices with a serial number; trackers judged by lengths that are certified.

    ``cell`` and ``robot`` choose the devices that were with it; a row counts all cells and runs.
    """
    names = (DEVICE.c.kind, DEVICE.c.maker, DEVICE.c.model, DEVICE.c.serial)
    asked = (
        select(
            *names, DEVICE.c.firmware, RUN.c.cell, RUN.c.robot, func.count().label("runs"),
            func.min(RUN.c.begun).label("first"), func.max(RUN.c.ended).label("last"),
        )
        .join(RUN, RUN.c.digest == DEVICE.c.digest)
        .where(DEVICE.c.serial != "", newest())
        .group_by(*names, DEVICE.c.firmware, RUN.c.cell, RUN.c.robot)
    )  # fmt: skip
    found = grouped(connection, asked, "kind", "serial", "maker", "model")
    scales = _scales(connection)
    return [
        Instrument(
            kind=kind, maker=maker, model=model, serial=serial,
            firmware=sorted({row.firmware for row in rows}),
            cells=sorted({row.cell for row in rows}),
            runs=sum(row.runs for row in rows),
            first=min(row.first for row in rows),
            last=max(row.last for row in rows),
            **(_scale(serial, scales) if kind == TRACKER else {}),
        )
        for (kind, serial, maker, model), rows in sorted(found.items())
        if any(cell in ("", row.cell) and robot in ("", row.robot) for row in rows)
    ]  # fmt: skip


def _scales(connection: Connection) -> dict[str, tuple[float, float]]:
    """Return scale and u, ppm, of each tracker that has measured certified lengths.

    u has the scatter of its means and the half of the stated U, which does not average out.
    """
    off_ppm = (LENGTH.c.found_mm - LENGTH.c.wanted_mm) / LENGTH.c.wanted_mm * 1e6
    asked = (
        select(
            RUN.c.tracker,
            func.count().label("times"),
            func.avg(off_ppm).label("mean"),
            func.avg(off_ppm * off_ppm).label("square"),
            func.avg(LENGTH.c.U_mm / LENGTH.c.wanted_mm * 5e5).label("stated"),
        )
        .join(RUN, RUN.c.digest == LENGTH.c.digest)
        .where(RUN.c.tracker != "", newest())
        .group_by(RUN.c.tracker)
    )
    return {
        row.tracker: (
            row.mean,
            math.hypot(math.sqrt(max(row.square - row.mean**2, 0.0) / row.times), row.stated),
        )
        for row in connection.execute(asked)
    }


def _scale(serial: str, scales: dict[str, tuple[float, float]]) -> Json:
    from scipy.stats import norm

    if serial not in scales:
        return {}
    pairs = math.comb(len(scales), 2)
    k = float(norm.isf((1 - CONFIDENCE) / 2 / pairs)) if pairs else math.inf

    def differ(one: str, other: str) -> bool:
        (a_ppm, u_a), (b_ppm, u_b) = scales[one], scales[other]
        return abs(a_ppm - b_ppm) > k * math.hypot(u_a, u_b)

    against = [other for other in sorted(scales) if other != serial and differ(serial, other)]
    agree = {name for pair in combinations(against, 2) if not differ(*pair) for name in pair}
    scale_ppm, u_ppm = scales[serial]
    return {"scale_ppm": scale_ppm, "u_ppm": u_ppm, "disagrees_with": sorted(agree)}


def alarms(connection: Connection, cell: str = "", robot: str = "") -> list[AlarmCount]:
    """Return the alarms by kind, the most frequent first."""
    asked = (
        select(
            ALARM.c.code, ALARM.c.title, ALARM.c.severity, RUN.c.cell,
            func.count().label("times"), func.max(ALARM.c.t).label("last"),
        )
        .join(RUN, RUN.c.digest == ALARM.c.digest)
        .where(newest(), *chosen(cell, robot))
        .group_by(ALARM.c.code, ALARM.c.title, ALARM.c.severity, RUN.c.cell)
    )  # fmt: skip
    counted = [
        AlarmCount(
            code=code, title=title, severity=severity,
            count=sum(row.times for row in rows),
            cells=sorted({row.cell for row in rows}),
            last=max(row.last for row in rows),
        )
        for (code, title, severity), rows in grouped(
            connection, asked, "code", "title", "severity"
        ).items()
    ]  # fmt: skip
    return sorted(counted, key=lambda each: (-each.count, each.code))
