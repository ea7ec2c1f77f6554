"""Error vectors of the targets in {W}, from three sides, before and after the correction."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hilcell.calibration.errors import Errors, grid_errors, validation
from hilcell.model.point import Sent
from hilcell.ports import Array
from hilcell.report.drawings.drawing import (
    AFTER,
    BEFORE,
    HAIR,
    INK,
    MUTED,
    circle,
    path,
    rectangle,
    shortened,
    svg,
    text,
)
from hilcell.report.facts import Facts

PANEL_MM, GAP_MM, LEFT_MM, TOP_MM, BOTTOM_MM = 31.0, 10.0, 9.0, 8.0, 8.0
WIDTH_MM = LEFT_MM + 3 * PANEL_MM + 2 * GAP_MM + 1.0


def vectors(facts: Facts) -> str:
    """Return three panels before and three after; "" where no target was measured."""
    rows = _rows(facts)
    if not rows:
        return ""
    high = TOP_MM + PANEL_MM + BOTTOM_MM
    parts: list[str] = []
    for n, (name, errors, colour) in enumerate(rows):
        parts += _row(name, errors, colour, n * high)
    return svg(WIDTH_MM, high * len(rows), "Error vectors in three views", parts,
               facts.inputs.simulated)  # fmt: skip


def _rows(facts: Facts) -> list[tuple[str, Errors, str]]:
    station = facts.cell.grid.station
    series = validation(facts.log, [station])
    name_mm = 60.0  # of a station, at most
    shown = shortened(station, name_mm)
    names = ((Sent.BEFORE, "before", BEFORE), (Sent.CHOSEN, "after", AFTER))
    rows = [
        (f"{shown}, {name}", series[how], colour) for how, name, colour in names if how in series
    ]
    grid = grid_errors(facts.log)
    return rows or ([(f"{shown}, grid", grid, BEFORE)] if grid is not None else [])


def _row(name: str, errors: Errors, colour: str, top: float) -> Iterator[str]:
    low, span = _cube(errors)
    scale = PANEL_MM / span
    share = 0.1  # of the panel, that the largest error is drawn as, at most
    factor = round_down(share * span / max(errors.figures.max, 1e-6))
    title = f"{name}, {factor:g} times enlarged"
    yield text(0.0, top + 3.0, title, bold=True, most_mm=WIDTH_MM)
    views = (("from above", 0, 1), ("from the side", 1, 2), ("from the front", 0, 2))
    axes = "xyz"
    for n, (seen, across, up) in enumerate(views):
        left = LEFT_MM + n * (PANEL_MM + GAP_MM)
        box = top + TOP_MM
        yield rectangle(left, box, PANEL_MM, PANEL_MM, "none", HAIR)
        yield text(left + PANEL_MM / 2, box - 1.0, seen, "middle", MUTED)
        yield text(left - 1.0, box + PANEL_MM / 2, axes[up], "end", MUTED)
        for value, y in ((low[up] + span, box + 3.0), (low[up], box + PANEL_MM)):
            yield text(left - 1.0, y, f"{value:.0f}", "end", MUTED)
        below = box + PANEL_MM + 3.4
        yield text(left, below, f"{low[across]:.0f}", "start", MUTED)
        yield text(left + PANEL_MM / 2, below, axes[across], "middle", MUTED)
        yield text(left + PANEL_MM, below, f"{low[across] + span:.0f}", "end", MUTED)
        corner = np.array([low[across], low[up]])
        nominal = (errors.nominal_mm[:, (across, up)] - corner) * scale
        foot = np.array([left, box + PANEL_MM]) + nominal * (1, -1)
        end = foot + errors.error_mm[:, (across, up)] * factor * scale * (1, -1)
        gap = np.full_like(foot, np.nan)
        yield path(np.stack([foot, end, gap], axis=1).reshape(-1, 2), colour, 0.35)
        yield "".join(circle(x, y, 0.3, INK, "none") for x, y in foot)
    bar_mm = round_down(max(errors.figures.max, 1e-6))
    y, x = top + TOP_MM + PANEL_MM + 6.2, LEFT_MM
    yield path([(x, y), (x + bar_mm * factor * scale, y)], colour, 0.8)
    yield text(x + bar_mm * factor * scale + 1.0, y + 1.0, f"error {bar_mm:g} mm")


def _cube(errors: Errors) -> tuple[Array, float]:
    """Return the low corner (3,) and the side of the cube that holds every target with a margin."""
    low, high = errors.nominal_mm.min(axis=0), errors.nominal_mm.max(axis=0)
    span = 1.3 * (float((high - low).max()) or 1000.0)
    return (low + high) / 2 - span / 2, span


def round_down(value: float) -> float:
    """Return the largest 1, 2 or 5 times a power of ten that is not above ``value``."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)) * power)
