"""Stations that get worse, instruments by serial number, alarms by kind."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from datetime import datetime
from itertools import combinations

import msgspec
import numpy as np
from sqlalchemy import Connection, func, select

from hilcell.journal.words import OTHERS
from hilcell.model.verdicts import VALIDATION
from hilcell.plant.cells import CELL, chosen, newest
from hilcell.plant.course import CONFIDENCE, FEWEST, SIGNIFICANCE
from hilcell.plant.record import TRACKER
from hilcell.plant.robots import YEAR_S
from hilcell.plant.tables import ALARM, DEVICE, LENGTH, RUN, VERDICT, Found
from hilcell.typed import Json


class StationCourse(msgspec.Struct, frozen=True, kw_only=True):
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


def worse_stations(connection: Connection, cell: str = "", robot: str = "") -> list[StationCourse]:
    """Return the stations whose error after correction grows from calibration to calibration."""
    asked = (
        select(*CELL, RUN.c.ended, VERDICT.c.key, VERDICT.c.mean_mm, VERDICT.c.mean_tolerance_mm)
        .join(VERDICT, VERDICT.c.digest == RUN.c.digest)
        .where(newest(), VERDICT.c.key.startswith(VALIDATION), VERDICT.c.mean_mm.is_not(None))
        .where(*chosen(cell, robot))
        .order_by(RUN.c.ended)
    )
    found: defaultdict[tuple[str, ...], list[Found]] = defaultdict(list)
    for row in connection.execute(asked):
        station = row.key.removeprefix(VALIDATION)
        if station != OTHERS:
            found[row.cell, row.serial, row.machine, station].append(row)
    judged = {place: rows for place, rows in found.items() if len(rows) >= FEWEST}
    courses = (_worse(place, rows, len(judged)) for place, rows in sorted(judged.items()))
    return [each for each in courses if each is not None]


def _worse(place: tuple[str, ...], rows: Sequence[Found], judged: int) -> StationCourse | None:
    from scipy import stats  # it takes half a second to import, and most questions need none

    years = np.array([row.ended.timestamp() for row in rows]) / YEAR_S
    means_mm = np.array([row.mean_mm for row in rows])
    grows = stats.kendalltau(years, means_mm, alternative="greater").pvalue
    if not grows * judged < SIGNIFICANCE:
        return None
    found = stats.theilslopes(means_mm, years, CONFIDENCE)
    slope, intercept, low, high = map(float, found)
    now_mm, tolerance_mm = intercept + slope * float(years[-1]), rows[-1].mean_tolerance_mm
    left_mm = None if tolerance_mm is None else tolerance_mm - now_mm
    cell, serial, machine, station = place
    return StationCourse(
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
    found: defaultdict[tuple[str, ...], list[Found]] = defaultdict(list)
    for row in connection.execute(asked):
        found[row.kind, row.serial, row.maker, row.model].append(row)
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
    witnesses = 2  # trackers that agree with one another against a third
    agree = {
        name for pair in combinations(against, witnesses) if not differ(*pair) for name in pair
    }
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
    found: defaultdict[tuple[str, str, str], list[Found]] = defaultdict(list)
    for row in connection.execute(asked):
        found[row.code, row.title, row.severity].append(row)
    counted = [
        AlarmCount(
            code=code, title=title, severity=severity,
            count=sum(row.times for row in rows),
            cells=sorted({row.cell for row in rows}),
            last=max(row.last for row in rows),
        )
        for (code, title, severity), rows in found.items()
    ]  # fmt: skip
    return sorted(counted, key=lambda each: (-each.count, each.code))
