"""Did anything move meanwhile: the floor nests, and the air, over time; stops are hatched."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from hilcell.calibration.file import calibration_so_far
from hilcell.calibration.measurement_budget import control_moves
from hilcell.calibration.validity import TEMPERATURE_MARGIN_K
from hilcell.journal.log import run_noise
from hilcell.model.records import StateChanged
from hilcell.report.drawings.drawing import (
    AFTER,
    INK,
    Frame,
    Scale,
    circle,
    hatched,
    path,
    rectangle,
    svg,
    text,
)
from hilcell.report.facts import Facts
from hilcell.run.watch import limits_of

WIDTH_MM, HEIGHT_MM, LEFT_MM, TOP_MM, BOTTOM_MM = 88.0, 46.0, 12.0, 6.5, 10.0


def floor_moves(facts: Facts) -> str:
    """Return how far each floor nest was from its first measurement; "" without any again."""
    moves, time_axis = control_moves(facts.log), _Times(facts)
    if not moves:
        return ""
    times, points = time_axis.times(), [point for point, _ in moves]
    at_s = np.array([times[point.key] for point in points])
    size_mm = np.array([float(np.linalg.norm(move)) for _, move in moves])
    limit_mm = float(np.median(limits_of(facts.cell, run_noise(facts.log), points, points)))
    beyond = 1.25  # the limit
    most_mm = beyond * max(limit_mm, float(size_mm.max()))
    frame = time_axis.frame(Scale(0.0, most_mm, HEIGHT_MM - BOTTOM_MM, TOP_MM))
    limit = frame.y.one(limit_mm)
    parts = [
        *time_axis.stops(frame),
        hatched(frame.x.begin, TOP_MM, frame.x.end - frame.x.begin, limit - TOP_MM),
        frame.drawn(
            f"time, {facts.zone.tzname(None)}", "move since the first, mm", time_axis.ticks()
        ),
        frame.level(limit_mm, INK, 0.6),
        text(frame.x.end, limit - 1.2, f"limit {limit_mm:.3f}", "end"),
    ]
    parts += [circle(x, y, 0.7, AFTER, AFTER) for x, y in frame.at(at_s, size_mm)]
    words = f"largest {size_mm.max():.3f} mm, {len(moves)} measurements"
    parts.append(text(frame.x.begin + 2.0, limit + 3.4, words, colour=AFTER, bold=True))
    return svg(WIDTH_MM, HEIGHT_MM, "Moves of the floor nests", parts, facts.inputs.simulated)


def air(facts: Facts) -> str:
    """Return the air's temperature at the tracker; "" without a weather station."""
    time_axis = _Times(facts)
    times, points = time_axis.times(), facts.log.points.values()
    found = sorted((times[p.key], p.temperature_c) for p in points if p.temperature_c is not None)
    if not found:
        return ""
    at_s, celsius = np.array(found).T
    calibration = calibration_so_far(facts.log, facts.run)
    range_c = calibration.validity.temperature_c if calibration is not None else None
    margin_k = TEMPERATURE_MARGIN_K
    valid = None if range_c is None else (range_c[0] - margin_k, range_c[1] + margin_k)
    ends_c = [*celsius, *(valid or ())]
    low, high = min(ends_c) - 0.3, max(ends_c) + 0.3
    frame = time_axis.frame(Scale(float(low), float(high), HEIGHT_MM - BOTTOM_MM, TOP_MM))
    time = f"time, {facts.zone.tzname(None)}"
    parts, named = [], []
    if valid is not None:
        bottom, top = frame.y.one(valid[0]), frame.y.one(valid[1])
        parts.append(
            rectangle(frame.x.begin, top, frame.x.end - frame.x.begin, bottom - top, "#e6edf4")
        )
        for value, words in ((valid[1], "valid up to"), (valid[0], "valid from")):
            parts.append(frame.level(value, INK, 0.4, "1.4 1"))
            y = frame.y.one(value) + (3.2 if value == valid[1] else -1.0)
            named.append(text(frame.x.end - 1.0, y, f"{words} {value:.1f}", "end"))
    parts += time_axis.stops(frame)
    parts.append(frame.drawn(time, "air at the tracker, °C", time_axis.ticks()))
    places = frame.at(at_s, celsius)
    parts.append(path(places[:: max(1, len(places) // 300)], AFTER, 0.6))
    parts += named
    words = f"{celsius.min():.1f} to {celsius.max():.1f} °C"
    parts.append(text(frame.x.begin + 2.0, TOP_MM + 7.0, words, colour=AFTER, bold=True))
    return svg(WIDTH_MM, HEIGHT_MM, "Air at the tracker", parts, facts.inputs.simulated)


@dataclass(frozen=True, eq=False)
class _Times:
    facts: Facts

    def times(self) -> dict[str, float]:
        """Return when each point that counts was recorded, s."""
        return {each.key: _seconds(each.t) for each in self.facts.records if each.kind == "point"}

    def ends(self) -> tuple[float, float]:
        """Return when the run began and ended, s; it lasted a second at least."""
        begin = _seconds(self.facts.records[0].t)
        return begin, max(_seconds(self.facts.last.t), begin + 1.0)

    def frame(self, y: Scale) -> Frame:
        return Frame(Scale(*self.ends(), LEFT_MM, WIDTH_MM - 7.0), y)

    def ticks(self) -> list[tuple[float, str]]:
        begin, end = self.ends()
        short_s = 600.0  # of a run so short seconds are shown
        form = "%H:%M:%S" if end - begin < short_s else "%H:%M"
        ticks = 4
        return [
            (float(each), datetime.fromtimestamp(each, tz=self.facts.zone).strftime(form))
            for each in np.linspace(begin, end, ticks)
        ]

    def stops(self, frame: Frame) -> Iterator[str]:
        """Yield a hatched box for each time between two sessions."""
        before = ""
        for record in self.facts.records:
            match record.fact:
                case StateChanged(machine="run", to="checking"):
                    left, right = (frame.x.one(_seconds(t)) for t in (before or record.t, record.t))
                    yield hatched(left, TOP_MM, right - left, frame.y.begin - TOP_MM)
                    before = record.t
            before = before and record.t


def _seconds(time: str) -> float:
    return datetime.fromisoformat(time).timestamp()
