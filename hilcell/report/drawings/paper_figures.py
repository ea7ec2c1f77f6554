"""The paper's figures, redrawn from one run; a figure without data is left out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hilcell.calibration.errors import OTHERS, Errors, places, validation
from hilcell.calibration.frames import grid_pairs
from hilcell.clean import harmless
from hilcell.compensation.similarity import binned
from hilcell.journal.log import Log, positions_mm
from hilcell.model.point import HOLDS, SIDES, Sent
from hilcell.model.results import FramesRepeated, SurveyedRail, WithU
from hilcell.model.verdicts import ISO
from hilcell.ports import Array
from hilcell.report.drawings.svg import MUTED, axes_sheet, house_style, svg_of
from hilcell.report.facts import Facts
from hilcell.report.iso9283 import fig_attained, fig_poses

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = {Sent.BEFORE: "#c26a2e", Sent.IDW: "#8796a5", Sent.CHOSEN: "#12507b"}
MARKERS = {Sent.BEFORE: "o", Sent.IDW: "^", Sent.CHOSEN: "o"}


@dataclass(frozen=True, slots=True)
class Drawing:
    """One figure, ready for the page: ``svg`` is trusted, the words are not."""

    name: str
    title: str
    caption: str
    svg: str


Drawn = tuple["Figure", str]  # with the caption that belongs to it


def drawings(facts: Facts) -> list[Drawing]:
    """Return every figure that the run's data allow, in the order of a reader's questions."""
    found: list[tuple[str, str, Callable[[Facts], Drawn | None]]] = [
        (
            "targets",
            "Error at each target, station of the grid" + _of_paper(facts, " (Fig 12)"),
            fig_12,
        ),
        (
            "transferred",
            "Error at each target, other stations" + _of_paper(facts, " (Fig 13)"),
            fig_13,
        ),
        ("pose-test", "Pose accuracy and repeatability (ISO 9283)", fig_poses),
        ("attained", "Attained positions of each pose", fig_attained),
        ("similarity", "Similarity of errors" + _of_paper(facts, " (eq 8)"), fig_similarity),
        ("rail", "Position error of the rail, both ways" + _of_paper(facts, " (Fig 1)"), fig_1),
        ("slide", "Roll, pitch and yaw of the slide", fig_slide),
        (
            "frames",
            "Repeatability of base and station frames" + _of_paper(facts, " (Fig 8)"),
            fig_8,
        ),
        ("strip", "Repeatability of a station" + _of_paper(facts, " (Fig 10)"), fig_10),
    ]
    results = {"rail_survey", "frame_repeatability", ISO}
    shown = is_paper(facts) or results & facts.result.keys() or facts.log.select("repeat")
    if "world" not in facts.log.frames or not shown:
        return []  # and no library of figures is loaded
    drawn = []
    with house_style():
        for name, title, draw in found:
            figure = draw(facts)
            if figure is not None:
                drawn.append(_finished(facts, name, title, figure))
    return drawn


def _finished(facts: Facts, name: str, title: str, drawn: Drawn) -> Drawing:
    figure, caption = drawn
    if facts.inputs.simulated:
        figure.text(0.5, 0.5, "SIMULATION", ha="center", va="center", fontsize=34, rotation=18,
                    color=MUTED, alpha=0.13, weight="bold")  # fmt: skip
    return Drawing(name, title, caption, svg_of(figure, name))


def is_paper(facts: Facts) -> bool:
    """Whether a run repeats the paper: only its report speaks of the paper's figures."""
    return facts.inputs.procedure == "paper"


def _of_paper(facts: Facts, words: str) -> str:
    return words if is_paper(facts) else ""


def series_name(how: Sent, facts: Facts) -> str:
    """Return how a series of targets is called."""
    method = harmless(facts.log.method)
    chosen = f"after, {method}" if method else "after, chosen"
    return {
        Sent.BEFORE: "before",
        Sent.IDW: "after, IDW" + _of_paper(facts, " (paper)"),
        Sent.CHOSEN: chosen,
    }[how]


# -- errors at the targets ------------------------------------------------------------------------


def fig_12(facts: Facts) -> Drawn | None:
    """Draw the errors at the grid's station, target by target."""
    log = facts.log
    series = validation(log, [facts.cell.grid.station])
    paper = _of_paper(facts, "The paper: mean 1.2092 mm before, 0.1168 mm after (135).")
    return _targets(facts, series, paper)


def fig_13(facts: Facts) -> Drawn | None:
    """Draw the errors at the other stations, target by target, with transferred data."""
    stations = places(facts.cell).get(OTHERS) or list(places(facts.cell))[1:]
    series = validation(facts.log, stations)
    words = f"Stations {' and '.join(stations)}, corrected by data transferred to them. "
    paper = _of_paper(facts, "The paper: mean 1.2511 mm before, 0.1600 mm after (150).")
    return _targets(facts, series, words + paper)


def _targets(facts: Facts, series: Mapping[Sent, Errors], caption: str) -> Drawn | None:
    if not series or not is_paper(facts):
        return None
    figure, axes = axes_sheet(2.6)
    ax: Axes = axes[0, 0]
    for how, errors in series.items():
        _scatter(ax, how, errors.norms_mm, series_name(how, facts))
        mean_mm = errors.figures.mean
        ax.axhline(mean_mm, color=COLOURS[how], linewidth=0.8, linestyle=(0, (4, 2)))
        if how != Sent.IDW:  # it would lie on the other mean
            ax.text(
                1.008,
                mean_mm,
                f"{mean_mm:.3f}",
                color=COLOURS[how],
                va="center",
                fontsize=7.5,
                transform=ax.get_yaxis_transform(),
            )
    ax.set_xlim(0, max(len(errors) for errors in series.values()) + 1)
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel("target")
    ax.set_ylabel("3D error, mm")
    _legend_above(ax)
    return figure, "Dashed lines: means. " + caption


def _scatter(ax: Axes, how: Sent, y: Array, label: str) -> None:
    x = np.arange(1, len(y) + 1)
    face = "none" if how == Sent.BEFORE else COLOURS[how]
    ax.plot(x, y, linestyle="none", marker=MARKERS[how], markersize=3.0, markeredgewidth=0.8,
            markerfacecolor=face, markeredgecolor=COLOURS[how], label=label)  # fmt: skip


def _legend_above(ax: Axes) -> None:
    ax.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=4,
        borderaxespad=0.2,
        handlelength=1.4,
        handletextpad=0.5,
        columnspacing=1.2,
    )


# -- rail, frames, strip --------------------------------------------------------------------------


def fig_1(facts: Facts) -> Drawn | None:
    """Draw the rail's position error, forth and back."""
    survey = facts.part("rail_survey", SurveyedRail)
    if survey is None:
        return None
    figure, axes = axes_sheet(2.6)
    ax: Axes = axes[0, 0]
    for way, how in (("forth", Sent.CHOSEN), ("back", Sent.BEFORE)):
        nominal_mm, error_mm = np.array(survey.curve[way], dtype=float).reshape(-1, 2).T
        ax.plot(
            nominal_mm,
            error_mm,
            marker=MARKERS[how],
            markersize=2.8,
            color=COLOURS[how],
            markerfacecolor="none" if how == Sent.BEFORE else COLOURS[how],
            label=way,
        )
    ax.set_xlabel("nominal position on the rail, mm")
    ax.set_ylabel("position error, mm")
    _legend_above(ax)
    return figure, (
        f"Backlash {_with_u(survey.backlash_mm, 'mm')}; "
        f"scale {_with_u(survey.scale_ppm, 'ppm')}. "
        + _of_paper(facts, "The paper: error up to 0.5 mm, backlash about 0.2 mm.")
    )


def _with_u(figure: WithU, unit: str) -> str:
    return f"{figure.value:.4g} {unit} (u = {figure.u:.2g} {unit})"


def fig_slide(facts: Facts) -> Drawn | None:
    """Draw how the slide turns along the rail."""
    survey = facts.part("rail_survey", SurveyedRail)
    if survey is None:
        return None
    figure, axes = axes_sheet(2.2)
    ax: Axes = axes[0, 0]
    nominal_mm = [stop[0] for stop in survey.curve["forth"]]
    turns = (("roll", Sent.IDW), ("pitch", Sent.BEFORE), ("yaw", Sent.CHOSEN))
    for (name, how), style in zip(turns, ("-", "--", ":"), strict=True):
        ax.plot(nominal_mm, survey.angles_mrad[name], style, color=COLOURS[how], label=name)
    ax.set_xlabel("nominal position on the rail, mm")
    ax.set_ylabel("angle, mrad")
    _legend_above(ax)
    off_mm = survey.straightness_mm
    return figure, (
        "Forth, against the first stop, from the slide's nests. Straightness of the path, peak to "
        f"peak: {off_mm['horizontal']:.3f} mm horizontal, {off_mm['vertical']:.3f} mm vertical."
    )


def fig_similarity(facts: Facts) -> Drawn | None:
    """Draw how errors part with joint and with Cartesian distance, over all pairs of vertices."""
    if (
        not is_paper(facts)
        or not {"base", "fit"} <= facts.log.frames.keys() | facts.log.verdicts.keys()
    ):
        return None
    pairs = grid_pairs(facts.log)
    count = len(pairs.difference_mm)
    # each dot is an element of the page: a picture of them its policy would block
    pairs_drawn = 500
    every = max(1, count // pairs_drawn)
    figure, axes = axes_sheet(2.6, 1, 2, sharey=True)
    for ax, distance, name in (
        (axes[0, 0], np.degrees(pairs.joint_rad), "distance of joints, deg"),
        (axes[0, 1], pairs.cartesian_mm, "distance of vertices, mm"),
    ):
        ax.plot(distance[::every], pairs.difference_mm[::every], ".", color=MUTED, alpha=0.35,
                markersize=2, label="a pair of vertices")  # fmt: skip
        means = binned(distance, pairs.difference_mm, np.linspace(0.0, distance.max(), 13))
        ax.plot(means.centre, means.difference_mm, color=COLOURS[Sent.CHOSEN], label="mean")
        ax.set_xlabel(name)
    axes[0, 0].set_ylabel("difference of errors, mm")
    _legend_above(axes[0, -1])
    return figure, (
        "The similarity of eq 8 is one over this difference: near joints have like errors. Over "
        "one orientation of the tool the distance of the vertices says the same. Drawn are "
        f"{len(range(0, count, every))} of {count} pairs; the mean is of all."
    )


def fig_8(facts: Facts) -> Drawn | None:
    """Draw how far slide points came out from where the reference's frames have them."""
    found = facts.part("frame_repeatability", FramesRepeated)
    if found is None:
        return None
    stations = list(found.base)
    figure, axes = axes_sheet(2.5, 1, len(stations), sharey=True)
    for ax, station in zip(axes[0], stations, strict=True):
        for kind, off_mm, how, shift in (
            ("base", found.base[station], Sent.BEFORE, -0.2),
            ("station", found.station[station], Sent.CHOSEN, 0.2),
        ):
            ax.bar(
                np.arange(1, len(off_mm) + 1) + shift,
                off_mm,
                0.38,
                color=COLOURS[how],
                label=f"{kind} frame",
            )
        ax.set_title(f"station {station}")
        ax.set_xlabel("slide point")
        ax.set_xticks(np.arange(1, len(found.base[station]) + 1))
        ax.grid(visible=False, axis="x")
    axes[0, 0].set_ylabel("deviation, mm")
    _legend_above(axes[0, -1])
    low, high = found.ratio_interval
    return figure, (
        f"Against station {facts.cell.grid.station}. The station frame repeats "
        f"{found.ratio:.1f} times better, interval {low:.1f} to {high:.1f}. "
        + _of_paper(facts, "The paper: about 4 times.")
    )


def fig_10(facts: Facts) -> Drawn | None:
    """Draw where the slide stood after each approach, by drive alone and held by the strip."""
    held = {"plain": Sent.BEFORE, "strip": Sent.CHOSEN}  # drawn in the colours of these
    ways = [way for way in SIDES if any(len(along_rail_mm(facts.log, how, way)) for how in held)]
    if not ways:
        return None
    figure, axes = axes_sheet(2.6, 1, len(ways), sharey=True)
    ranges = []
    for ax, way in zip(axes[0], ways, strict=True):
        for name, how in held.items():
            off_mm, label = along_rail_mm(facts.log, name, way), HOLDS[name]
            if len(off_mm):
                off_mm = off_mm - off_mm.mean()
                ranges.append(f"{SIDES[way]}, {label} {np.ptp(off_mm):.4f} mm")
                _scatter(ax, how, off_mm, label)
                ax.plot(np.arange(1, len(off_mm) + 1), off_mm, color=COLOURS[how], linewidth=0.7)
        ax.set_title(SIDES[way])
        ax.set_xlabel("approach")
        ax.set_xticks(range(1, len(ax.lines[0].get_ydata()) + 1, 2))
    axes[0, 0].set_ylabel("deviation along the rail, mm")
    _legend_above(axes[0, -1])
    return figure, (
        f"Deviation from each series' mean. Ranges: {'; '.join(ranges)}. "
        + _of_paper(facts, "The paper: at most 0.035 mm with the strip, backlash 0.2 mm without.")
    )


def along_rail_mm(log: Log, how: str, way: str) -> Array:
    """Return positions (N,) along the rail's nominal direction of repeated approaches."""
    raw_mm = positions_mm(log.select("repeat", how=how, way=way))
    along: Array = raw_mm @ log.matrix("world")[:3, :3].T @ np.array(log.cell.layout.rail_direction)
    return along
