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
from bisect import insort
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import combinations, groupby
from operator import attrgetter, itemgetter
from statistics import NormalDist
from typing import NamedTuple, Self
from uuid import UUID

import msgspec
import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, Text, and_, cast, func, or_, select

from hilcell.decoding import Json, decoded
from hilcell.geometry.kinematics import Array
from hilcell.geometry.statistics import slope
from hilcell.identity import Identity, changed_asset_kinds
from hilcell.journal.index import RunRow
from hilcell.model.verdicts import OTHERS, VALIDATION
from hilcell.plant.cells import CELL, Doubt, left_out, selected, uses
from hilcell.plant.tables import (
    ADJUSTMENT,
    ALARM,
    BATCH,
    DEVICE,
    FARTHEST_MM,
    GRID,
    LENGTH,
    OUTCOME,
    RUN,
    TRACKER,
    VERDICT,
    Row,
    grouped,
    joined,
)  # fmt: skip

DAY_S = 86400.0
YEAR_S = 365.25 * DAY_S
BoolArray = NDArray[np.bool_]
ARM, BASE = "errors at the grid, in {B}", "base {B} in {W}"
SIGNIFICANCE = 0.01  # the share of false ones among those that are shown
CONFIDENCE = 0.95
FEWEST = 6  # runs
LEAST_DAYS = 7.0  # of a slope: less, and the rhythm of a day or of warm devices passes for one
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
    """Return why values (N,) at times (N,) in years have neither steps nor a slope, or ""."""
    if len(values) < FEWEST:
        return f"expected at least {FEWEST} calibrations, got {len(values)}"
    if not float(np.ptp(years)) > 0.0:
        return "all calibrations ended at the same time"
    least_range = 1e-9
    if not float(np.ptp(values)) > least_range:  # rounding only
        return "all calibrations gave the same values"
    return ""


def why_no_slope(years: Array) -> str:
    """Return why runs at times (N,) in years tell no change a year, or "": too few, or within too
    short a time, which a step needs not.
    """
    if len(years) < FEWEST:
        return f"expected at least {FEWEST} runs, got {len(years)}"
    days = float(np.ptp(years)) * YEAR_S / DAY_S
    if not days >= LEAST_DAYS:
        return f"too short: expected runs over {LEAST_DAYS:g} days or more, got {days:.1f} days"
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
    p_values = [
        1.0 if why_no_slope(each.years) else fit.p
        for each, fit in zip(every, fits, strict=True)
        if fit is not None
    ]
    drifts = iter(discoveries(np.array(p_values)))
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
    last = [len(squares) - 1] * 2
    values, directions = eigh(squares, subset_by_index=last, driver="evr", check_finite=False)
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
        self._decompose()

    def add(self, at: int) -> None:
        self.steps.append(at)
        self._decompose()

    def next_step(self) -> tuple[int, float] | None:
        """Return the place of the best further step with its p-value, or None if none is possible.

        A step at each place is orthogonal to the present model once its part within that is taken
        away; its gain is then the square of its projection. All places are so tried at once: sums
        from each place to the end are cumulative sums.
        """
        from scipy import special

        within = self.within
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

        within, scaled, singular = self.within, self.scaled, self.singular
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

    def _decompose(self) -> None:
        """Compute the singular value decomposition of the design: left vectors (N, R), right (P, R)
        and values (R,), of its rank R.
        """
        places = np.arange(len(self.values))
        levels = ((places >= at).astype(float) for at in self.steps)
        design = np.column_stack([*self.base, *levels])
        left, singular, right = np.linalg.svd(design, full_matrices=False)
        held = singular > singular[0] * len(design) * np.finfo(float).eps
        self.within: Array = left[:, held]
        self.scaled: Array = right[held].T
        self.singular: Array = singular[held]


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


class _Grids(NamedTuple):
    """Grids of one layout of a robot, N, by their ends (s since 1970): UUID of the run, mean
    temperature or NaN, errors (N, 3 M) in {B} and points of the bases (N, 9) in {W}, mm.
    """

    digests: NDArray[np.void]
    ended_s: Array
    celsius: Array
    errors_mm: Array
    bases_mm: Array

    @classmethod
    def of(cls, row: Row) -> Self:
        digests, ended, celsius, errors, bases = row
        ended_s = np.frombuffer(ended, ">f8").astype(float)
        every = cls(
            np.frombuffer(digests, "V16"), ended_s, np.frombuffer(celsius, ">f8").astype(float),
            *(np.frombuffer(each, "<f8").reshape(len(ended_s), -1) for each in (errors, bases)),
        )  # fmt: skip
        return every.chosen(np.argsort(ended_s, kind="stable"))

    def chosen(self, which: NDArray[np.bool_ | np.int_]) -> Self:
        return type(self)(
            self.digests[which], self.ended_s[which], self.celsius[which],
            self.errors_mm[which], self.bases_mm[which],
        )  # fmt: skip

    def last_s(self) -> float:
        return float(self.ended_s[-1])

    @property
    def readable(self) -> BoolArray:
        """Which (N,) have numbers alone that are not too large to be averaged."""
        largest_mm = [np.abs(each).max(axis=1) for each in (self.errors_mm, self.bases_mm)]
        readable: BoolArray = np.maximum(*largest_mm) <= FARTHEST_MM
        return readable

    @property
    def quantities(self) -> dict[str, Series]:
        """The quantities that are judged: rms of their points along the main direction, mm."""
        known_c = self.celsius if np.isfinite(self.celsius).all() else None
        return {
            what: Series(
                self.ended_s / YEAR_S, main_direction(each) / math.sqrt(each.shape[1] / 3), known_c
            )
            for what, each in ((ARM, self.errors_mm), (BASE, self.bases_mm))
        }


Place = tuple[str, str, str, str]  # robot, cell, serial, machine


class _Robot(NamedTuple):
    """The calibrations of one robot in one cell with its newest grid, without their vectors."""

    place: Place
    digests: NDArray[np.void]
    ended_s: Array
    left_out: int
    quantities: dict[str, Series]


def robots(
    connection: Connection, robot: str = "", cell: str = "", doubts: list[Doubt] | None = None
) -> list[RobotTrend]:
    """Return the trend of all calibrated robots, or of one by its serial number.

    Add the runs left out to ``doubts``.
    """
    place, layout = (RUN.c.robot, *CELL), (GRID.c.layout, func.length(GRID.c.errors_mm))
    columns = (RUN.c.digest, RUN.c.ended, GRID.c.temperature_c, GRID.c.errors_mm, GRID.c.base_mm)
    query = (
        select(*place, *map(joined, columns))
        .join(GRID, GRID.c.digest == RUN.c.digest)
        .where(RUN.c.newest, RUN.c.robot != "", *selected(cell, robot))
        .group_by(*place, *layout)
        .order_by(*place)
    )
    of = _Robots(connection, [] if doubts is None else doubts)
    rows = connection.execute(query, execution_options={"yield_per": 20})  # 0.2 MB each and more
    every = [
        found
        for place, own in groupby(rows, itemgetter(0, 1, 2, 3))
        if (found := of.robot(place, [_Grids.of(row[4:]) for row in own])) is not None
    ]
    every.sort(key=attrgetter("place"))
    trends = iter(fit_trends([each for robot in every for each in robot.quantities.values()]))
    return [of.trend(each, {what: next(trends) for what in each.quantities}) for each in every]


@dataclass(frozen=True, eq=False)
class _Robots:
    connection: Connection
    doubts: list[Doubt]

    def robot(self, place: Place, layouts: Sequence[_Grids]) -> _Robot | None:
        """Return a robot's calibrations with the newest grid that can be read, or None."""
        waiting = sorted(layouts, key=_Grids.last_s)
        while waiting:
            newest = waiting.pop()
            readable = newest.readable
            if readable.all():
                others = sum(len(each.ended_s) for each in waiting)
                return _Robot(place, newest.digests, newest.ended_s, others, newest.quantities)
            for run in self._runs(newest.digests[~readable]):
                with left_out(run, self.doubts):
                    what = "in its errors and its base"
                    raise ValueError(f"expected numbers of at most {FARTHEST_MM:g} mm {what}")
            if readable.any():
                insort(waiting, newest.chosen(readable), key=_Grids.last_s)
        return None

    def _runs(self, digests: NDArray[np.void]) -> Iterator[Row]:
        """Yield names and ends of runs."""
        query = select(RUN.c.digest, RUN.c.cell, RUN.c.name, RUN.c.ended)
        for start in range(0, len(digests), BATCH):
            part = [UUID(bytes=bytes(each)) for each in digests[start : start + BATCH]]
            found = self.connection.execute(query.where(RUN.c.digest.in_(part)))
            by_digest = {row.digest: row for row in found}
            yield from (by_digest[each] for each in part)

    def trend(self, of: _Robot, trends: dict[str, Trend | None]) -> RobotTrend:
        robot, cell, serial, machine = of.place
        found = [(what, trend) for what, trend in trends.items() if trend is not None]
        reasons = {
            what: why_no_trend(each.years, each.values) or why_no_slope(each.years)
            for what, each in of.quantities.items()
        }
        not_judged = {what: reason for what, reason in reasons.items() if reason}
        return RobotTrend(
            robot=robot, cell=cell, serial=serial, machine=machine,
            calibrations=len(of.digests),
            first=datetime.fromtimestamp(of.ended_s[0], UTC),
            last=datetime.fromtimestamp(of.ended_s[-1], UTC),
            left_out=of.left_out,
            drift=[
                Drift(
                    what=what, mm_per_year=trend.slope, U_mm_per_year=trend.U,
                    drifts=trend.drifts, noise_mm=trend.noise,
                )
                for what, trend in found
                if what not in not_judged
            ],
            not_judged=not_judged,
            changes=[
                self._change(what, of.digests, step)
                for what, trend in found
                for step in trend.steps
            ],
        )  # fmt: skip

    def _change(self, what: str, digests: NDArray[np.void], step: Step) -> Change:
        first, second = self._runs(digests[step.at - 1 : step.at + 1])
        return Change(
            what=what, after=first.name, before=second.name,
            since=first.ended, until=second.ended,
            size_mm=step.size, U_mm=step.U, confirmed=min(step.at, step.after) > 1,
            said=self._messages(first, second),
        )  # fmt: skip

    def _messages(self, first: Row, second: Row) -> list[str]:
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


class AxisTrend(msgspec.Struct, frozen=True, kw_only=True):
    """An error of a tracker's axis at its newest check, and its change a year over all checks with
    U (k = 2): least squares; else None, and ``not_judged`` says why.
    """

    axis: str
    checks: int
    urad: float
    urad_per_year: float | None = None
    U_urad_per_year: float | None = None
    not_judged: str = ""


class Instrument(msgspec.Struct, frozen=True, kw_only=True):
    """A device by its serial number, in all its cells.

    ``scale_ppm``: scale error of a tracker from certified lengths, with standard uncertainty u;
    ``disagrees_with``: trackers that agree with each other but not with this one; ``axes``: of one
    that was checked in both faces.
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
    axes: list[AxisTrend] = []


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
    place = (*CELL, VERDICT.c.key)
    numbers = (RUN.c.ended, VERDICT.c.mean_mm, VERDICT.c.mean_tolerance_mm)
    query = (
        select(*place, *map(joined, numbers))
        .join(VERDICT, VERDICT.c.digest == RUN.c.digest)
        .where(RUN.c.newest, VERDICT.c.key.startswith(VALIDATION), VERDICT.c.mean_mm.is_not(None))
        .where(VERDICT.c.key != f"{VALIDATION}{OTHERS}", *selected(cell, robot))
        .group_by(*place)
        .having(func.count() >= FEWEST)
    )
    stations = []
    for row in connection.execute(query):
        own = np.column_stack([np.frombuffer(each, ">f8") for each in row[4:]])
        own = own[np.argsort(own[:, 0], kind="stable")]
        if not why_no_slope(own[:, 0] / YEAR_S):
            stations.append((row[:4], own))
    stations.sort(key=itemgetter(0))
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


def theil_sen(times: Array, values: Array) -> tuple[float, float, float, float]:
    """Return slope and intercept of values (N,) at times (N,), which are not all equal, and the
    bounds of the slope, by Theil and Sen (Sen 1968).

    It is `scipy.stats.theilslopes` for different times; the import of `scipy.stats` takes a second.
    """
    earlier, later = np.triu_indices(len(times), 1)
    apart = times[later] - times[earlier]
    slopes = np.sort((values[later] - values[earlier])[apart > 0.0] / apart[apart > 0.0])
    slope = float(np.median(slopes))
    half = NormalDist().inv_cdf(0.5 + CONFIDENCE / 2) * _kendall_std(values)
    low = slopes[max(round((len(slopes) - half) / 2) - 1, 0)]
    high = slopes[min(round((len(slopes) + half) / 2), len(slopes) - 1)]
    intercept = float(np.median(values) - slope * np.median(times))
    return slope, intercept, float(low), float(high)


def _station_trend(place: tuple[str, ...], rows: Array) -> StationTrend:
    """Return the trend of a station from times (s), means and tolerances (N, 3)."""
    years, means_mm = rows[:, 0] / YEAR_S, rows[:, 1]
    slope, intercept, low, high = theil_sen(years, means_mm)
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
    scales, axes = _scales(connection), _axes(connection)
    return [
        Instrument(
            kind=kind, maker=maker, model=model, serial=serial,
            firmware=sorted({row.firmware for row in rows}),
            cells=sorted({row.cell for row in rows}),
            runs=sum(row.runs for row in rows),
            first=min(row.first for row in rows),
            last=max(row.last for row in rows),
            **(_scale(serial, scales) if kind == TRACKER else {}),
            axes=axes.get(serial, []) if kind == TRACKER else [],
        )
        for (kind, serial, maker, model), rows in sorted(devices.items())
        if any(cell in ("", row.cell) and robot in ("", row.robot) for row in rows)
    ]  # fmt: skip


def _axes(connection: Connection) -> dict[str, list[AxisTrend]]:
    """Return the axes of each tracker that was checked in both faces."""
    names = ("collimation", "transit", "index")
    numbers = (RUN.c.ended, *(ADJUSTMENT.c[f"{name}_urad"] for name in names))
    query = (
        select(RUN.c.tracker, *map(joined, numbers))
        .join(ADJUSTMENT, ADJUSTMENT.c.digest == RUN.c.digest)
        .where(RUN.c.tracker != "", RUN.c.newest)
        .group_by(RUN.c.tracker)
    )
    found: dict[str, list[AxisTrend]] = {}
    for row in connection.execute(query):
        own = np.column_stack([np.frombuffer(each, ">f8") for each in row[1:]])
        own = own[np.argsort(own[:, 0], kind="stable")]
        each = (_axis_trend(name, own[:, 0], own[:, n]) for n, name in enumerate(names, 1))
        found[row.tracker] = [trend for trend in each if trend is not None]
    return found


def _axis_trend(axis: str, ended_s: Array, urad: Array) -> AxisTrend | None:
    """Return the trend of an axis by errors (N,) at times (N,), NaN where not known."""
    known = np.isfinite(urad)
    years, values = ended_s[known] / YEAR_S, urad[known]
    if not len(values):
        return None
    why = why_no_slope(years)
    newest = AxisTrend(axis=axis, checks=len(values), urad=float(values[-1]), not_judged=why)
    if why:
        return newest
    a_year, u = slope(years, values)
    return msgspec.structs.replace(newest, urad_per_year=a_year, U_urad_per_year=2.0 * u)


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
