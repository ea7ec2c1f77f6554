"""Figures of measurements drawn by matplotlib, and their SVG inside a page.

They are of rail, frames and strip, and of the pose test of ISO 9283; a procedure may add its own.
A figure without data is left out. The SVG is small and the same every time. Figures of one page
share one space of ids, so every id gets its figure's name.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

import numpy as np

from hilcell.calibration.iso9283 import CORNERS, CYCLE, PLANE, Cube, Pose, attained_positions
from hilcell.geometry.statistics import from_mean_mm
from hilcell.journal.log import Log, positions_mm
from hilcell.model.point import HOLDS, SIDES, Sent
from hilcell.model.results import FramesRepeated, SurveyedRail, WithU
from hilcell.model.verdicts import AP, ISO, RP
from hilcell.ports import Array
from hilcell.report.facts import Facts
from hilcell.report.iso9283 import PoseReport, is_pose_test

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, MUTED = "#1d2733", "#5d6975"
COLOURS = {Sent.BEFORE: "#c26a2e", Sent.IDW: "#8796a5", Sent.CHOSEN: "#12507b"}
MARKERS = {Sent.BEFORE: "o", Sent.IDW: "^", Sent.CHOSEN: "o"}
POSE_TEST = ("pose-test", "attained")  # figures of ISO 9283


@dataclass(frozen=True, slots=True)
class Drawing:
    """One figure, ready for the page: ``svg`` is trusted, the words are not."""

    name: str
    title: str
    caption: str
    svg: str


Drawn = tuple["Figure", str]  # with the caption that belongs to it
NamedFigure = tuple[str, str, Callable[[], Drawn | None]]  # name, title, and how it is drawn


def drawings(facts: Facts) -> list[Drawing]:
    """Return every figure that the run's data allow, in the order of a reader's questions."""
    of, own = Figures(facts), list[NamedFigure]()
    if facts.procedure.figures:
        own = resolve_name(facts.procedure.figures)(facts).listed()
    figures: list[tuple[str, str, str, Callable[[], Drawn | None]]] = [
        *((name, title, "", draw) for name, title, draw in own),
        ("pose-test", "Pose accuracy and repeatability (ISO 9283)", "", of.poses),
        ("attained", "Attained positions of each pose", "", of.attained_positions),
        ("rail", "Position error of the rail, both directions", " (Fig 1)", of.rail),
        ("slide", "Roll, pitch and yaw of the slide", "", of.slide),
        ("frames", "Repeatability of base and station frames", " (Fig 8)", of.frames),
        ("strip", "Repeatability of a station", " (Fig 10)", of.strip),
    ]
    results = {"rail_survey", "frame_repeatability", ISO}
    shown = own or results & facts.result.keys() or facts.log.select("repeat")
    if "world" not in facts.log.frames or not shown:
        return []  # and no library of figures is loaded
    drawn = []
    with in_style():
        for name, title, in_paper, draw in figures:
            if (made := draw()) is None:
                continue
            figure, caption = made
            if facts.inputs.simulated:
                figure.text(0.5, 0.5, "SIMULATION", ha="center", va="center", fontsize=34,
                            rotation=18, color=MUTED, alpha=0.13, weight="bold")  # fmt: skip
            shown_title = title + facts.of_paper(in_paper)
            drawn.append(Drawing(name, shown_title, caption, svg_of(figure, name)))
    return drawn


@contextmanager
def in_style() -> Iterator[None]:
    """Draw as in a report, whatever the user's own style is."""
    import matplotlib

    with warnings.catch_warnings(), matplotlib.rc_context():
        warnings.filterwarnings("ignore", "Glyph")  # text stays text: the reader has the fonts
        matplotlib.rcdefaults()
        matplotlib.rc_file(Path(__file__).with_suffix(".mplstyle"), use_default_template=False)
        yield


def scatter(ax: Axes, how: Sent, y: Array, label: str) -> None:
    x = np.arange(1, len(y) + 1)
    face = "none" if how == Sent.BEFORE else COLOURS[how]
    ax.plot(x, y, linestyle="none", marker=MARKERS[how], markersize=3.0, markeredgewidth=0.8,
            markerfacecolor=face, markeredgecolor=COLOURS[how], label=label)  # fmt: skip


def legend_above(ax: Axes) -> None:
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, borderaxespad=0.2,
              handlelength=1.4, handletextpad=0.5, columnspacing=1.2)  # fmt: skip


# -- rail, frames, strip --------------------------------------------------------------------------


def _with_u(figure: WithU, unit: str) -> str:
    return f"{figure.value:.4g} {unit} (u = {figure.u:.2g} {unit})"


def along_rail_mm(log: Log, how: str, way: str) -> Array:
    """Return positions (N,) along the rail's nominal direction of repeated approaches."""
    raw_mm = positions_mm(log.select("repeat", how=how, direction=way))
    along: Array = raw_mm @ log.matrix("world")[:3, :3].T @ np.array(log.cell.layout.rail_direction)
    return along


# -- the pose test of ISO 9283 ---------------------------------------------------------------------


def _test_cube(ax: Axes, cube: Cube, poses: dict[str, Pose]) -> None:
    blue = COLOURS[Sent.CHOSEN]
    half_mm, centre = cube.side_mm / 2, np.array(cube.centre_mm)
    axonometric = np.array([[-0.45, 0.9, 0.0], [-0.4, -0.18, 0.9]])  # {B}'s x, y, z on paper
    corners = {name: axonometric @ (np.array(at) * half_mm) for name, at in CORNERS.items()}
    edges = [(n, n % 4 + 1) for n in (1, 2, 3, 4)]  # of the top; others lie below and between
    for one, other in edges:
        for a, b in ((one, other), (one + 4, other + 4), (one, one + 4)):
            ends = np.array([corners[f"C{a}"], corners[f"C{b}"]])
            ax.plot(*ends.T, color=MUTED, linewidth=0.7)
    ax.fill(*np.array([corners[name] for name in PLANE]).T, color="#d3e0ec", alpha=0.7, zorder=0)
    for name, at in corners.items():
        x, y = 1.14 * at
        ax.text(x, y, name, ha="center", va="center", fontsize=6.5, color=MUTED)
    places = {
        name: axonometric @ (np.array(each.commanded_mm) - centre) for name, each in poses.items()
    }
    for before, after in zip((CYCLE[-1], *CYCLE), CYCLE, strict=False):
        ax.annotate(
            "", tuple(places[after]), tuple(places[before]),
            arrowprops={"arrowstyle": "->", "color": blue, "linewidth": 0.8, "shrinkB": 3.0},
        )  # fmt: skip
    for name, at in places.items():
        ax.plot(*at, "o", color=blue, markersize=3.5)
        ax.text(at[0], at[1] + 0.12 * half_mm, name, ha="center", fontsize=7.5, weight="bold")
    ax.set_aspect("equal")
    ax.margins(0.14)
    ax.set_axis_off()
    ax.set_title("Test cube", loc="left")


# -- sheets of axes, and their SVG -----------------------------------------------------------------


def axes_grid(height_in: float, rows: int = 1, columns: int = 1, **more: Any) -> tuple[Figure, Any]:
    """Return a figure whose axes stand at the same places in every report."""
    from matplotlib.figure import Figure

    width_in = 7.1  # the printable width of A4
    figure = Figure(figsize=(width_in, height_in))
    axes = figure.subplots(rows, columns, squeeze=False, **more)
    figure.subplots_adjust(
        left=0.64 / width_in, right=1 - 0.42 / width_in,
        bottom=0.42 / height_in, top=1 - 0.28 / height_in,
        wspace=0.34 if columns > 2 else 0.1, hspace=0.36,
    )  # fmt: skip
    return figure, axes


def svg_of(figure: Figure, name: str) -> str:
    """Return the figure as an ``svg`` element, without parts that no page needs.

    Its ids begin with ``name``; 0.01 pt is finer than any printer.
    """
    file = io.StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None})
    text = file.getvalue()
    dropped = r"<metadata>.*?</metadata>|<!--.*?-->|\n\s*"
    svg = re.sub(dropped, " ", text[text.index("<svg") :], flags=re.DOTALL)
    link = re.compile(r'(url\(#|href="#)([^")]+)')
    linked = {match[1] for match in link.findall(svg)}

    def one_id(match: re.Match[str]) -> str:
        return f' id="{name}-{match[1]}"' if match[1] in linked else ""

    id_of, long_number = re.compile(r' id="([^"]+)"'), re.compile(r"-?\d+\.\d{3,}")

    def one_tag(match: re.Match[str]) -> str:
        tag = id_of.sub(one_id, match[0])
        tag = link.sub(rf"\g<1>{name}-\g<2>", tag).replace("xlink:href", "href")
        tag = re.sub(r' xmlns(:xlink)?="[^"]*"', "", tag)
        return long_number.sub(lambda number: f"{float(number[0]):.2f}", tag)

    return re.sub(r"<[^>]+>", one_tag, svg).strip()


@dataclass(frozen=True, slots=True)
class Figures:
    """The figures of one run; None for one without data."""

    facts: Facts

    def rail(self) -> Drawn | None:
        survey = self.facts.part("rail_survey", SurveyedRail)
        if survey is None:
            return None
        figure, axes = axes_grid(2.6)
        ax: Axes = axes[0, 0]
        for way, how in (("forth", Sent.CHOSEN), ("back", Sent.BEFORE)):
            nominal_mm, error_mm = np.array(survey.curve[way], dtype=float).reshape(-1, 2).T
            face = "none" if how == Sent.BEFORE else COLOURS[how]
            ax.plot(nominal_mm, error_mm, marker=MARKERS[how], markersize=2.8, color=COLOURS[how],
                    markerfacecolor=face, label=way)  # fmt: skip
        ax.set(xlabel="nominal position on the rail, mm", ylabel="position error, mm")
        legend_above(ax)
        return figure, (
            f"Backlash {_with_u(survey.backlash_mm, 'mm')}; "
            f"scale {_with_u(survey.scale_ppm, 'ppm')}. "
            + self.facts.of_paper("The paper: error up to 0.5 mm, backlash about 0.2 mm.")
        )

    def slide(self) -> Drawn | None:
        survey = self.facts.part("rail_survey", SurveyedRail)
        if survey is None:
            return None
        figure, axes = axes_grid(2.2)
        ax: Axes = axes[0, 0]
        nominal_mm = [stop[0] for stop in survey.curve["forth"]]
        turns = (("roll", Sent.IDW), ("pitch", Sent.BEFORE), ("yaw", Sent.CHOSEN))
        for (name, how), style in zip(turns, ("-", "--", ":"), strict=True):
            ax.plot(nominal_mm, survey.angles_mrad[name], style, color=COLOURS[how], label=name)
        ax.set(xlabel="nominal position on the rail, mm", ylabel="angle, mrad")
        legend_above(ax)
        off_mm = survey.straightness_mm
        return figure, (
            "Forth, against the first stop, from the slide's nests. Straightness of the path, peak "
            f"to peak: {off_mm['horizontal']:.3f} mm horizontal, "
            f"{off_mm['vertical']:.3f} mm vertical."
        )

    def frames(self) -> Drawn | None:
        """Draw how far slide points came out from where the reference's frames have them."""
        facts = self.facts
        repeated = facts.part("frame_repeatability", FramesRepeated)
        if repeated is None:
            return None
        stations = list(repeated.base)
        figure, axes = axes_grid(2.5, 1, len(stations), sharey=True)
        for ax, station in zip(axes[0], stations, strict=True):
            for kind, off_mm, how, shift in (
                ("base", repeated.base[station], Sent.BEFORE, -0.2),
                ("station", repeated.station[station], Sent.CHOSEN, 0.2),
            ):
                at = np.arange(1, len(off_mm) + 1) + shift
                ax.bar(at, off_mm, 0.38, color=COLOURS[how], label=f"{kind} frame")
            ticks = np.arange(1, len(repeated.base[station]) + 1)
            ax.set(title=f"station {station}", xlabel="slide point", xticks=ticks)
            ax.grid(visible=False, axis="x")
        axes[0, 0].set_ylabel("deviation, mm")
        legend_above(axes[0, -1])
        low, high = repeated.ratio_interval
        return figure, (
            f"Against station {facts.cell.grid.station}. The station frame repeats "
            f"{repeated.ratio:.1f} times better, interval {low:.1f} to {high:.1f}. "
            + facts.of_paper("The paper: about 4 times.")
        )

    def strip(self) -> Drawn | None:
        """Draw the slide's position after each approach, by drive alone and held by the strip."""
        facts = self.facts
        held = {"plain": Sent.BEFORE, "strip": Sent.CHOSEN}  # drawn in the colours of these
        ways = [
            way for way in SIDES if any(len(along_rail_mm(facts.log, how, way)) for how in held)
        ]
        if not ways:
            return None
        figure, axes = axes_grid(2.6, 1, len(ways), sharey=True)
        ranges = []
        for ax, way in zip(axes[0], ways, strict=True):
            for name, how in held.items():
                off_mm, label = along_rail_mm(facts.log, name, way), HOLDS[name]
                if len(off_mm):
                    off_mm = off_mm - off_mm.mean()
                    ranges.append(f"{SIDES[way]}, {label} {np.ptp(off_mm):.4f} mm")
                    scatter(ax, how, off_mm, label)
                    ax.plot(
                        np.arange(1, len(off_mm) + 1), off_mm, color=COLOURS[how], linewidth=0.7
                    )
            ticks = range(1, len(ax.lines[0].get_ydata()) + 1, 2)
            ax.set(title=SIDES[way], xlabel="approach", xticks=ticks)
        axes[0, 0].set_ylabel("deviation along the rail, mm")
        legend_above(axes[0, -1])
        return figure, (
            f"Deviation from each series' mean. Ranges: {'; '.join(ranges)}. "
            + facts.of_paper("The paper: at most 0.035 mm with the strip, backlash 0.2 mm without.")
        )

    def poses(self) -> Drawn | None:
        if not is_pose_test(self.facts):
            return None
        test = PoseReport(self.facts).tested()
        figure, axes = axes_grid(2.6, 1, 3)
        _test_cube(axes[0, 0], test.cube, test.poses)
        poses = test.poses.values()
        for ax, of, how, bars in (
            (axes[0, 1], AP, Sent.BEFORE, [(each.ap_mm, each.ap_u95_mm) for each in poses]),
            (axes[0, 2], RP, Sent.CHOSEN, [(each.rp_mm, each.rp_u95_mm) for each in poses]),
        ):
            values, u95_mm = zip(*bars, strict=True)
            ax.bar(list(test.poses), values, width=0.6, color=COLOURS[how], yerr=u95_mm,
                   error_kw={"ecolor": INK, "elinewidth": 0.8, "capsize": 2.5})  # fmt: skip
            ax.set_title(f"{of.symbol}, {of.unit}")
            ax.set_ylim(bottom=0.0)
            ax.grid(visible=False, axis="x")
            if limit_mm := test.limits.get(of.limit):
                ax.axhline(limit_mm, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
        return figure, (
            "Left: the test cube in {B} and the cycle on its plane. Bars: U, k = 2. Dashed: the "
            "limit, where one is stated."
        )

    def attained_positions(self) -> Drawn | None:
        """Draw the attained positions of each pose about their barycentre, from two sides."""
        facts = self.facts
        if not is_pose_test(facts):
            return None
        blue, orange = COLOURS[Sent.CHOSEN], COLOURS[Sent.BEFORE]
        poses = PoseReport(facts).tested().poses
        clouds = {name: each.error_mm for name, each in attained_positions(facts.log).items()}
        reach_mm = 1.15 * max(
            *(float(from_mean_mm(cloud).max()) for cloud in clouds.values()),
            *(each.rp_mm for each in poses.values()),
        )
        tick_mm = float(f"{0.6 * reach_mm:.1g}")
        figure, axes = axes_grid(3.1, 2, len(clouds), sharex=True, sharey=True)
        for column, (name, cloud) in enumerate(clouds.items()):
            off_mm = cloud - cloud.mean(axis=0)
            for ax, (across, up) in zip(axes[:, column], ((0, 1), (0, 2)), strict=True):
                ax.plot(*off_mm[:, (across, up)].T, "o", color=blue, markersize=2.2, alpha=0.75)
                turn, rp_mm = np.linspace(0.0, 2.0 * np.pi, 73), poses[name].rp_mm
                ax.plot(rp_mm * np.cos(turn), rp_mm * np.sin(turn), color=orange, linewidth=0.9)
                ax.set(xticks=[-tick_mm, tick_mm], yticks=[-tick_mm, 0.0, tick_mm])
                ax.set(xlim=(-reach_mm, reach_mm), ylim=(-reach_mm, reach_mm), aspect="equal")
            axes[0, column].set_title(name)
            axes[1, column].set_xlabel("x, mm")
        axes[0, 0].set_ylabel("y, mm")
        axes[1, 0].set_ylabel("z, mm")
        return figure, "Attained positions less their barycentre, axes of {B}. Circle: radius RP_l."
