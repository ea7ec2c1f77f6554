"""The answers of a study as an HTML page, with pictures of front, main effects and coverage."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hilcell import __version__
from hilcell.model.point import Sent
from hilcell.ports import Array
from hilcell.present.renderers import environment
from hilcell.report.drawings.drawing import shortened
from hilcell.report.drawings.figures import COLOURS, INK, MUTED, axes_grid, in_style, svg_of
from hilcell.sanitize import harmless
from hilcell.study.analysis import Answers, Effect
from hilcell.study.case import RESULTS
from hilcell.study.study_file import Study
from hilcell.study.tables import Summary

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BLUE = COLOURS[Sent.CHOSEN]


def page(summary: Summary) -> str:
    """Return the page, the same from the same rows."""
    study, found = summary.study, summary.found
    effects = [each for each in found.effects if math.isfinite(each.mean.mean)]
    plots = dict.fromkeys(("front_plot", "effects_plot", "coverage_plot"), "")
    with in_style():
        if found.designs:
            plots["front_plot"] = _front(study, found)
        if effects:
            means_mm = np.array([[each.mean.mean, *each.mean.ends] for each in effects])
            shares = np.array([[each.covered.mean, *each.covered.ends] for each in effects])
            words = [each.mean.text() for each in effects]
            plots["effects_plot"] = _levels("effects", effects, means_mm, words, _error(study))
            words = [each.covered.text() for each in effects]
            name = "targets within their 95 % bound, %"
            plots["coverage_plot"] = _levels("covered", effects, 100.0 * shares, words, name, 95.0)
    return (
        environment("hilcell.study", "hilcell.report")
        .get_template("study.html.j2")
        .render(
            study=study,
            version=__version__,
            counts=summary.counts(),
            meaning=RESULTS[study.accuracy][0],
            settings=[f"{key} = {value}" for key, value in study.settings.items()],
            **summary.tables(),
            **plots,
        )
    )


def _error(study: Study) -> str:
    return f"{study.accuracy[:-3]} error, mm"


def _front(study: Study, found: Answers) -> str:
    """Draw accuracy over minutes of all designs, the front as steps."""
    figure, axes = axes_grid(3.6)
    ax: Axes = axes[0, 0]
    if len(found.front) > 1 and not study.has_costs:
        places = ((each.minutes, each.accuracy.mean) for each in found.front)
        ax.step(*zip(*places, strict=True), where="post", color=BLUE)
    for on_front, colour, face in ((False, MUTED, "white"), (True, BLUE, BLUE)):
        own = [each for each in found.designs if each.on_front is on_front]
        minutes = [each.minutes for each in own]
        lows_mm, highs_mm = np.array([each.accuracy.ends for each in own]).reshape(-1, 2).T
        ax.vlines(minutes, lows_mm, highs_mm, color=colour, linewidth=0.8)
        ax.plot(minutes, [each.accuracy.mean for each in own], "o", color=colour, markersize=4.0,
                markerfacecolor=face)  # fmt: skip
    for each in found.front if len(found.front) <= 20 else ():
        ax.annotate(str(each.point.number), (each.minutes, each.accuracy.mean), (4.0, 4.0),
                    textcoords="offset points", color=BLUE, weight="bold")  # fmt: skip
    ax.set_ylim(bottom=0.0)
    ax.set(xlabel="minutes of a calibration", ylabel=_error(study))
    return svg_of(figure, "front")


def _levels(
    figure_name: str,
    effects: Sequence[Effect],
    values: Array,
    words: Sequence[str],
    name: str,
    line: float = math.nan,
) -> str:
    """Draw a value of each level with its interval (N, 3), in words at the right."""
    titles = [each.factor.title for each in effects]
    first = [n == titles.index(title) for n, title in enumerate(titles)]
    heights = np.arange(len(titles)) + 0.5 * np.cumsum(first)
    figure, axes = axes_grid(0.8 + 0.2 * float(heights[-1]))
    left, right, column_mm = 0.4, 0.84, 34.0  # shares of the width; of factors, and of levels
    figure.subplots_adjust(left=left, right=right)
    ax: Axes = axes[0, 0]
    means, lows, highs = values.T
    ax.hlines(heights, lows, highs, color=BLUE)
    ax.plot(means, heights, "o", color=BLUE, markersize=4.0)
    if math.isfinite(line):
        ax.axvline(line, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
    beside = ax.get_yaxis_transform()
    for n, y in enumerate(heights):
        ax.text(1.02, y, words[n], color=BLUE, va="center", transform=beside)
        if first[n]:
            ax.text(-left / (right - left), y, shortened(titles[n], column_mm), va="center",
                    weight="bold", transform=beside)  # fmt: skip
    ax.set_yticks(heights, [shortened(harmless(each.word), column_mm) for each in effects])
    ax.tick_params(axis="y", length=0.0)
    ax.grid(visible=False, axis="y")
    ax.invert_yaxis()
    ax.set_xlabel(f"{name}; bars: 95 % interval over machines")
    return svg_of(figure, figure_name)
