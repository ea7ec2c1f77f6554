"""One bar of the variance of a corrected target: its contributions, largest at the top."""

from __future__ import annotations

from hilcell.report.budgets import Row, TargetBudget, target_rows
from hilcell.report.drawings.drawing import HAIR, INK, MUTED, apart, path, rectangle, svg, text

SHADES = ("#0b4a7d", "#3f76a6", "#7fa6c9", "#b4cbe0", "#d9e4ee", "#eef3f8")
WIDTH_MM, HEIGHT_MM, BAR_MM = 55.0, 90.0, 12.0


def variance_bar(budget: TargetBudget, simulated: bool) -> str:
    """Return the bar at the station where bounds are largest, "" where none are stated."""
    if budget.missing:
        return ""
    parts: list[str] = []
    top = 1.0
    shares = _shares(budget)
    tops: list[float] = []
    scale = (HEIGHT_MM - 2.0) / 100.0
    white_on = 2  # so many shades are dark
    least_mm = 5.0  # of a part that has its share written in it
    for shade, (_, percent, _) in zip(SHADES, shares, strict=False):
        high = percent * scale
        parts.append(rectangle(0.0, top, BAR_MM, high, shade, INK))
        if high >= least_mm:
            colour = "#fff" if len(tops) < white_on else INK
            middle = top + high / 2 + 1.0
            parts.append(text(BAR_MM / 2, middle, f"{percent:.1f} %", "middle", colour, bold=True))
        tops.append(top + high / 2)
        top += high
    pitch = 2.1  # of two-line labels, in labels
    places = [pitch * each for each in apart([each / pitch for each in tops])]
    below = min(0.0, HEIGHT_MM - 4.0 - places[-1])  # the last label ends inside
    for at, place, (name, percent, u_mm) in zip(tops, places, shares, strict=True):
        y = place + below
        parts.append(path([(BAR_MM, at), (BAR_MM + 2.5, y)], HAIR))
        parts.append(text(BAR_MM + 3.5, y, name, bold=True))
        parts.append(
            text(BAR_MM + 3.5, y + 3.4, f"u {u_mm:.4f} mm, {percent:.1f} %", "start", MUTED)
        )
    return svg(WIDTH_MM, HEIGHT_MM, "Shares of the variance", parts, simulated)


def _shares(budget: TargetBudget) -> list[tuple[str, float, float]]:
    """Return name, share in percent and u of the five largest contributions and of the others."""
    found: list[Row] = [each for each in target_rows(budget.in_use[budget.worst]) if each.percent]
    found.sort(key=lambda each: -each.percent)
    most = len(SHADES) - 1
    shown = [(each.source, each.percent, each.u_mm) for each in found[:most]]
    others = found[most:]
    if others:
        u_mm = sum(each.u_mm**2 for each in others) ** 0.5
        shown.append((f"{len(others)} others", sum(each.percent for each in others), u_mm))
    return shown
