"""Equipment over years: drifting robots, stations with rising errors, instruments, alarms.

A robot has a trend and steps of its errors, with the messages of its cell at the time. The model is
a straight line, one coefficient for the temperature if it varies, and steps. Steps are added one by
one, the best first, while an F test at 1 %, divided by the number of possible places (Bonferroni),
rejects the model without it. Noise is estimated from the residuals, so no stated uncertainty is
needed.

Vectors are reduced to their first principal component over all runs, which does not depend on the
order of the runs and so prefers no trend or step.
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
from hilcell.plant.cells import CELL, selected
from hilcell.plant.record import TRACKER
from hilcell.plant.tables import (
    ALARM,
    DEVICE,
    FRAME,
    GRID,
    LENGTH,
    OUTCOME,
    RUN,
    VERDICT,
    Row,
    grouped,
)  # fmt: skip
from hilcell.ports import Array

YEAR_S = 365.25 * 86400.0
ARM, BASE = "errors at the grid, in {B}", "base {B} in {W}"
SIGNIFICANCE = 0.01
CONFIDENCE = 0.95
FEWEST = 6  # runs

# -- the trend of a measured quantity --------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Step:
    """A step before observation ``at``, with U; ``after`` counts the observations after it."""

    at: int
    size: float
    U: float
    after: int


@dataclass(frozen=True, slots=True)
class Trend:
    """Slope per year with U, whether it is significant, noise, and steps."""

    slope: float
    U: float
    drifts: bool
    noise: float
    steps: list[Step]


def why_no_trend(years: Array, values: Array) -> str:
    """Return why values (N,) at times (N,) in years have no trend, or ""."""
    if len(values) < FEWEST:
        return f"expected at least {FEWEST} calibrations, got {len(values)}"
    if not float(np.ptp(years)) > 0.0:
        return "all calibrations ended at the same time"
    least_range = 1e-9
    if not float(np.ptp(values)) > least_range:  # rounding only
        return "all calibrations gave the same values"
    return ""


def fit_trend(years: Array, values: Array, temperatures_c: Array | None = None) -> Trend | None:
    """Return the trend of values (N,) at times (N,) in years, or None: see `why_no_trend`."""
    from scipy import stats  # half a second to import, and rarely needed

    if why_no_trend(years, values):
        return None
    count = len(values)
    base = [np.ones(count), years - years.mean()]
    least_span_k = 1.0  # a smaller range does not identify a temperature coefficient
    if temperatures_c is not None and float(np.ptp(temperatures_c)) >= least_span_k:
        base.append(temperatures_c - temperatures_c.mean())
    steps: list[int] = []
    while len(steps) < 5 and (at := _next(base, steps, values)) is not None:
        steps.append(at)
    fitted = _Fit.of(base, steps, values)
    factor = float(stats.t.ppf(0.5 + CONFIDENCE / 2, fitted.degrees))
    U = factor * np.sqrt(np.diag(fitted.covariance))
    by_place = sorted(
        (
            Step(at, float(fitted.values[n]), float(U[n]), count - at)
            for n, at in enumerate(steps, start=len(base))
        ),
        key=lambda step: step.at,
    )
    slope, slope_U = float(fitted.values[1]), float(U[1])
    limit = float(stats.t.ppf(1 - SIGNIFICANCE / 2, fitted.degrees)) / factor
    noise = float(np.sqrt(fitted.rest / fitted.degrees))
    return Trend(slope, slope_U, abs(slope) > limit * slope_U, noise, by_place)


def main_direction(vectors: Array) -> Array:
    """Return the first principal component (N,) of vectors (N, D), rising from first to last."""
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
        """Fit values (N,) by least squares to columns (N,), and to a level from each step on."""
        places = np.arange(len(base[0]))
        design = np.column_stack([*base, *((places >= at).astype(float) for at in steps)])
        solved = np.linalg.lstsq(design, values, rcond=None)
        parameters: Array = np.asarray(solved[0], dtype=float)
        rank = solved[2]
        rest, degrees = float(np.sum((values - design @ parameters) ** 2)), len(values) - int(rank)
        covariance: Array = np.linalg.pinv(design.T @ design) * rest / max(degrees, 1)
        return cls(parameters, covariance, rest, degrees)


def _next(base: list[Array], steps: list[int], values: Array) -> int | None:
    """Return the place of the best further step, if it is significant."""
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
    """A step between two runs, its size (mm) with U, and the cell's messages between them.

    ``confirmed``: by more than one run.
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
    """One robot in one cell. ``not_judged``: why a quantity has no trend."""

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
    """Return the trend of all calibrated robots, or of one by its serial number."""
    base = FRAME.alias("base")
    query = (
        select(
            *CELL, RUN.c.digest, RUN.c.robot, RUN.c.name, RUN.c.ended,
            GRID.c.places_mm, GRID.c.errors_mm, GRID.c.temperature_c, base.c.matrix,
        )
        .join(GRID, GRID.c.digest == RUN.c.digest)
        .join(base, and_(base.c.digest == RUN.c.digest, base.c.key == "base"))
        .where(RUN.c.newest, RUN.c.robot != "", *selected(cell, robot))
        .order_by(RUN.c.ended)
    )  # fmt: skip
    by_robot = grouped(connection, query, "robot", "cell", "serial", "machine")
    return [_Robots(connection).trend(rows) for _, rows in sorted(by_robot.items())]


@dataclass(frozen=True, eq=False)
class _Robots:
    connection: Connection

    def trend(self, rows: Sequence[Row]) -> RobotTrend:
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
        arm_mm = 1000.0  # two points of {B}, this far along its x and y, show its rotation
        points_mm = [origins_mm, *(origins_mm + arm_mm * frames[:, :3, axis] for axis in (0, 1))]
        for what, vectors in ((ARM, errors_mm), (BASE, np.concatenate(points_mm, axis=1))):
            along_mm = main_direction(vectors) / np.sqrt(vectors.shape[1] / 3)  # rms of its points
            trend = fit_trend(years, along_mm, celsius)
            if trend is not None:
                drift.append(Drift(
                    what=what, mm_per_year=trend.slope, U_mm_per_year=trend.U, drifts=trend.drifts,
                    noise_mm=trend.noise,
                ))  # fmt: skip
                changes += [self._change(what, alike, step) for step in trend.steps]
            else:
                not_judged[what] = why_no_trend(years, along_mm)
        return RobotTrend(
            robot=newest.robot, cell=newest.cell, serial=newest.serial, machine=newest.machine,
            calibrations=len(alike), first=alike[0].ended, last=alike[-1].ended,
            left_out=len(rows) - len(alike), drift=drift,
            not_judged=not_judged, changes=changes,
        )  # fmt: skip

    def _change(self, what: str, rows: Sequence[Row], step: Step) -> Change:
        first, second = rows[step.at - 1], rows[step.at]
        return Change(
            what=what, after=first.name, before=second.name,
            since=first.ended, until=second.ended,
            size_mm=step.size, U_mm=step.U, confirmed=min(step.at, step.after) > 1,
            said=self._messages(first, second),
        )  # fmt: skip

    def _messages(self, first: Row, second: Row) -> list[str]:
        aborted = and_(RUN.c.digest == first.digest, RUN.c.state != "finished")  # after its grid
        between = and_(
            *(column == getattr(first, column.name) for column in CELL),
            or_(RUN.c.ended > first.ended, aborted),
            RUN.c.ended <= second.ended,
            RUN.c.newest,
        )
        before, now = self._devices(first), self._devices(second)
        messages = [
            f"{kind} {before[kind].serial} {before[kind].firmware} -> "
            f"{now[kind].serial} {now[kind].firmware}"
            for kind in changed_asset_kinds(before, now)
            if kind in before and kind in now
        ]
        runs = (
            select(OUTCOME.c.row)
            .join(RUN, RUN.c.digest == OUTCOME.c.digest)
            .where(between)
            .order_by(RUN.c.ended)
        )
        for row in self.connection.execute(runs):
            run = typed(row.row, RunRow)
            if run.facts.recheck == "redo":
                messages.append(f"re-check: calibrate again ({run.name})")
        alarms = (
            select(ALARM.c.code, ALARM.c.title, RUN.c.name)
            .join(RUN, RUN.c.digest == ALARM.c.digest)
            .where(between, ALARM.c.severity.in_(("warning", "fault")))
            .order_by(ALARM.c.t)
        )
        found = self.connection.execute(alarms)
        messages += [f"{row.code} {row.title} ({row.name})" for row in found]
        return list(dict.fromkeys(messages))

    def _devices(self, run: Row) -> dict[str, Identity]:
        query = select(DEVICE).where(DEVICE.c.digest == run.digest)
        names = [name for name in Identity.__struct_fields__ if name in DEVICE.c]
        return {
            row.kind: Identity(**{name: getattr(row, name) for name in names})
            for row in self.connection.execute(query)
        }


class StationTrend(msgspec.Struct, frozen=True, kw_only=True):
    """A station whose mean error after correction grows: Kendall's test, Theil-Sen's slope.

    ``low`` and ``high`` bound the slope with 95 %; ``out_in_years``: when the mean would exceed the
    tolerance at that slope, None if it already does.
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
    """A device by its serial number, in all its cells.

    ``scale_ppm``: scale error of a tracker from certified lengths, with standard uncertainty u;
    ``disagrees_with``: trackers that agree with each other but not with this one.
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
    """Number of runs whose last session had an alarm."""

    code: str
    title: str
    severity: str
    count: int
    cells: list[str]
    last: datetime


def worse_stations(connection: Connection, cell: str = "", robot: str = "") -> list[StationTrend]:
    """Return the stations whose error after correction rises from calibration to calibration."""
    query = (
        select(*CELL, RUN.c.ended, VERDICT.c.key, VERDICT.c.mean_mm, VERDICT.c.mean_tolerance_mm)
        .join(VERDICT, VERDICT.c.digest == RUN.c.digest)
        .where(RUN.c.newest, VERDICT.c.key.startswith(VALIDATION), VERDICT.c.mean_mm.is_not(None))
        .where(*selected(cell, robot))
        .order_by(RUN.c.ended)
    )
    by_station = grouped(connection, query, "cell", "serial", "machine", "key")
    stations = {
        (*cell, station): rows
        for (*cell, key), rows in by_station.items()
        if (station := key.removeprefix(VALIDATION)) != OTHERS and len(rows) >= FEWEST
    }
    trends = (
        _station_trend(place, rows, len(stations)) for place, rows in sorted(stations.items())
    )
    return [each for each in trends if each is not None]


def _station_trend(place: tuple[str, ...], rows: Sequence[Row], count: int) -> StationTrend | None:
    """Return the trend of one of ``count`` stations, or None if it is not significant."""
    from scipy import stats  # half a second to import, and rarely needed

    years = np.array([row.ended.timestamp() for row in rows]) / YEAR_S
    means_mm = np.array([row.mean_mm for row in rows])
    p = stats.kendalltau(years, means_mm, alternative="greater").pvalue
    if not p * count < SIGNIFICANCE:
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
    """Return all devices with a serial number, trackers with their scale errors.

    ``cell`` and ``robot`` select devices that were used with them; each row counts all its runs.
    """
    names = (DEVICE.c.kind, DEVICE.c.maker, DEVICE.c.model, DEVICE.c.serial)
    query = (
        select(
            *names, DEVICE.c.firmware, RUN.c.cell, RUN.c.robot, func.count().label("runs"),
            func.min(RUN.c.begun).label("first"), func.max(RUN.c.ended).label("last"),
        )
        .join(RUN, RUN.c.digest == DEVICE.c.digest)
        .where(DEVICE.c.serial != "", RUN.c.newest)
        .group_by(*names, DEVICE.c.firmware, RUN.c.cell, RUN.c.robot)
    )  # fmt: skip
    devices = grouped(connection, query, "kind", "serial", "maker", "model")
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
        for (kind, serial, maker, model), rows in sorted(devices.items())
        if any(cell in ("", row.cell) and robot in ("", row.robot) for row in rows)
    ]  # fmt: skip


def _scales(connection: Connection) -> dict[str, tuple[float, float]]:
    """Return scale error and u (ppm) of each tracker that measured certified lengths.

    u combines the standard deviation of the mean and U / 2 of the lengths, which does not average.
    """
    off_ppm = (LENGTH.c.found_mm - LENGTH.c.wanted_mm) / LENGTH.c.wanted_mm * 1e6
    query = (
        select(
            RUN.c.tracker,
            func.count().label("times"),
            func.avg(off_ppm).label("mean"),
            func.avg(off_ppm * off_ppm).label("square"),
            func.avg(LENGTH.c.U_mm / LENGTH.c.wanted_mm * 5e5).label("stated"),
        )
        .join(RUN, RUN.c.digest == LENGTH.c.digest)
        .where(RUN.c.tracker != "", RUN.c.newest)
        .group_by(RUN.c.tracker)
    )
    return {
        row.tracker: (
            row.mean,
            math.hypot(math.sqrt(max(row.square - row.mean**2, 0.0) / row.times), row.stated),
        )
        for row in connection.execute(query)
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
    """Return the alarms by code, the most frequent first."""
    query = (
        select(
            ALARM.c.code, ALARM.c.title, ALARM.c.severity, RUN.c.cell,
            func.count().label("times"), func.max(ALARM.c.t).label("last"),
        )
        .join(RUN, RUN.c.digest == ALARM.c.digest)
        .where(RUN.c.newest, *selected(cell, robot))
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
            connection, query, "code", "title", "severity"
        ).items()
    ]  # fmt: skip
    return sorted(counted, key=lambda each: (-each.count, each.code))
