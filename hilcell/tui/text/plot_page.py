"""The page of plots: tabs, one plot, and its figures beside it, under it, or away."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Self

from textual.content import Content

from hilcell.tui.plots.draw import Look, Plot, draw
from hilcell.tui.plots.scale import Scale
from hilcell.tui.text.plot_figures import FIGURES, SHORT, WIDTH, key
from hilcell.tui.text.plots import Measured, Tab, scale_of, tabs_of

BESIDE = 100  # columns, from which the figures stand beside the plot
UNDER = 34  # rows, from which they stand under it
GAP = 3  # columns between both
LEAST = 8  # rows of a plot
ALL = "all stations"


@dataclass(slots=True)
class Choice:
    """The state of the page: plot, station, scale and series, and the scales so far."""

    tab: int = 0
    picks: dict[int, int] = field(default_factory=dict)  # by tab
    turned: dict[int, bool] = field(default_factory=dict)  # by tab: the other kind of scale
    series: int = 0  # 0: all, else only that
    scales: dict[tuple[object, ...], Scale] = field(default_factory=dict)

    def pick(self, of: Measured, tab: Tab) -> str:
        """Return the station, or axis, that is shown."""
        picks = tab.picks(of)
        return picks[self.picks.get(self.tab, 0) % len(picks)]

    def is_log(self, tab: Tab) -> bool:
        """Whether the scale is logarithmic."""
        return tab.is_log != self.turned.get(self.tab, False) if tab.may_be_log else False

    @property
    def state(self) -> tuple[object, ...]:
        """Return what a drawing depends on."""
        return self.tab, tuple(self.picks.items()), tuple(self.turned.items()), self.series

    def turn_pick(self) -> None:
        """Choose the next station, or axis."""
        self.picks[self.tab] = self.picks.get(self.tab, 0) + 1

    def turn_scale(self) -> None:
        """Choose the other scale."""
        self.turned[self.tab] = not self.turned.get(self.tab, False)

    def turn_series(self, count: int) -> None:
        """Show the next series alone; after the last, all."""
        self.series = (self.series + 1) % (count + 1) if count > 1 else 0


@dataclass(frozen=True, slots=True)
class Shown:
    """One drawing of the page."""

    tab: Tab
    pick: str
    whole: Plot  # with all series
    plot: Plot
    scale: Scale

    @classmethod
    def of(cls, of: Measured, choice: Choice, height: int) -> Self:
        """Return what is chosen, in a scale that holds all that it held before."""
        tab = tabs_of(of.log)[choice.tab]
        pick, is_log = choice.pick(of, tab), choice.is_log(tab)
        whole = tab.make(of, pick)
        plot = whole
        if 0 < choice.series <= len(whole.series):
            plot = replace(whole, series=(whole.series[choice.series - 1],))
        name = (tab.name, is_log, pick if tab.name == "sweeps" else "")
        scale = scale_of(whole, height, choice.scales.get(name), is_log=is_log)
        choice.scales[name] = scale
        return cls(tab, pick, whole, plot, scale)


def tab_line(of: Measured, choice: Choice, width: int, look: Look) -> Content:
    """Return the tabs, and at the right the station and how many targets it has."""
    parts: list[Content] = []
    for n, tab in enumerate(tabs_of(of.log)):
        text = f" {n + 1} {tab.name} "
        if n == choice.tab:
            text = f"[{text[1:-1]}]" if look.plain else text
            parts.append(Content.styled(text, "bold $background on $foreground"))
        else:
            parts.append(Content.styled(text, "$label" if look.letters else "$label on $panel"))
    tab = tabs_of(of.log)[choice.tab]
    right = Content("")
    if len(tab.picks(of)) > 1:
        right = Content.assemble((" S ", "bold on $badge"), f" {choice.pick(of, tab) or ALL}")
    for gap in ("  ", ""):
        left = Content(gap).join(parts)
        room = width - left.cell_length - right.cell_length
        if room >= 1:
            return left.append(" " * room).append(right)
    return Content(" ").join([parts[choice.tab], right])


def plot_lines(of: Measured, choice: Choice, width: int, height: int, look: Look) -> list[Content]:
    """Return title, plot and figures in at most so many rows."""
    beside = width >= BESIDE
    figures_rows = height // 3 if not beside and height >= UNDER else 0
    rows = max(height - 1 - (figures_rows and figures_rows + 1), LEAST)
    shown = Shown.of(of, choice, rows)
    if not len(shown.whole.values):
        return [_title(shown), Content.styled("nothing measured for this plot yet", "$label")]
    across = width - WIDTH - GAP if beside else width
    named = [replace(each, name=SHORT.get(each.name, each.name)) for each in shown.plot.series]
    drawn = draw(replace(shown.plot, series=tuple(named)), shown.scale, across, rows, look)
    figures = FIGURES[shown.tab.name](of, shown.pick, shown.plot, look)
    if beside:
        return [_title(shown), *_side_by_side(drawn, figures, across + GAP)]
    names = key(shown.plot, look)
    head = _title(shown)
    if head.cell_length + names.cell_length + 2 <= width:
        head = head.append(" " * (width - head.cell_length - names.cell_length)).append(names)
    under = [Content(""), *figures[:figures_rows]] if figures_rows else []
    return [head, *drawn, *under]


def _title(shown: Shown) -> Content:
    scale = ", log scale" if shown.scale.is_log else ""
    return Content.styled(f"{shown.plot.title}{scale}", "bold")


def _side_by_side(left: list[Content], right: list[Content], width: int) -> list[Content]:
    """Return the rows of both, the right one from column ``width`` on."""
    return [
        each.append(" " * (width - each.cell_length)).append(right[n]) if n < len(right) else each
        for n, each in enumerate(left)
    ]
