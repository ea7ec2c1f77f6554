"""The plots of a run: points and curves of the journal as series of `hilcell.tui.plots`.

A plot is turned by its pick: a station, or a swept axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from textual.content import Content

from hilcell.calibration.errors import Errors, counting, errors_of
from hilcell.calibration.iso9283 import attained
from hilcell.calibration.recheck import KIND as RECHECK
from hilcell.calibration.recheck import rechecked
from hilcell.geometry.statistics import bounds95_mm, from_mean_mm, repeatability_mm
from hilcell.journal.log import Log, positions_mm
from hilcell.model.point import Point, PointId, Sent
from hilcell.model.verdicts import ISO
from hilcell.ports import Array, HilcellError
from hilcell.tui.plots import Ink, Look, Mark, Plot, Series, step_at_least

STROKE = 80  # marks of a line from the bottom of a spectrum
AS_SENT = Ink("$label", "o", "$label")
PAPER = Ink("$live 70%", "+", "$label")
LIVE = Ink("$live", "x", "$live")
OTHER = Ink("$foreground", "*", "$foreground")
INKS = {Sent.BEFORE: AS_SENT, Sent.IDW: PAPER, Sent.CHOSEN: LIVE}
PLACES = (LIVE, AS_SENT, PAPER, OTHER)
MOST_TICKS = 5

Target = tuple[str, int]  # station and number


@dataclass(frozen=True, slots=True, eq=False)
class Errors3D:
    """|e| of targets (N,) in mm by how they were sent; NaN where one was not measured."""

    targets: tuple[Target, ...]
    by_how: dict[Sent, Array]
    grid: bool = False  # of the grid's points: no target was validated yet

    @classmethod
    def of(cls, points: Sequence[Point], norms_mm: Array, *, grid: bool) -> Errors3D:
        """Return |e| (N,) of points by target, in the order in which each was first measured."""
        order: dict[Target, int] = {}
        where = np.array(
            [
                order.setdefault((point.station, n if grid else point.id.number or 0), len(order))
                for n, point in enumerate(points)
            ]
        )
        hows = np.array([point.id.how or Sent.BEFORE for point in points])
        by_how: dict[Sent, Array] = {}
        for how in Sent:
            if (mine := hows == how).any():
                by_how[how] = np.full(len(order), np.nan)
                by_how[how][where[mine]] = norms_mm[mine]
        return cls(tuple(order), by_how, grid)

    def at(self, station: str) -> Errors3D:
        """Return those of a station; without a name, all."""
        if not station:
            return self
        kept = [n for n, (name, _) in enumerate(self.targets) if name == station]
        by_how = {how: values[kept] for how, values in self.by_how.items()}
        some = {how: values for how, values in by_how.items() if np.isfinite(values).any()}
        return Errors3D(tuple(self.targets[n] for n in kept), some, self.grid)

    @property
    def stations(self) -> tuple[str, ...]:
        """Return the stations in the order in which they were measured."""
        return tuple(dict.fromkeys(name for name, _ in self.targets))


def errors_by_target(log: Log) -> Errors3D:
    """Return |e| of every target, in the order in which each was first measured.

    Of a target that was measured more than once the larger error counts, as in the verdict.
    """
    if "world" not in log.frames:
        return Errors3D((), {})
    points = [*log.measured("validate")]
    grid = not points
    points = [*log.measured("grid")] if grid else points
    points = [counting(log, point) for point in points if point.nominal_mm is not None]
    return Errors3D.of(points, errors_of(log, points).norms_mm, grid=grid)


class Measured:
    """A journal as the plots see it: errors and residuals are computed once for each drawing."""

    def __init__(self, log: Log) -> None:
        self.log = log

    @cached_property
    def errors(self) -> Errors3D:
        """Return |e| of every target."""
        return errors_by_target(self.log)

    def stations(self) -> tuple[str, ...]:
        """Return the stations of the targets, after "" for all."""
        return "", *self.errors.stations

    @cached_property
    def strip_mm(self) -> dict[str, Array]:
        """Return the strip's readings less the stations' by station, at every point."""
        wanted_mm = {each.name: each.strip_mm for each in self.log.cell.station}
        found: dict[str, list[float]] = {}
        for point in self.log.points.values():
            if point.strip_mm is not None and point.station in wanted_mm:
                off_mm = point.strip_mm - wanted_mm[point.station]
                found.setdefault(point.station, []).append(off_mm)
        return {name: np.array(values) for name, values in found.items()}

    @cached_property
    def visits_mm(self) -> dict[str, Array]:
        """Return the distances of repeated readings from their mean, by place."""
        groups: dict[str, list[Point]] = {}
        for kind in ("repeat", "repeatability", ISO):
            for point in self.log.measured(kind):
                groups.setdefault(_place(point.id), []).append(point)
        return {name: from_mean_mm(positions_mm(points)) for name, points in groups.items()}

    @cached_property
    def poses(self) -> dict[str, Errors]:
        """Return the errors of a pose test at each pose so far."""
        return attained(self.log) if {"world", "base"} <= self.log.frames.keys() else {}

    @cached_property
    def figures_by_pose(self) -> dict[str, tuple[float, float]]:
        """Return AP_p and RP_l (mm) by pose; RP_l is NaN before the second visit."""
        found = {}
        for name, each in self.poses.items():
            distances_mm = from_mean_mm(each.error_mm)
            rp_mm = repeatability_mm(distances_mm) if len(distances_mm) > 1 else math.nan
            found[name] = (float(np.linalg.norm(each.error_mm.mean(axis=0))), rp_mm)
        return found

    @cached_property
    def rechecked_mm(self) -> tuple[Array, Array]:
        """Return |e| of the re-checked targets so far (N,), and the predicted bounds, 95 %.

        Without bounds (0,) where the calibration does not predict them yet.
        """
        points = self.log.select(RECHECK)
        if not points or "world" not in self.log.frames:
            return np.zeros(0), np.zeros(0)
        try:
            found = rechecked(self.log)
        except HilcellError:
            return errors_of(self.log, points).norms_mm, np.zeros(0)
        return np.linalg.norm(found.errors_mm, axis=1), bounds95_mm(found.each_mm2)

    @property
    def swept(self) -> tuple[str, ...]:
        """Return the swept axes by name, A1 first."""
        return tuple(f"A{axis}" for axis in sorted(self.log.curves))


def _place(id: PointId) -> str:
    if id.kind == ISO:
        return f"pose {id.pose}"
    return f"{id.how} {id.way}" if id.kind == "repeat" else f"place {(id.place or 0) + 1}"


def errors_plot(of: Measured, pick: str = "") -> Plot:
    """Return |e| target by target."""
    found = of.errors.at(pick)
    return target_plot(found, *_limit(of.log, found))


def target_plot(found: Errors3D, limits: tuple[float, ...], limit_name: str) -> Plot:
    """Return |e| target by target."""
    count = max(len(found.targets), 1)
    x = (np.arange(len(found.targets)) + 0.5) / count
    series = [Series(how.text, INKS[how], x, y) for how, y in found.by_how.items()]
    what = "grid point" if found.grid else "target"
    title = f"|e| {what} by {what}, mm"
    return Plot(title, what, _counted(count), tuple(series), limits, limit_name)


def sorted_plot(of: Measured, pick: str = "") -> Plot:
    """Return |e| in rising order, over the share of the targets that have less."""
    found = of.errors.at(pick)
    series = []
    for how, y in found.by_how.items():
        known = np.sort(y[np.isfinite(y)])
        x = np.arange(len(known)) / max(len(known), 1)
        series.append(Series(how.text, INKS[how], x, known, joined=True))
    what = "grid points" if found.grid else "targets"
    ticks = tuple((share / 100, f"{share} %") for share in (0, 25, 50, 75, 95))
    x_title = f"share of the {what} that have less than this error"
    return Plot("|e| in rising order, mm", x_title, ticks, tuple(series), *_limit(of.log, found))


def _limit(log: Log, found: Errors3D) -> tuple[tuple[float, ...], str]:
    """Return the limit and its name; there is none before anything is corrected."""
    limits = () if found.grid or not found.by_how else (log.cell.validation.max_tolerance_mm,)
    return limits, "limit of each target"


def poses_plot(of: Measured, pick: str = "") -> Plot:
    """Return AP_p of the poses of a pose test so far, over |e| of each visit."""
    poses, limit_mm = of.poses, of.log.cell.iso9283.ap_limit_mm
    count = max(len(poses), 1)
    middles: Array = (np.arange(len(poses)) + 0.5) / count
    norms_mm = [np.linalg.norm(found.error_mm, axis=1) for found in poses.values()]
    x = [
        middle + np.linspace(-0.3, 0.3, len(each)) / count  # visits, around the middle
        for middle, each in zip(middles, norms_mm, strict=True)
    ]
    ap_mm = np.array([ap_mm for ap_mm, _ in of.figures_by_pose.values()])
    series = [Series("each visit", AS_SENT, np.concatenate(x), np.concatenate(norms_mm)),
              Series("AP_p", LIVE, middles, ap_mm)] if poses else []  # fmt: skip
    ticks = tuple(zip(middles.tolist(), poses, strict=True))
    limits = () if limit_mm is None else (limit_mm,)
    title = "pose accuracy AP_p, mm"
    return Plot(title, "pose", ticks, tuple(series), limits, "limit of AP_p")


def recheck_plot(of: Measured, pick: str = "") -> Plot:
    """Return |e| of the targets of a re-check, beside the bound that the calibration predicts."""
    found_mm, bounds_mm = of.rechecked_mm
    count = max(len(found_mm), 1)
    x = (np.arange(count) + 0.5) / count
    series = [Series("now", LIVE, x, found_mm)] if len(found_mm) else []
    if len(bounds_mm):
        series.insert(0, Series("95 % bound", PAPER, x, bounds_mm))
    title = "|e| of the re-checked targets, mm"
    return Plot(title, "re-checked target", _counted(count), tuple(series))


def repeat_plot(of: Measured, pick: str = "") -> Plot:
    """Return how far repeated readings of a place lie from their mean."""
    values = of.visits_mm
    if len(values) > len(PLACES):
        values = {"all visits": np.concatenate([*values.values()])}
    count = max((len(each) for each in values.values()), default=1)
    series = [
        Series(name, ink, (np.arange(len(y)) + 0.5) / count, y)
        for ink, (name, y) in zip(PLACES, values.items(), strict=False)
    ]
    return Plot("distance from the mean of the visits, mm", "visit", _counted(count), tuple(series))


def strip_plot(of: Measured, pick: str = "") -> Plot:
    """Return the strip's reading less the station's value at every point, in its own scale.

    The limit is that of a slide that is held: twice the tolerance to which it was approached.
    """
    shown = [each for name, each in of.strip_mm.items() if pick in ("", name)]
    values = np.concatenate([np.zeros(0), *shown])
    x = (np.arange(len(values)) + 0.5) / max(len(values), 1)
    within_mm = of.log.cell.rail.held_within_mm
    series = (Series("strip", LIVE, x, values),) if len(values) else ()
    return Plot("strip's reading less the station's, mm", "point", _counted(len(values)), series,
                (within_mm, -within_mm), "station held within")  # fmt: skip


def sweep_plot(of: Measured, pick: str = "") -> Plot:
    """Return the spectrum of a swept axis, with the lines of its gears."""
    axes = of.swept
    title, x_title = "transmission error, µrad", "cycles per revolution of the joint"
    if not axes:
        return Plot(title, x_title, (), ())
    record = of.log.curves[int((pick or axes[0])[1:])]
    spectrum = np.array(record.spectrum).reshape(-1, 2)
    most = 1.02 * float(spectrum[:, 0].max(initial=1.0))
    step = step_at_least(most / MOST_TICKS)
    ticks = [(n * step / most, f"{n * step:g}") for n in range(math.floor(most / step) + 1)]
    series = [Series("spectrum", AS_SENT, spectrum[:, 0] / most, spectrum[:, 1], joined=True)]
    lines = [*zip(record.cycles, record.amplitudes_urad, strict=True)]
    if lines:
        x = np.repeat([cycles / most for cycles, _ in lines], STROKE)
        y = np.concatenate([np.linspace(0.0, size, STROKE) for _, size in lines])
        series.append(Series("gear lines", LIVE, x, y))
    marks = tuple(Mark(f"{cycles:.1f}", cycles / most, size) for cycles, size in lines)
    used = "" if record.holds else f"; not used: {record.reason}"
    return Plot(f"{title}: axis A{record.axis}{used}", x_title, tuple(ticks), tuple(series),
                marks=marks)  # fmt: skip


def _counted(count: int) -> tuple[tuple[float, str], ...]:
    """Return ticks for things that are counted from 1."""
    step = round(step_at_least(max(count / MOST_TICKS, 1.0)))
    numbers = [1, *range(step, count + 1, step)]
    return tuple(((n - 0.5) / max(count, 1), str(n)) for n in dict.fromkeys(numbers))


def mark_of(look: Look, ink: Ink) -> Content:
    """Return the mark of a series in a key."""
    words = ink.letter, ink.words
    return Content.styled(*words) if look.letters else Content.styled("■", ink.colour)


def mean_of(values: Array) -> float:
    """Return the mean of the values (N,) that are numbers; NaN where there are none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else math.nan
