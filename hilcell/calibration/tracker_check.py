"""The tracker's field check: its axes by both faces, the drift of one nest, directions of lengths.

At the zenith distance z the first face reads the horizontal angle larger than the second by
``2 c / sin z + 2 i cot z`` and the zenith distance by ``2 v``: collimation c, tilt i of the transit
axis, index v (Deumlich and Staiger, Instrumentenkunde der Vermessungstechnik; of laser trackers
Muralikrishnan et al., J. Res. NIST 114, 2009). As angles across the beam, half of it is
`hilcell.calibration.instrument.axis_levers`. A beam beside the centre of its axes adds the same
length at all ranges, which no axis explains.

A figure fails where it exceeds its limit by more than U (k = 2): the user of an instrument proves
that it does not conform (ISO 14253-1).
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeVar

import numpy as np
from msgspec.structs import replace

from hilcell.calibration.instrument import (
    axis_levers,
    beam_axes,
    half_differences_mm,
    positions_at_set_up,
)
from hilcell.cell.devices import tracker_accuracy
from hilcell.cell.file import Cell
from hilcell.cell.uncertainty import COVERAGE_FACTOR
from hilcell.geometry.statistics import coverage_factor, lengths_mm
from hilcell.journal.log import Log, noise_at, run_noise
from hilcell.model.events import URAD
from hilcell.model.outcome import Outcome
from hilcell.model.point import BACK, FRONT, STEADY, Point, PointId
from hilcell.model.verdicts import AxesJudged, DriftJudged, FaceError, Verdict
from hilcell.ports import Array

J = TypeVar("J", bound=Verdict)
DIRECTIONS = ("along the beam", "across it, level", "across it, upright")


def decided(judged: J) -> J:
    """Return a verdict that holds unless one of its figures is rejected."""
    rejected = any(each.outcome is Outcome.REJECTED for each in judged.figures)
    return replace(judged, holds=not rejected)


def limit_across_mm(cell: Cell, range_mm: float) -> float:
    """Return the maker's limit of an error across the beam, as the cell file states it, or 2 sigma
    of the accuracy class where that is more.
    """
    stated, class_of = cell.uncertainty, tracker_accuracy(cell)
    limit_mm = stated.tracker_limit_mm + 1e-6 * stated.tracker_limit_um_m * range_mm
    if class_of is None:
        return limit_mm
    _, across_rad = class_of.accuracy(range_mm / 1000.0)
    return max(limit_mm, COVERAGE_FACTOR * across_rad * range_mm)


# -- axes ------------------------------------------------------------------------------------------


class AxisErrors(NamedTuple):
    """Collimation, transit tilt, index (3,) in rad with covariance (3, 3), and what they leave of
    the half differences, angles (N, 2). Tilt and its rows are NaN where it is not separable.
    """

    sizes_rad: Array
    covariance: Array
    left_rad: Array


def fitted_axes(front_mm: Array, off_rad: Array, u_rad: Array) -> AxisErrors:
    """Fit the errors of the axes to half the differences (N, 2) of both faces, as angles with
    ``u_rad`` (N,) in each direction, at places (N, 3) in the tracker's frame; N >= 1.

    Where all beams have nearly one height, collimation and tilt act alike: the tilt is taken as 0.
    """
    levers = axis_levers(front_mm)
    least_apart = 0.05  # sines of the beams' heights, 3 deg
    kept = [0, 1, 2] if float(np.ptp(levers[:, 0, 1])) >= least_apart else [0, 2]
    A = (levers / u_rad[:, None, None])[:, :, kept].reshape(-1, len(kept))
    own = np.linalg.inv(A.T @ A)
    sizes = np.zeros(3)
    sizes[kept] = own @ A.T @ (off_rad / u_rad[:, None]).reshape(-1)
    left_rad = off_rad - levers @ sizes
    covariance = np.full((3, 3), np.nan)
    covariance[np.ix_(kept, kept)] = own
    sizes[[n for n in range(3) if n not in kept]] = np.nan
    return AxisErrors(sizes, covariance, left_rad)


def judged_axes(log: Log) -> AxesJudged | None:
    """Judge the nests that were measured in both faces, in the first before and after the second,
    so that a steady drift cancels; None before.
    """
    backs = [point for point in log.measured(BACK) if point.id.number is None]
    every = [[log.find(front_id(back.id.nest, n)) for n in (0, 1)] for back in backs]
    both = [(front, back) for front, back in zip(every, backs, strict=True) if None not in front]
    if not both:
        return None
    fronts = [point for front, _ in both for point in front if point is not None]
    backs = [back for _, back in both]
    front_mm = positions_at_set_up(log, fronts).reshape(-1, 2, 3).mean(axis=1)
    back_mm = positions_at_set_up(log, backs)
    range_mm, noise = lengths_mm(front_mm), run_noise(log)
    samples = np.array([point.samples for point in fronts]).reshape(-1, 2).sum(axis=1)
    shares = 1.0 / samples + 1.0 / np.array([back.samples for back in backs])
    across_rad = 1e-3 * math.sqrt(noise.across_mm2_m2)  # of one reading: mm at 1 m
    u_rad = 0.5 * across_rad * np.sqrt(shares)
    off_mm = half_differences_mm(front_mm, back_mm)
    found = fitted_axes(front_mm, off_mm / range_mm[:, None], u_rad)
    k = coverage_factor(COVERAGE_FACTOR, noise.freedom)
    left_mm = found.left_rad * range_mm[:, None]
    nests = [
        FaceError(
            nest=back.id.nest,
            range_mm=float(range_mm[n]),
            height_deg=math.degrees(math.asin(front_mm[n, 2] / range_mm[n])),
            across_mm=float(off_mm[n, 0]),
            down_mm=float(off_mm[n, 1]),
            left_across_mm=float(left_mm[n, 0]),
            left_down_mm=float(left_mm[n, 1]),
            U_mm=float(k * u_rad[n] * range_mm[n]),
            limit_mm=limit_across_mm(log.cell, float(range_mm[n])),
        )
        for n, back in enumerate(backs)
    ]
    c, i, v = (URAD * found.sizes_rad).tolist()
    U_c, U_i, U_v = (URAD * k * np.sqrt(np.diag(found.covariance))).tolist()
    separable = not math.isnan(i)
    judged = AxesJudged(
        holds=True,
        nests=nests,
        collimation_urad=c,
        collimation_U_urad=U_c,
        transit_urad=i if separable else None,
        transit_U_urad=U_i if separable else None,
        index_urad=v,
        index_U_urad=U_v,
    )
    return decided(judged)


def front_id(nest: str, number: int) -> PointId:
    """Return the identity of a nest in the first face, before (0) or after (1) the second."""
    return PointId(FRONT, number=number, nest=nest)


# -- drift -----------------------------------------------------------------------------------------


class Trend(NamedTuple):
    """The change (3,) of a place over a time, along the beam, sideways and downwards, its u (3,),
    and the degrees of freedom of that.
    """

    change_mm: Array
    u_mm: Array
    freedom: int


def seen_from_mean_mm(at_mm: Array) -> Array:
    """Return places (N, 3), tracker's frame, about their mean: along the beam, sideways, down."""
    mean_mm = at_mm.mean(axis=0)
    seen_mm: Array = (at_mm - mean_mm) @ beam_axes(mean_mm[None])[0].T
    return seen_mm


def fitted_trend(elapsed_s: Array, at_mm: Array, over_s: float) -> Trend:
    """Fit a straight line to places (N, 3) in the tracker's frame at times (N,); N >= 3.

    The noise is that which the line leaves; a change that is no line widens u.
    """
    seen_mm = seen_from_mean_mm(at_mm)
    since_s = elapsed_s - elapsed_s.mean()
    squares = float(since_s @ since_s)
    slopes = since_s @ seen_mm / squares
    freedom = len(at_mm) - 2
    left_mm2 = np.square(seen_mm - since_s[:, None] * slopes).sum(axis=0) / freedom
    return Trend(over_s * slopes, over_s * np.sqrt(left_mm2 / squares), freedom)


def drift_points(log: Log) -> list[Point]:
    """Return the newest series of one nest."""
    every = list(log.measured(STEADY))
    return [point for point in every if point.id.session == every[-1].id.session]


def drift_series(log: Log) -> tuple[Array, Array]:
    """Return the times (N,) of the newest series, minutes, and the places (N, 3) along the beam,
    sideways and downwards, mm, about their mean; N >= 1.
    """
    series = drift_points(log)
    elapsed_s = np.array([point.elapsed_s for point in series], dtype=float)
    return elapsed_s / 60.0, seen_from_mean_mm(positions_at_set_up(log, series))


def judged_drift(log: Log) -> DriftJudged | None:
    """Judge the newest series of one nest; None before it has three points."""
    series = drift_points(log)
    fewest = 3
    if len(series) < fewest:
        return None
    at_mm = positions_at_set_up(log, series)
    elapsed_s = np.array([point.elapsed_s for point in series], dtype=float)
    over_s = float(np.ptp(elapsed_s))
    trend = fitted_trend(elapsed_s, at_mm, over_s)
    size_mm = float(np.linalg.norm(trend.change_mm))
    along = trend.change_mm / size_mm if size_mm else np.full(3, 3**-0.5)
    k = coverage_factor(COVERAGE_FACTOR, trend.freedom)
    apart_mm = np.linalg.norm(at_mm[:, None] - at_mm[None], axis=-1)
    noise_mm2 = float(np.trace(noise_at(run_noise(log), series).mean(axis=0)))
    a, b, c = trend.change_mm.tolist()
    judged = DriftJudged(
        holds=True,
        nest=series[0].id.nest,
        minutes=round(over_s / 60.0, 1),
        points=len(series),
        trend_mm=(a, b, c),
        trend_U_mm=k * float(np.linalg.norm(along * trend.u_mm)),
        range_mm=float(apart_mm.max()),
        noise_mm=math.sqrt(noise_mm2 / 3.0),
        limit_mm=_drift_limit_mm(log.cell, float(np.linalg.norm(at_mm[0]))),
    )
    return decided(judged)


def _drift_limit_mm(cell: Cell, range_mm: float) -> float:
    """Return the stated limit, or 2 sigma of the accuracy class where that is more."""
    class_of = tracker_accuracy(cell)
    if class_of is None:
        return cell.uncertainty.drift_limit_mm
    along_mm, across_rad = class_of.accuracy(range_mm / 1000.0)
    class_mm = COVERAGE_FACTOR * max(along_mm, across_rad * range_mm)
    return max(cell.uncertainty.drift_limit_mm, class_mm)


# -- lengths ---------------------------------------------------------------------------------------


def seen_direction(ends_mm: Array) -> str:
    """Return which of `DIRECTIONS` the length between two places (2, 3) has most of, as the tracker
    sees it from its frame's origin.
    """
    axes = beam_axes(ends_mm.mean(axis=0)[None])[0]
    return DIRECTIONS[int(np.argmax(np.abs(axes @ (ends_mm[1] - ends_mm[0]))))]
