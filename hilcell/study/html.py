"""The answers of a study as an HTML page, with pictures of front, main effects and coverage."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse.csgraph import connected_components

from hilcell import __version__
from hilcell.model.point import Sent
from hilcell.ports import Array
from hilcell.present.renderers import environment
from hilcell.report.drawings.drawing import shortened
from hilcell.report.drawings.figures import COLOURS, INK, MUTED, axes_grid, in_style, svg_of
from hilcell.sanitize import harmless
from hilcell.study.analysis import Answers, Design, Effect
from hilcell.study.case import RESULTS
from hilcell.study.study_file import Study
from hilcell.study.tables import Summary

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_DRAWN = 1000  # of the designs beside the front; a page of all takes minutes to draw
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
            errors = [each.true_mean if found.by_truth else each.mean for each in effects]
            means_mm = np.array([[each.mean, *each.ends] for each in errors])
            shares = np.array([[each.covered.mean, *each.covered.ends] for each in effects])
            words = [each.text() for each in errors]
            plots["effects_plot"] = _levels(
                "effects", effects, means_mm, words, _error(study, found)
            )
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
            front_caption=_caption(study, found),
            **summary.tables(),
            **plots,
        )
    )


def _error(study: Study, found: Answers) -> str:
    name = study.accuracy[:-3].removeprefix("true_")
    return f"{'true ' if found.by_truth else ''}{name} error, mm"


def _caption(study: Study, found: Answers) -> str:
    filled = "Filled: no other design is as good in everything and better in something."
    words = [filled, "Numbers: points of the table. Bars: 95 % interval of the mean over machines."]
    if not all(each.whole for each in found.designs):
        words.append("Crosses: not done on every machine, so not compared.")
    if len(found.designs) - len(found.front) > MOST_DRAWN:
        words.append(f"Others: at most {MOST_DRAWN} of {len(found.designs)}, evenly picked.")
    if study.question is not None:
        words.append("Dashed: the limit of the question.")
    return " ".join(words)


def _front(study: Study, found: Answers) -> str:
    """Draw accuracy over minutes, and over money where there is some, of all designs."""
    across: list[tuple[str, Callable[[Design], float]]] = [
        ("minutes of a calibration", lambda each: each.minutes)
    ]
    if study.has_costs:
        across.append((study.money, lambda each: each.point.cost))
    figure, axes = axes_grid(3.6, columns=len(across), sharey=True)
    beaten = [each for each in found.designs if not each.on_front]
    beaten = beaten[:: math.ceil(len(beaten) / MOST_DRAWN) or 1]
    groups = (
        ([each for each in beaten if not each.whole], MUTED, "x"),
        ([each for each in beaten if each.whole], MUTED, "o"),
        (found.front, BLUE, "o"),
    )
    for (name, of), ax in zip(across, axes[0], strict=True):
        if len(found.front) > 1 and not study.has_costs:
            places = ((of(each), each.deciding.mean) for each in found.front)
            ax.step(*zip(*places, strict=True), where="post", color=BLUE)
        for own, colour, marker in groups:
            values = [of(each) for each in own]
            ends_mm = np.array([each.deciding.ends for each in own]).reshape(-1, 2)
            face = BLUE if colour == BLUE else "white"
            means_mm = [each.deciding.mean for each in own]
            ax.vlines(values, *ends_mm.T, color=colour, linewidth=0.8)
            ax.plot(values, means_mm, marker, color=colour, markersize=4.0, markerfacecolor=face)
        if study.question is not None:
            ax.axhline(study.question.limit_mm, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
        ax.set_xlabel(name)
        ax.margins(x=0.08)
    axes[0, 0].set_ylim(bottom=0.0)
    axes[0, 0].set_ylabel(_error(study, found))
    if 0 < len(found.front) <= 20:
        for (_, of), ax in zip(across, axes[0], strict=True):
            _label(ax, found.front, beaten, of)
    return svg_of(figure, "front")


def _label(
    ax: Axes, front: Sequence[Design], beaten: Sequence[Design], of: Callable[[Design], float]
) -> None:
    """Write the numbers of points where they overprint no dot and no other number.

    Dots that touch have one label together. One that would be far from its dot may lie over dots of
    designs that are beaten.
    """
    height_pt, digit_pt, dot_pt, far_pt = 9.0, 5.2, 3.0, 40.0

    def places_pt(designs: Sequence[Design]) -> Array:
        at = np.array([(of(each), each.deciding.mean) for each in designs]).reshape(-1, 2)
        return np.asarray(ax.transData.transform(at)) * 72.0 / ax.figure.dpi

    places = places_pt(front)
    near = np.abs(places[:, None] - places).max(axis=2) < height_pt
    count, group = connected_components(near, directed=False)
    open_dots, taken = (
        [(x - dot_pt, y - dot_pt, x + dot_pt, y + dot_pt) for x, y in each.tolist()]
        for each in (places_pt(beaten), places)
    )
    right_pt = float(ax.bbox.x1) * 72.0 / ax.figure.dpi
    for n in range(count):
        own = np.flatnonzero(group == n).tolist()
        words = ", ".join(str(front[each].point.number) for each in own)
        top = max(own, key=lambda each: places[each, 1])
        (x, y), width_pt = places[top].tolist(), digit_pt * len(words)
        rights = [4.0, -4.0 - width_pt] if x + 4.0 + width_pt <= right_pt else [-4.0 - width_pt]
        for up, right in product(np.arange(4.0, 160.0, 3.0).tolist(), rights):
            box = (x + right, y + up, x + right + width_pt, y + up + height_pt)
            others = [*taken, *open_dots] if up < far_pt else taken
            if not any(_overlap(box, other) for other in others):
                break
        taken.append(box)
        ax.annotate(words, (of(front[top]), front[top].deciding.mean), (right, up),
                    textcoords="offset points", color=BLUE, weight="bold",
                    bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 0.4},
                    )  # fmt: skip


def _overlap(one: Sequence[float], two: Sequence[float]) -> bool:
    """Whether two boxes (left, bottom, right, top) overlap."""
    return one[0] < two[2] and two[0] < one[2] and one[1] < two[3] and two[1] < one[3]


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
