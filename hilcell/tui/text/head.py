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

BLOCK = 24  # columns of the words' ground
MOST_LETTERS = (BLOCK + 1) // 4  # that are large; a longer word is a bold line
BAR, TO_LIMIT = 24, 19  # columns
LEAST_WIDTH, LEAST_ROWS = 78, 14
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
        return _small(head, mark, glyphs).lines(width)
    figures = [_large_figure(each, glyphs) for each in head.figures]
    columns = Col(BLOCK), Col(25), Col()
    return Grid(zip(_block(head, mark, glyphs), *figures, strict=True), *columns, gap=2).lines(
        width
    )


def _block(head: Head, mark: Content, glyphs: Glyphs) -> list[Content]:
    texts: list[str] = []
    for word in head.words:
        texts += ["", word, ""] if glyphs.plain or len(word) > MOST_LETTERS else large_rows(word)
    if len(head.words) == 1:
        texts = ["", *texts, "", head.stated]
    last = mark.pad_left((BLOCK - mark.cell_length) // 2).truncate(BLOCK, pad=True)
    words = (Content.styled(f"{text:^{BLOCK}}", head.style) for text in texts)
    return [*words, last.stylize_before(head.style.removeprefix("bold "))]


def _tone(each: Figure, glyphs: Glyphs) -> tuple[str, str]:
    if each.limit_mm is None:
        return "$label", glyphs.stale
    return ("$fault", glyphs.warned) if each.over else ("$passed", glyphs.fresh)


def _place(each: Figure) -> str:
    """Return place and limit; a long name is shortened, the limit never."""
    limit = "no limit" if each.limit_mm is None else f"limit {each.limit_mm:.3f}"
    return f" {Content(each.at).truncate(10, ellipsis=True).plain}, {limit}"


def _large_figure(each: Figure, glyphs: Glyphs) -> list[Cell]:
    tone, shape = _tone(each, glyphs)
    digits = large(figure(each.value_mm), tone if each.over else "$foreground", glyphs)
    at = Content.assemble((shape, tone), (_place(each), "$label"))
    bar = BLANK
    if each.limit_mm:
        mark = TO_LIMIT / BAR
        share, guard = (mark * length / each.limit_mm for length in (each.value_mm, each.U_mm))
        bar = Bar(share, tone, mark, guard).drawn(BAR)
    return [(each.title, "$label"), *digits, at, bar, BLANK]


def _small(head: Head, mark: Content, glyphs: Glyphs) -> Lines:
    stated = (head.stated,) if len(head.words) == 1 else ()
    text = "  ".join(["", " ".join(head.words), *stated, ""])
    rows: list[list[Cell]] = []
    for each in head.figures:
        tone, shape = _tone(each, glyphs)
        value = (f"{figure(each.value_mm)} mm", f"bold {tone}" if each.over else "bold")
        title = (each.title.removesuffix(", mm"), "$label")
        places = _place(each), _place(each).partition(", ")[2]
        place = Fitting(tuple(Content.styled(text, "$label") for text in places))
        rows.append(["", (shape, tone), title, value, place])
    columns = Col(), Col(), Col(), Col(), Col(grows=True)
    words = Content("").join([Content.styled(text, head.style), mark])
    return Stack(words, Grid(rows, *columns))
