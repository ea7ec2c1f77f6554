"""The head of a finished run: a word on its ground, and two lengths large beside their limits.

A narrow or low window has them in one row each.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from textual.content import Content

from hilcell.tui.engine.run_view import RunView
from hilcell.tui.layout import BLANK, Bar, Cell, Col, Fitting, Grid, Lines, Stack
from hilcell.tui.terminal.capabilities import Glyphs
from hilcell.tui.text.digits import figure, large, large_rows
from hilcell.tui.text.run import is_simulated, simulation_block

LEAST_WIDTH, LEAST_ROWS = 78, 14
BLOCK = 24  # columns of the words' ground
BAR, TO_LIMIT = 24, 19  # columns
NEXT = "o report   p plots   w worst points   n new run"


@dataclass(frozen=True, slots=True)
class Figure:
    """One large length (mm): its title, where it is the worst, and its limit, None for none."""

    title: str
    value_mm: float
    at: str
    limit_mm: float | None = None
    U_mm: float = 0.0  # expanded uncertainty, where it counts against the limit

    @property
    def over(self) -> bool:
        """Whether there is a limit, and it is not kept with certainty."""
        return self.limit_mm is not None and not self.value_mm + self.U_mm <= self.limit_mm

    @property
    def place(self) -> str:
        """Return place and limit; a long name is shortened, the limit never."""
        limit = "no limit" if self.limit_mm is None else f"limit {self.limit_mm:.3f}"
        return f" {Content(self.at).truncate(10, ellipsis=True).plain}, {limit}"

    def tone(self, glyphs: Glyphs) -> tuple[str, str]:
        """Return the style and the shape that say whether the limit is kept."""
        if self.limit_mm is None:
            return "$label", glyphs.stale
        return ("$fault", glyphs.warned) if self.over else ("$passed", glyphs.fresh)

    def large(self, glyphs: Glyphs) -> list[Cell]:
        """Return eight rows: the title, the digits, the place and the bar up to the limit."""
        tone, shape = self.tone(glyphs)
        digits = large(figure(self.value_mm), tone if self.over else "$foreground", glyphs)
        at = Content.assemble((shape, tone), (self.place, "$label"))
        bar = BLANK
        if self.limit_mm:
            mark = TO_LIMIT / BAR
            share, guard = (mark * length / self.limit_mm for length in (self.value_mm, self.U_mm))
            bar = Bar(share, tone, mark, guard).drawn(BAR)
        return [(self.title, "$label"), *digits, at, bar, BLANK]


@dataclass(frozen=True, slots=True)
class Head:
    """One or two large words, what one word states, the role of their colour, and two figures."""

    words: tuple[str, ...]
    stated: str
    role: str
    figures: tuple[Figure, ...]

    @property
    def style(self) -> str:
        """Return the style of the words on their ground."""
        if self.role == "label":
            return "bold $foreground on $badge"
        return f"bold $on-{self.role} on ${self.role}-fill"

    def block(self, mark: Content, glyphs: Glyphs) -> list[Content]:
        """Return the words on their ground, over the mark of a simulation."""
        texts: list[str] = []
        for word in self.words:
            is_bold = glyphs.plain or len(word) > (BLOCK + 1) // 4  # longer than large letters
            texts += ["", word, ""] if is_bold else large_rows(word)
        if len(self.words) == 1:
            texts = ["", *texts, "", self.stated]
        last = mark.pad_left((BLOCK - mark.cell_length) // 2).truncate(BLOCK, pad=True)
        words = (Content.styled(f"{text:^{BLOCK}}", self.style) for text in texts)
        return [*words, last.stylize_before(self.style.removeprefix("bold "))]

    def small(self, mark: Content, glyphs: Glyphs) -> Lines:
        """Return the words in one line, and each figure in one."""
        stated = (self.stated,) if len(self.words) == 1 else ()
        text = "  ".join(["", " ".join(self.words), *stated, ""])
        rows: list[list[Cell]] = []
        for each in self.figures:
            tone, shape = each.tone(glyphs)
            value = (f"{figure(each.value_mm)} mm", f"bold {tone}" if each.over else "bold")
            title = (each.title.removesuffix(", mm"), "$label")
            places = each.place, each.place.partition(", ")[2]
            place = Fitting(tuple(Content.styled(text, "$label") for text in places))
            rows.append(["", (shape, tone), title, value, place])
        columns = Col(), Col(), Col(), Col(), Col(grows=True)
        words = Content("").join([Content.styled(text, self.style), mark])
        return Stack(words, Grid(rows, *columns))


def gravest(value_mm: float) -> float:
    """Return a length to order by: NaN and infinity are the worst."""
    return value_mm if math.isfinite(value_mm) else math.inf


def is_small(width: int, rows: int) -> bool:
    """Whether the large head has no room."""
    return width < LEAST_WIDTH or rows < LEAST_ROWS


def head_lines(view: RunView, head: Head, glyphs: Glyphs, width: int, rows: int) -> list[Content]:
    """Return the words and the figures, large where there is room; nothing without words."""
    if not head.words:
        return []
    mark = simulation_block() if is_simulated(view) else BLANK
    if is_small(width, rows):
        return head.small(mark, glyphs).lines(width)
    rows_of = (head.block(mark, glyphs), *(each.large(glyphs) for each in head.figures))
    return Grid(zip(*rows_of, strict=True), Col(BLOCK), Col(25), Col(), gap=2).lines(width)
