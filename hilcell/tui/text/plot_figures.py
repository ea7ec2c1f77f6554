"""The figures beside a plot: a table of its series, of stations and of the worst, and words."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
from textual.content import Content

from hilcell.calibration.iso9283 import AP, RP
from hilcell.geometry.statistics import figures_of, repeatability_mm
from hilcell.journal.curve_record import URAD
from hilcell.journal.log import Log
from hilcell.journal.ways_sent import Sent
from hilcell.ports import Array
from hilcell.tui.layout import section
from hilcell.tui.plots.canvas import Ink
from hilcell.tui.plots.draw import Look, Plot
from hilcell.tui.text.plots import (
    PLACES,
    Errors3D,
    Measured,
    mean_of,
)

WIDTH = 31
NAME, NUMBER = 12, 6
MOST_WORST = 5
NEAR = 0.8  # of the limit
SHORT = {"paper method": "paper"}
Lines = list[Content]


def row(name: str, values: Sequence[float | None], style: str = "", *, strong: int = -1) -> Content:
    """Return a name and numbers in their columns; ``strong`` is the number of a bold one."""
    parts = [(f"{name:<{NAME}}", style)]
    for n, value in enumerate(values):
        text = "" if value is None or not np.isfinite(value) else f"{round(value, 3) + 0.0:.3f}"
        parts.append((f"{text:>{NUMBER}}"[-NUMBER:], f"bold {style}" if n == strong else style))
    return Content.assemble(*parts)


def key(plot: Plot, look: Look) -> Content:
    """Return the names of a plot's series with their marks, in one line."""
    parts: list[Content | tuple[str, str] | str] = []
    for series in plot.series:
        name = SHORT.get(series.name, series.name)
        parts += ["  ", mark_of(look, series.ink), (f" {name}", "$label")]
    return Content.assemble(*parts)


def marked(look: Look, ink: Ink, line: Content) -> Content:
    """Return a row with its series' mark in front of the name."""
    return Content.assemble(mark_of(look, ink), " ", line[: NAME - 2], line[NAME:])


def mark_of(look: Look, ink: Ink) -> Content:
    """Return the mark of a series in a key."""
    return (
        Content.styled(ink.letter, ink.words) if look.letters else Content.styled("■", ink.colour)
    )


def error_figures(of: Measured, pick: str, plot: Plot, look: Look) -> Lines:
    """Return mean, 95 % and maximum of |e| by series and station, the worst, and words."""
    log, found = of.log, of.errors.at(pick)
    lines = [_heading("figures"), _heads("mean", "95 %", "max")]
    for series in plot.series:
        short = SHORT.get(series.name, series.name)
        how = next(way for way in Sent if way.text == series.name)
        numbers = row(short, _three(found.by_how[how]), strong=0 if how == Sent.CHOSEN else -1)
        lines.append(marked(look, series.ink, numbers))
    floor = floor_mm(log)
    if floor:
        lines.append(row("  floor", (floor.get("mean"), floor.get("p95")), "$label"))
    if plot.limits:
        table = log.cell.validation
        lines.append(row("  limit", (table.mean_tolerance_mm, None, table.max_tolerance_mm)))
    if Sent.CHOSEN in found.by_how:
        lines += _by_station(of.errors) + _worst(found) + _words(log, found, floor)
    return lines


def floor_mm(log: Log) -> Mapping[str, float]:
    """Return mean and p95 that robot and tracker leave by themselves, of a run that has ended."""
    places = (log.end or {}).get("result", {}).get("validation", {})
    place = places.get(log.cell.grid.station, {}) if isinstance(places, dict) else {}
    floor = place.get("floor", {}) if isinstance(place, dict) else {}
    return {name: each for name, each in floor.items() if isinstance(each, float)}


def _heads(*names: str, unit: str = "mm") -> Content:
    return Content.styled(f"{unit:<{NAME}}" + "".join(f"{n:>{NUMBER}}" for n in names), "$label")


def _three(values: Array) -> tuple[float, ...]:
    known = values[np.isfinite(values)]
    return (*figures_of(known),) if len(known) else ()


def _by_station(errors: Errors3D) -> Lines:
    if len(errors.stations) < 2:
        return []
    lines = [Content(""), _heading("corrected, by station")]
    by_station = {name: errors.at(name).by_how for name in errors.stations}
    lines += [
        row(name, _three(by[Sent.CHOSEN])) for name, by in by_station.items() if Sent.CHOSEN in by
    ]
    return lines


def _worst(found: Errors3D) -> Lines:
    errors = np.nan_to_num(found.by_how[Sent.CHOSEN], nan=-1.0)
    lines = [Content(""), _heading("worst targets")]
    for at in np.argsort(-errors, kind="stable")[:MOST_WORST].tolist():
        if errors[at] >= 0:
            station, number = found.targets[at]
            name = f"target {number + 1}"
            value = f"{errors[at]:>{NUMBER}.3f}"
            lines.append(
                Content.assemble(f"{name:<{NAME}}", (f"{station:<{NAME}}", "$label"), value)
            )
    return lines


def _words(log: Log, found: Errors3D, floor: Mapping[str, float]) -> Lines:
    limit_mm = log.cell.validation.max_tolerance_mm
    errors = found.by_how[Sent.CHOSEN][np.isfinite(found.by_how[Sent.CHOSEN])]
    over = int(np.sum(~(errors <= limit_mm)))
    near = int(np.sum(errors > NEAR * limit_mm)) - over
    said = "No target near its limit."
    if over or near:
        said = f"{over} over the limit, {near} within {100 * (1 - NEAR):.0f} % of it."
    sentences = [said, _of_means(log, found)]
    mean_mm = mean_of(errors)
    if Sent.BEFORE in found.by_how and mean_mm > 0:
        same = found.by_how[Sent.BEFORE][np.isfinite(found.by_how[Sent.CHOSEN])]
        sentences.append(f"Mean {mean_of(same) / mean_mm:.1f} times smaller.")
    if floor.get("mean", 0) > 0:
        times = mean_mm / floor["mean"]
        sentences.append(
            f"Corrected is {times:.1f} times the floor that the robot and tracker leave by "
            "themselves."
        )
    wrapped = [line for each in sentences for line in textwrap.wrap(each, WIDTH)]
    tells = [Content.styled(line, "$label") for line in wrapped]
    return [Content(""), _heading("what it tells"), *tells]


def _of_means(log: Log, found: Errors3D) -> str:
    """Return how the worst station's mean is to its limit."""
    limit_mm = log.cell.validation.mean_tolerance_mm
    means_mm = {
        name: mean_of(found.at(name).by_how[Sent.CHOSEN])
        for name in found.stations
        if Sent.CHOSEN in found.at(name).by_how
    }
    worst = max(means_mm, key=lambda name: means_mm[name])
    mean_mm = means_mm[worst]
    if not mean_mm <= limit_mm:
        return f"Mean at {worst} {mean_mm:.3f}: over its limit {limit_mm:.3f}."
    if mean_mm > NEAR * limit_mm:
        return f"Mean at {worst} {mean_mm:.3f}: near its limit {limit_mm:.3f}."
    return "No station's mean near its limit."


def repeat_figures(of: Measured, pick: str, plot: Plot, look: Look) -> Lines:
    """Return mean, RP (ISO 9283) and maximum of the distances from the mean, by place."""
    lines = [_heading("figures"), _heads("mean", "RP", "max")]
    inks = {series.name: series.ink for series in plot.series}
    for name, distances_mm in of.visits_mm.items():
        rp_mm = repeatability_mm(distances_mm) if len(distances_mm) > 1 else None
        numbers = (float(distances_mm.mean()), rp_mm, float(distances_mm.max()))
        lines.append(marked(look, inks.get(name, PLACES[0]), row(name, numbers)))
    words = f"RP: mean + 3 s of the distances from the mean (ISO 9283, {RP.clause})."
    return [*lines, Content(""), *_grey(words)]


def pose_figures(of: Measured, pick: str, plot: Plot, look: Look) -> Lines:
    """Return AP_p and RP_l of each pose, and the limits that are stated."""
    lines = [_heading("figures"), _heads("AP_p", "RP_l", "n")]
    for name, figures in of.figures_by_pose.items():
        visits = f"{len(of.poses[name].error_mm):>{NUMBER}}"
        lines.append(row(name, figures).append(Content.styled(visits, "$label")))
    table = of.log.cell.iso9283
    stated = (table.ap_limit_mm, table.rp_limit_mm)
    if any(each is not None for each in stated):
        lines.append(row("limit", stated))
        words = ""
    else:
        words = "No limits are stated (iso9283.ap_limit_mm, iso9283.rp_limit_mm). "
    words += f"AP_p: from the commanded place to the visits' mean (ISO 9283, {AP.clause})."
    return [*lines, Content(""), *_grey(words)]


def recheck_figures(of: Measured, pick: str, plot: Plot, look: Look) -> Lines:
    """Return |e| now and its predicted bound, mean and largest, and the worst targets."""
    now_mm, bounds_mm = of.rechecked_mm
    lines = [_heading("figures"), _heads("mean", "95 %", "max")]
    lines += [marked(look, each.ink, row(each.name, _three(each.y))) for each in plot.series]
    if not len(bounds_mm):
        return [*lines, Content(""), *_grey("The calibration predicts no bound of these targets.")]
    lines += [Content(""), _heading("worst targets"), _heads("bound", "", "now")]
    for n in np.argsort(-now_mm, kind="stable")[:MOST_WORST].tolist():
        lines.append(row(f"target {n + 1}", (float(bounds_mm[n]), None, float(now_mm[n]))))
    over = int(np.sum(~(now_mm <= bounds_mm)))
    words = f"{over} of {len(now_mm)} targets over their bound; 95 % are expected below it."
    return [*lines, Content(""), *_grey(words)]


def strip_figures(of: Measured, pick: str, plot: Plot, look: Look) -> Lines:
    """Return mean and largest of the strip's residual, by station, and its limit."""
    lines = [_heading("figures"), _heads("mean", "", "max")]
    for name, values in of.strip_mm.items():
        lines.append(row(name, (float(values.mean()), None, float(np.abs(values).max()))))
    rail = of.log.cell.rail
    lines.append(row("approached", (None, None, rail.strip_tolerance_mm)))
    lines.append(row("held within", (None, None, rail.held_within_mm)))
    words = (
        "max: largest distance from the station, either way. An approach ends within the "
        "tolerance; a slide at rest may read up to twice as far off."
    )
    return [*lines, Content(""), *_grey(words)]


def sweep_figures(of: Measured, pick: str, plot: Plot, look: Look) -> Lines:
    """Return the gear lines of every swept axis."""
    lines = [
        _heading("gear lines"),
        Content.styled("axis   cycles/rev.   size µrad", "$label"),
    ]
    for name in of.swept:
        record = of.log.curves[int(name[1:])]
        style = "bold" if name == (pick or of.swept[0]) else "$label"
        sizes = (record.amplitudes_rad * URAD).tolist()
        lines += [
            Content.styled(f"{name:<4}{cycles:>14.1f}{size:>12.1f}", style)
            for cycles, size in zip(record.cycles, sizes, strict=True)
        ]
        if not record.holds:
            lines += _grey(f"{name} not used: {record.reason}")
        elif not record.cycles:
            lines.append(Content.styled(f"{name:<4}  none", style))
    words = "A line is an error that comes back so often in one turn of the joint."
    return [*lines, Content(""), *_grey(words)]


def _heading(title: str) -> Content:
    return section(title).lines(WIDTH)[0]


def _grey(words: str) -> Lines:
    return [Content.styled(line, "$label") for line in textwrap.wrap(words, WIDTH)]


FIGURES = {
    "each target": error_figures,
    "sorted": error_figures,
    "repeatability": repeat_figures,
    "strip": strip_figures,
    "pose accuracy": pose_figures,
    "re-check": recheck_figures,
    "sweeps": sweep_figures,
}
