"""The head of a finished run: a word on its ground, and two lengths large beside their limits.

A narrow or low window has them in one row each.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from textual.content import Content

from hilcell.tui.engine.run_view import RunView
from hilcell.tui.terminal.capabilities import Glyphs
from hilcell.tui.text.digits import figure, large, large_rows
from hilcell.tui.text.lines import bar, placed
from hilcell.tui.text.run import is_simulated, simulation_block

BLOCK, FIRST_AT, SECOND_AT = 24, 26, 53
MOST_LETTERS = (BLOCK + 1) // 4  # that are large; a longer word is a bold line
BAR, TO_LIMIT = 24, 19
LEAST_WIDTH, LEAST_ROWS, LEAST_PLACE = 78, 14, 28
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
    mark = simulation_block() if is_simulated(view) else Content("")
    if is_small(width, rows):
        return _small(head, mark, glyphs, width)
    return _large(head, mark, glyphs)


def _style(role: str) -> tuple[str, str]:
    """Return the style of the words, and their ground alone."""
    if role == "label":
        return "bold $foreground on $badge", "on $badge"
    return f"bold $on-{role} on ${role}-fill", f"on ${role}-fill"


def _large(head: Head, mark: Content, glyphs: Glyphs) -> list[Content]:
    block = _block(head, mark, glyphs)
    columns = [_large_figure(each, glyphs) for each in head.figures]
    places = (FIRST_AT, SECOND_AT)
    return [
        placed((0, line), *((at, each[n]) for at, each in zip(places, columns, strict=True)))
        for n, line in enumerate(block)
    ]


def _block(head: Head, mark: Content, glyphs: Glyphs) -> list[Content]:
    style, ground = _style(head.role)
    texts: list[str] = []
    for word in head.words:
        texts += ["", word, ""] if glyphs.plain or len(word) > MOST_LETTERS else large_rows(word)
    if len(head.words) == 1:
        texts = ["", *texts, "", head.stated]
    pad = (BLOCK - mark.cell_length) // 2
    rest = BLOCK - pad - mark.cell_length
    last = Content.assemble((" " * pad, ground), mark, (" " * rest, ground))
    return [*(Content.styled(f"{text:^{BLOCK}}", style) for text in texts), last]


def _tone(each: Figure, glyphs: Glyphs) -> tuple[str, str]:
    if each.limit_mm is None:
        return "$label", glyphs.stale
    return ("$fault", glyphs.warned) if each.over else ("$passed", glyphs.fresh)


def _at(each: Figure, room: int) -> str:
    """Return place and limit in ``room``: a long name is shortened, the limit never."""
    limit = ", no limit stated" if each.limit_mm is None else f", limit {each.limit_mm:.3f}"
    if each.limit_mm is None and 1 + len(each.at) + len(limit) > room:
        limit = ", no limit"
    at = Content(f" {each.at}").truncate(max(room - len(limit), 1), ellipsis=True).plain
    return f"{at}{limit}"


def _large_figure(each: Figure, glyphs: Glyphs) -> list[Content]:
    tone, shape = _tone(each, glyphs)
    digits = large(figure(each.value_mm), tone if each.over else "$foreground", glyphs)
    at = Content.assemble((shape, tone), (_at(each, SECOND_AT - FIRST_AT - 3), "$label"))
    line = Content("")
    if each.limit_mm:
        mark = TO_LIMIT / BAR
        share, guard = (mark * length / each.limit_mm for length in (each.value_mm, each.U_mm))
        line = bar(share, BAR, tone, mark, guard)
    return [Content.styled(each.title, "$label"), *digits, at, line, Content("")]


def _small(head: Head, mark: Content, glyphs: Glyphs, columns: int) -> list[Content]:
    stated = (head.stated,) if len(head.words) == 1 else ()
    text = "  ".join(["", " ".join(head.words), *stated, ""])
    lines = [Content("").join([Content.styled(text, _style(head.role)[0]), mark])]
    titles = [each.title.removesuffix(", mm") for each in head.figures]
    width = max(map(len, titles), default=0)
    for title, each in zip(titles, head.figures, strict=True):
        tone, shape = _tone(each, glyphs)
        room = max(columns - width - len(f"    {figure(each.value_mm)} mm"), LEAST_PLACE)
        lines.append(
            Content.assemble(
                (f" {shape}", tone), (f" {title:<{width}} ", "$label"),
                (f"{figure(each.value_mm)} mm", f"bold {tone}" if each.over else "bold"),
                (_at(each, room), "$label"),
            )
        )  # fmt: skip
    return lines
