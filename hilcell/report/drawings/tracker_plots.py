"""The tracker's check drawn: both faces at each nest, and the drift of one nest over time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hilcell.calibration.tracker_check import drift_series
from hilcell.journal.log import Log
from hilcell.model.verdicts import AxesJudged, DriftJudged
from hilcell.report.drawings.drawing import (
    AFTER,
    BEFORE,
    ENDS,
    INK,
    MUTED,
    Frame,
    Scale,
    circle,
    hatched,
    labels,
    path,
    round_up,
    shortened,
    svg,
    text,
)

WIDTH_MM, HEIGHT_MM, LEFT_MM, RIGHT_MM, TOP_MM, BOTTOM_MM = 88.0, 54.0, 10.0, 19.0, 6.0, 10.0
UM = 1000.0  # of a mm


def _symmetric(x: Scale, most_um: float) -> Frame:
    return Frame(x, Scale(-most_um, most_um, HEIGHT_MM - BOTTOM_MM, TOP_MM))


def both_faces(log: Log) -> str:
    """Return half the difference of both faces at each nest, with U, limit, and what the axes leave
    (hollow); "" where the run has none.
    """
    judged = log.verdict(AxesJudged)
    if judged is None:
        return ""
    nests = judged.nests
    shown_um = [
        UM * max(abs(each.across_mm), abs(each.down_mm), each.limit_mm) + UM * each.U_mm
        for each in nests
    ]
    x = Scale(-0.5, len(nests) - 0.5, LEFT_MM, WIDTH_MM - RIGHT_MM)
    frame = _symmetric(x, round_up(1.05 * max(shown_um), ENDS))
    name_mm = (x.end - x.begin) / len(nests) - 1.0
    ticks = [
        (float(n), shortened(f"{each.nest}, {each.range_mm / 1000:.1f} m", name_mm))
        for n, each in enumerate(nests)
    ]
    parts = [frame.drawn("nest, and its distance", "half the difference of both faces, µm", ticks)]
    half = 0.42  # of the width of a nest
    for n, each in enumerate(nests):
        left, right = x.one(n - half), x.one(n + half)
        for sign in (-1.0, 1.0):
            limit = frame.y.one(sign * UM * each.limit_mm)
            parts.append(path([(left, limit), (right, limit)], INK, 0.6))
        for value_mm, left_mm, colour, beside in (
            (each.across_mm, each.left_across_mm, AFTER, -0.15),
            (each.down_mm, each.left_down_mm, BEFORE, 0.15),
        ):
            at, U = x.one(n + beside), UM * each.U_mm
            ends = [frame.y.one(UM * value_mm + sign * U) for sign in (-1.0, 1.0)]
            parts.append(path([(at, ends[0]), (at, ends[1])], colour, 0.5))
            parts.append(circle(at, frame.y.one(UM * value_mm), 0.9, colour, colour))
            parts.append(circle(at + 2.0, frame.y.one(UM * left_mm), 0.7, "#fff", colour))
    last = nests[-1]
    named = [
        (frame.y.one(UM * last.across_mm), "sideways", AFTER),
        (frame.y.one(UM * last.down_mm), "down", BEFORE),
        (frame.y.one(UM * last.limit_mm), "limit", INK),
    ]
    parts += labels(x.end + 1.0, named, frame.y.begin)
    return svg(WIDTH_MM, HEIGHT_MM, "Both faces of the tracker", parts, log.inputs.simulated)


def drift(log: Log) -> str:
    """Return the places of one nest over time, with their trend; "" where the run has none."""
    judged = log.verdict(DriftJudged)
    if judged is None:
        return ""
    minutes, seen_mm = drift_series(log)
    limit_um = UM * judged.limit_mm
    most_um = max(limit_um, UM * float(np.abs(seen_mm).max()))
    x = Scale(0.0, float(minutes.max()), LEFT_MM, WIDTH_MM - RIGHT_MM)
    frame = _symmetric(x, round_up(1.1 * most_um, ENDS))
    y_name = f"place of {judged.nest} about its mean, µm"
    parts = [frame.drawn("minutes", y_name), *_beyond(frame, limit_um)]
    named = []
    names = zip(("along", "sideways", "down"), (MUTED, AFTER, BEFORE), strict=True)
    for n, (name, colour) in enumerate(names):
        places = frame.at(minutes, UM * seen_mm[:, n])
        parts += [circle(at_x, at_y, 0.6, colour, colour) for at_x, at_y in places.tolist()]
        since = minutes - minutes.mean()
        line = frame.at(minutes, UM * judged.trend_mm[n] * since / float(np.ptp(minutes)))
        parts.append(path(line[[0, -1]], colour, 0.5))
        named.append((float(line[-1, 1]), name, colour))
    parts += labels(x.end + 1.0, named, frame.y.begin)
    return svg(WIDTH_MM, HEIGHT_MM, "Drift of the tracker", parts, log.inputs.simulated)


def _beyond(frame: Frame, limit_um: float) -> Iterator[str]:
    """Yield the two hatched stretches beyond half a limit: a trend of the whole limit about its
    middle ends there.
    """
    wide = frame.x.end - frame.x.begin
    upper, lower = (frame.y.one(sign * limit_um / 2.0) for sign in (1.0, -1.0))
    yield hatched(frame.x.begin, frame.y.end, wide, upper - frame.y.end)
    yield hatched(frame.x.begin, lower, wide, frame.y.begin - lower)
    yield text(frame.x.end, upper - 1.0, f"trend beyond {limit_um:.3g} µm", "end")
