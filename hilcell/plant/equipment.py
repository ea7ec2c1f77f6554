"""Equipment over years: drifting robots, stations with rising errors, instruments, alarms.

A robot has a trend and steps of its errors, with the messages of its cell at the time. The model is
a straight line, one coefficient for the temperature if it varies, and steps. Steps are added in
rounds: in each, the best further step of every quantity has the p-value of an F test, times the
number of possible places (Bonferroni). Noise is estimated from the residuals, so no stated
uncertainty is needed.

Many quantities are tested at once, so in each round of steps, among all drifts and among all
stations, 1 % of those that are called significant are false on average (Benjamini-Hochberg). Where
nothing changes, each of the three has a false line in one of a hundred plants.

Vectors are reduced to their first principal component over all runs, which does not depend on the
order of the runs and so prefers no trend or step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import combinations, groupby
from operator import attrgetter, itemgetter
from statistics import NormalDist
from typing import Any, NamedTuple
from uuid import UUID

import msgspec
import numpy as np
from numpy.typing import NDArray
from sqlalchemy import (
    Connection,
    Double,
    LargeBinary,
    Text,
    and_,
    cast,
    extract,
    func,
    or_,
    select,
    type_coerce,
)

from hilcell.decoding import Json, decoded
from hilcell.identity import Identity
from hilcell.journal.index import RunRow
from hilcell.journal.log import changed_asset_kinds
from hilcell.model.verdicts import OTHERS, VALIDATION
from hilcell.plant.cells import CELL, UNREADABLE, Doubt, left_out, selected, uses
from hilcell.plant.record import TRACKER
from hilcell.plant.tables import (
    ALARM,
    DEVICE,
    FARTHEST_MM,
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
BoolArray = NDArray[np.bool_]
ARM, BASE = "errors at the grid, in {B}", "base {B} in {W}"
SIGNIFICANCE = 0.01  # the share of false ones among those that are shown
CONFIDENCE = 0.95
FEWEST = 6  # runs
MOST_STEPS = 5  # of one quantity

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


class Series(NamedTuple):
    """Values (N,) of a quantity at times (N,) in years, with temperatures (N,) if known."""

    years: Array
    values: Array
    temperatures_c: Array | None = None


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


def fit_trends(every: Sequence[Series]) -> list[Trend | None]:
    """Return the trend of each of several quantities that are judged together, or None for one
    without: see `why_no_trend`.
    """
    models = [None if why_no_trend(each.years, each.values) else _Model(each) for each in every]
    running = [each for each in models if each is not None]
    for _ in range(MOST_STEPS):
        found = [(model, *step) for model in running if (step := model.next_step()) is not None]
        accepted = discoveries(np.array([p for _, _, p in found]))
        running = [model for (model, _, _), holds in zip(found, accepted, strict=True) if holds]
        for (model, at, _), holds in zip(found, accepted, strict=True):
            if holds:
                model.add(at)
    fits = [None if model is None else model.fit() for model in models]
    drifts = iter(discoveries(np.array([fit.p for fit in fits if fit is not None])))
    return [
        None
        if model is None or fit is None
        else Trend(fit.slope, fit.U, bool(next(drifts)), fit.noise, fit.steps)
        for model, fit in zip(models, fits, strict=True)
    ]


def discoveries(p_values: Array) -> BoolArray:
    """Return which of the p-values (N,) are significant, so that 1 % of these are false on average.

    Benjamini and Hochberg 1995. It is the adjustment of `scipy.stats.false_discovery_control`,
    whose import takes half a second.
    """
    ordered = np.sort(p_values)
    allowed = SIGNIFICANCE * np.arange(1, len(ordered) + 1) / len(ordered)
    held = np.flatnonzero(ordered <= allowed)
    limit = ordered[held[-1]] if len(held) else -1.0
    significant: BoolArray = p_values <= limit
    return significant


def main_direction(vectors: Array) -> Array:
    """Return the first principal component (N,) of vectors (N, D), rising from first to last."""
    from scipy.linalg import eigh

    centred = vectors - vectors.mean(axis=0)
    count, size = centred.shape
    squares = centred.T @ centred if size <= count else centred @ centred.T
    values, directions = eigh(squares, subset_by_index=[len(squares) - 1] * 2, driver="evr")
    if size <= count:
        along: Array = centred @ directions[:, 0]
    else:
        along = directions[:, 0] * math.sqrt(max(float(values[0]), 0.0))
    return along if along[-1] >= along[0] else -along


@dataclass(frozen=True, slots=True)
class _Fit:
    """Slope of a model with U and p-value, noise, and steps with U."""

    slope: float
    U: float
    p: float
    noise: float
    steps: list[Step]


class _Model:
    """A line, the effect of temperature, and steps, fitted to one quantity by least squares."""

    def __init__(self, of: Series) -> None:
        self.values = of.values
        self.base = [np.ones(len(of.values)), of.years - of.years.mean()]
        least_span_k = 1.0  # a smaller range does not identify a temperature coefficient
        celsius = of.temperatures_c
        if celsius is not None and float(np.ptp(celsius)) >= least_span_k:
            self.base.append(celsius - celsius.mean())
        self.steps: list[int] = []

    def add(self, at: int) -> None:
        self.steps.append(at)

    def next_step(self) -> tuple[int, float] | None:
        """Return the place of the best further step with its p-value, or None if none is possible.

        A step at each place is orthogonal to the present model once its part within that is taken
        away; its gain is then the square of its projection. All places are so tried at once: sums
        from each place to the end are cumulative sums.
        """
        from scipy import special

        within, _, _ = self._decomposed()
        degrees = len(self.values) - within.shape[1] - 1
        least_degrees = 3  # of freedom that remain for the noise
        if degrees < least_degrees:
            return None
        residuals = self.values - within @ (within.T @ self.values)
        from_end = np.cumsum(np.column_stack([residuals, within])[::-1], axis=0)[::-1]
        lengths = np.arange(len(residuals), 0.0, -1.0)
        squares = lengths - np.sum(from_end[:, 1:] ** 2, axis=1)
        possible = squares > 1e-9 * lengths  # not within the present model
        gains = np.where(possible, from_end[:, 0] ** 2 / np.where(possible, squares, 1.0), 0.0)
        at = int(np.argmax(gains))
        gain, rest = float(gains[at]), float(residuals @ residuals)
        if not gain > 0.0:
            return None
        ratio = gain * degrees / max(rest - gain, np.finfo(float).tiny)
        places = len(residuals) - 1 - len(self.steps)
        return at, min(float(special.fdtrc(1, degrees, ratio)) * places, 1.0)

    def fit(self) -> _Fit:
        from scipy import special

        within, scaled, singular = self._decomposed()
        parameters = scaled @ ((within.T @ self.values) / singular)
        residuals = self.values - within @ (within.T @ self.values)
        degrees = len(residuals) - len(singular)
        rest = float(residuals @ residuals)
        u = np.sqrt(np.sum((scaled / singular) ** 2, axis=1) * rest / max(degrees, 1))
        U = float(special.stdtrit(degrees, 0.5 + CONFIDENCE / 2)) * u
        steps = [
            Step(at, float(parameters[n]), float(U[n]), len(residuals) - at)
            for n, at in enumerate(self.steps, start=len(self.base))
        ]
        slope = float(parameters[1])
        t = abs(slope) / max(float(u[1]), np.finfo(float).tiny)
        return _Fit(
            slope, float(U[1]), 2.0 * float(special.stdtr(degrees, -t)),
            math.sqrt(rest / degrees), sorted(steps, key=lambda step: step.at),
        )  # fmt: skip

    def _decomposed(self) -> tuple[Array, Array, Array]:
        """Return the singular value decomposition of the design: left vectors (N, R), right (P, R)
        and values (R,), of its rank R.
        """
        places = np.arange(len(self.values))
        levels = ((places >= at).astype(float) for at in self.steps)
        design = np.column_stack([*self.base, *levels])
        left, singular, right = np.linalg.svd(design, full_matrices=False)
        held = singular > singular[0] * len(design) * np.finfo(float).eps
        return left[:, held], right[held].T, singular[held]


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


class _Calibration(NamedTuple):
    """A calibration of a robot, without its vectors."""

    digest: UUID
    name: str
    ended: datetime


class _Robot(NamedTuple):
    """The calibrations of one robot in one cell with its newest grid, and their quantities."""

    place: tuple[str, str, str, str]
    calibrations: list[_Calibration]
    left_out: int
    quantities: dict[str, Series]


def robots(
    connection: Connection, robot: str = "", cell: str = "", doubts: list[Doubt] | None = None
) -> list[RobotTrend]:
    """Return the trend of all calibrated robots, or of one by its serial number.

    Add the runs left out to ``doubts``.
    """
    doubts = [] if doubts is None else doubts
    place = (RUN.c.robot, *CELL)
    query = (
        select(
            *place, RUN.c.digest, RUN.c.name, RUN.c.ended, GRID.c.layout, GRID.c.temperature_c,
            *(type_coerce(GRID.c[name], LargeBinary) for name in ("errors_mm", "base_mm")),
        )
        .join(GRID, GRID.c.digest == RUN.c.digest)
        .where(RUN.c.newest, RUN.c.robot != "", *selected(cell, robot))
        .order_by(RUN.c.robot, RUN.c.cell_key, RUN.c.ended)
    )  # fmt: skip
    rows = connection.execute(query, execution_options={"yield_per": 1000})  # 2 kB each and more
    every = [
        found
        for place, own in groupby(rows, itemgetter(0, 1, 2, 3))
        if (found := _robot(place, list(own), doubts)) is not None
    ]
    every.sort(key=attrgetter("place"))
    trends = iter(fit_trends([each for robot in every for each in robot.quantities.values()]))
    return [
        _Robots(connection, doubts).trend(each, {what: next(trends) for what in each.quantities})
        for each in every
    ]


def _robot(
    place: tuple[str, str, str, str], rows: Sequence[Row], doubts: list[Doubt]
) -> _Robot | None:
    """Return a robot's calibrations, or None if none can be read."""
    if not rows:
        return None
    newest = rows[-1]
    alike = [
        row
        for row in rows
        if row.layout == newest.layout and len(row.errors_mm) == len(newest.errors_mm)
    ]
    try:
        measured_mm = _measured(alike)
    except UNREADABLE:  # of one of them
        bad = [row for row in alike if not _is_readable(row, doubts)]
        return _robot(place, [row for row in rows if row not in bad], doubts)
    digests, names, ends, _, air_c, _, _ = zip(*(row[4:] for row in alike), strict=True)
    years = np.array([each.timestamp() for each in ends]) / YEAR_S
    celsius = np.array(air_c, dtype=float)  # None becomes NaN
    known_c = celsius if np.isfinite(celsius).all() else None
    quantities = {}
    for what, vectors in zip((ARM, BASE), measured_mm, strict=True):
        along_mm = main_direction(vectors) / math.sqrt(vectors.shape[1] / 3)  # rms of its points
        quantities[what] = Series(years, along_mm, known_c)
    calibrations = list(map(_Calibration, digests, names, ends))
    return _Robot(place, calibrations, len(rows) - len(alike), quantities)


def _measured(rows: Sequence[Row]) -> tuple[Array, Array]:
    """Return the errors (N, 3 M) in {B} and the points of the bases (N, 9) in {W} of calibrations,
    mm. Raises one of `UNREADABLE`.
    """
    errors_mm = np.frombuffer(b"".join(row.errors_mm for row in rows), dtype="<f8")
    bases_mm = np.frombuffer(b"".join(row.base_mm for row in rows), dtype="<f8")
    for what, values in (("errors", errors_mm), ("base", bases_mm)):
        if not (np.abs(values) <= FARTHEST_MM).all():
            raise ValueError(f"expected numbers of at most {FARTHEST_MM:g} mm in its {what}")
    return errors_mm.reshape(len(rows), -1), bases_mm.reshape(len(rows), 9)


def _is_readable(row: Row, doubts: list[Doubt]) -> bool:
    before = len(doubts)
    with left_out(row, doubts):
        _measured([row])
    return len(doubts) == before


@dataclass(frozen=True, eq=False)
class _Robots:
    connection: Connection
    doubts: list[Doubt]

    def trend(self, of: _Robot, trends: dict[str, Trend | None]) -> RobotTrend:
        robot, cell, serial, machine = of.place
        alike = of.calibrations
        found = [(what, trend) for what, trend in trends.items() if trend is not None]
        return RobotTrend(
            robot=robot, cell=cell, serial=serial, machine=machine,
            calibrations=len(alike), first=alike[0].ended, last=alike[-1].ended,
            left_out=of.left_out,
            drift=[
                Drift(
                    what=what, mm_per_year=trend.slope, U_mm_per_year=trend.U,
                    drifts=trend.drifts, noise_mm=trend.noise,
                )
                for what, trend in found
            ],
            not_judged={
                what: why_no_trend(each.years, each.values)
                for what, each in of.quantities.items()
                if trends[what] is None
            },
            changes=[
                self._change(what, alike, step) for what, trend in found for step in trend.steps
            ],
        )  # fmt: skip

    def _change(self, what: str, rows: Sequence[_Calibration], step: Step) -> Change:
        first, second = rows[step.at - 1], rows[step.at]
        return Change(
            what=what, after=first.name, before=second.name,
            since=first.ended, until=second.ended,
            size_mm=step.size, U_mm=step.U, confirmed=min(step.at, step.after) > 1,
            said=self._messages(first, second),
        )  # fmt: skip

    def _messages(self, first: _Calibration, second: _Calibration) -> list[str]:
        own = RUN.alias("own")
        of_run = select(own.c.cell_key).where(own.c.digest == first.digest)
        aborted = and_(RUN.c.digest == first.digest, RUN.c.state != "finished")  # after its grid
        between = and_(
            RUN.c.cell_key == of_run.scalar_subquery(),
            RUN.c.ended >= first.ended,
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
            select(RUN.c.cell, RUN.c.name, cast(OUTCOME.c.row, Text).label("row"))
            .join(RUN, RUN.c.digest == OUTCOME.c.digest)
            .where(between)
            .order_by(RUN.c.ended)
        )
        for row in self.connection.execute(runs):
            with left_out(row, self.doubts):
                if decoded(row.row, RunRow).facts.recheck == "redo":
                    messages.append(f"re-check: calibrate again ({row.name})")
        alarms = (
            select(ALARM.c.code, ALARM.c.title, RUN.c.name)
            .join(RUN, RUN.c.digest == ALARM.c.digest)
            .where(between, ALARM.c.severity.in_(("warning", "fault")))
            .order_by(ALARM.c.t)
        )
        found = self.connection.execute(alarms)
        messages += [f"{row.code} {row.title} ({row.name})" for row in found]
        return list(dict.fromkeys(messages))

    def _devices(self, run: _Calibration) -> dict[str, Identity]:
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
        select(
            *CELL, VERDICT.c.key, cast(extract("epoch", RUN.c.ended), Double).label("t"),
            VERDICT.c.mean_mm, VERDICT.c.mean_tolerance_mm,
        )
        .join(VERDICT, VERDICT.c.digest == RUN.c.digest)
        .where(RUN.c.newest, VERDICT.c.key.startswith(VALIDATION), VERDICT.c.mean_mm.is_not(None))
        .where(VERDICT.c.key != f"{VALIDATION}{OTHERS}", *selected(cell, robot))
    )  # fmt: skip
    columns: Sequence[Sequence[Any]] = list(zip(*connection.execute(query).all(), strict=True))
    if not columns:
        return []
    places = list(zip(*columns[:4], strict=True))
    numbers = {place: n for n, place in enumerate(sorted({*places}))}
    number = np.array([numbers[place] for place in places])
    rows = np.array(columns[4:], dtype=float).T  # a tolerance that is missing becomes NaN
    order = np.lexsort((rows[:, 0], number))
    every = np.split(rows[order], np.flatnonzero(np.diff(number[order])) + 1)
    stations = [
        (place, own) for place, own in zip(numbers, every, strict=True) if len(own) >= FEWEST
    ]
    risen = discoveries(_p_of_rise([own[:, 1] for _, own in stations]))
    return [
        _station_trend(place, own)
        for (place, own), rises in zip(stations, risen, strict=True)
        if rises
    ]


def _p_of_rise(series: Sequence[Array]) -> Array:
    """Return for each of S series the p-value (S,) that its values do not rise: Mann and Kendall,
    corrected for ties and continuity.
    """
    from scipy import special

    longest = max(map(len, series), default=0)
    values = np.full((len(series), longest), np.nan)  # no NaN is more or less than another value
    for n, each in enumerate(series):
        values[n, : len(each)] = each
    concordant = np.zeros(len(series))
    for at in range(longest - 1):
        later, now = values[:, at + 1 :], values[:, at, None]
        concordant += np.sum(later > now, axis=1) - np.sum(later < now, axis=1)
    stds = np.array([_kendall_std(each) for each in series])
    p_values: Array = special.ndtr(-np.maximum(concordant - 1.0, 0.0) / stds)
    return p_values


def _kendall_std(values: Array) -> float:
    """Return the standard deviation of Kendall's S of values (N,) without a trend."""
    ties = np.unique(values, return_counts=True)[1].astype(float)
    count = float(len(values))
    pairs = count * (count - 1.0) * (2.0 * count + 5.0)
    tied = float(np.sum(ties * (ties - 1.0) * (2.0 * ties + 5.0)))
    return math.sqrt(max((pairs - tied) / 18.0, np.finfo(float).tiny))


def _station_trend(place: tuple[str, ...], rows: Array) -> StationTrend:
    """Return the trend of a station from times (s), means and tolerances (N, 3)."""
    from scipy import stats  # half a second to import, and rarely needed

    years, means_mm = rows[:, 0] / YEAR_S, rows[:, 1]
    slope, intercept, low, high = map(float, stats.theilslopes(means_mm, years, CONFIDENCE))
    now_mm = intercept + slope * float(years[-1])
    tolerance_mm = None if math.isnan(rows[-1, 2]) else float(rows[-1, 2])
    left_mm = None if tolerance_mm is None else tolerance_mm - now_mm
    cell, serial, machine, key = place
    return StationTrend(
        cell=cell, serial=serial, machine=machine, station=key.removeprefix(VALIDATION),
        calibrations=len(rows), mean_mm=now_mm, tolerance_mm=tolerance_mm, mm_per_year=slope,
        low_mm_per_year=low, high_mm_per_year=high,
        out_in_years=left_mm / slope if left_mm is not None and left_mm > 0 and slope > 0 else None,
    )  # fmt: skip


def instruments(connection: Connection, cell: str = "", robot: str = "") -> list[Instrument]:
    """Return all devices with a serial number, trackers with their scale errors.

    ``cell`` and ``robot`` select devices that were used with them; each row counts all its runs.
    """
    found = uses()
    query = (
        select(
            DEVICE, found.c.cell, found.c.robot, found.c.runs,
            found.c.begun.label("first"), found.c.ended.label("last"),
        )
        .join(DEVICE, DEVICE.c.digest == found.c.digest)
        .where(DEVICE.c.serial != "")
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
    if serial not in scales:
        return {}
    pairs = math.comb(len(scales), 2)
    k = -NormalDist().inv_cdf((1 - CONFIDENCE) / 2 / pairs) if pairs else math.inf

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
