"""Small tables, rules, bars, drawings and large figures.

A panel asks for the lines as it paints, for its room: nothing outside this module and
the style sheet counts columns.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

from textual.content import Content

from hilcell.language import decimal
from hilcell.tui.terminal import Glyphs

BLANK = Content("")


class Lines:
    """Rows of a panel, laid out as they are painted."""

    def lines(self, width: int, height: int = 0) -> list[Content]:
        """Return lines of at most ``width`` columns; the panel cuts those after ``height``."""
        raise NotImplementedError


class Filler:
    """A cell that is drawn for the width of its column."""

    def drawn(self, width: int) -> Content:
        raise NotImplementedError


Text = Content | str | tuple[str, str]  # the last: a text and its style
Cell = Text | Filler


@dataclass(frozen=True, slots=True)
class Col:
    """One column: its least width; without growing, it is as wide as its longest cell.

    ``most``: its greatest width; ``grows``: it takes the room that the others leave; ``wraps``:
    long cells wrap, others are cut.
    """

    width: int = 0
    right: bool = False
    grows: bool = False
    wraps: bool = False
    most: int = 0


class Grid(Lines):
    """Rows of cells in columns; ``styles`` are those of whole rows, by number.

    Where there is little room, columns are as wide as their cells, then the last ones are left out.
    """

    def __init__(
        self,
        rows: Iterable[Sequence[Cell]],
        *columns: Col,
        gap: int = 1,
        styles: Mapping[int, str] | None = None,
    ) -> None:
        self._rows = [
            [Content.assemble(cell) if isinstance(cell, (str, tuple)) else cell for cell in row]
            for row in rows
        ]
        self._columns, self._gap, self._styles = columns, gap, styles or {}

    def _widths(self, width: int) -> list[int]:
        needs = [
            max((each.cell_length for each in cells if isinstance(each, Content)), default=0)
            for cells in zip(*self._rows, strict=True)
        ]
        needs = [
            0 if col.grows else min(need, col.most or need)
            for col, need in zip(self._columns, needs, strict=True)
        ]
        widths = [max(each, col.width) for each, col in zip(needs, self._columns, strict=True)]
        if sum(widths) + self._gap * (len(widths) - 1) > width:
            widths = needs
        while len(widths) > 1 and sum(widths) + self._gap * (len(widths) - 1) > width:
            widths = widths[:-1]
        room = max(width - sum(widths) - self._gap * (len(widths) - 1), 0)
        for n, col in enumerate(self._columns[: len(widths)]):
            if col.grows:
                more = min(room, col.most - widths[n]) if col.most else room
                widths[n], room = widths[n] + more, room - more
        return widths

    def lines(self, width: int, height: int = 0) -> list[Content]:
        widths, lines = self._widths(width) if self._rows else [], []
        for number, row in enumerate(self._rows):
            cells = [
                self._cell_lines(*each) for each in zip(row, self._columns, widths, strict=False)
            ]
            for n in range(max(map(len, cells))):
                parts = (
                    cell[n] if n < len(cell) else Content(" " * room)
                    for cell, room in zip(cells, widths, strict=True)
                )
                line = Content(" " * self._gap).join(parts).truncate(width)
                lines.append(line.stylize_before(self._styles.get(number, "")))
        return lines

    @staticmethod
    def _cell_lines(cell: Content | Filler, column: Col, width: int) -> list[Content]:
        content = cell if isinstance(cell, Content) else cell.drawn(width)
        wrapped = (
            content.wrap(width) if column.wraps and 0 < width < content.cell_length else [content]
        )
        lines = (line.truncate(width, ellipsis=True) for line in wrapped)
        return [
            line.pad_left(width - line.cell_length)
            if column.right
            else line.truncate(width, pad=True)
            for line in lines
        ]


def ends(left: Cell, right: Cell) -> Grid:
    """Return one line with a text at each end; the left one is cut where room is short."""
    return Grid([(left, right)], Col(grows=True), Col())


def labelled_rows(facts: Iterable[tuple[str, Text]], width: int = 12) -> Grid:
    rows = [((name, "$label"), text) for name, text in facts]
    return Grid(rows, Col(width), Col(grows=True, wraps=True))


class Stack(Lines):
    """Parts one under the other; contents wrap."""

    def __init__(self, *parts: Lines | Text) -> None:
        wrapped = Col(grows=True, wraps=True)
        self._parts = [
            Grid([(part,)], wrapped) if isinstance(part, (str, tuple, Content)) else part
            for part in parts
        ]

    def lines(self, width: int, height: int = 0) -> list[Content]:
        return [*chain.from_iterable(part.lines(width, height) for part in self._parts)]


@dataclass(frozen=True)
class Drawing(Lines):
    """Lines that are drawn for the size of their panel, by ``draw(width, height)``."""

    draw: Callable[[int, int], list[Content]]

    def lines(self, width: int, height: int = 0) -> list[Content]:
        return self.draw(width, height)


@dataclass(frozen=True)
class Rule(Lines):
    """A rule with a title on its left and a remark at its end."""

    title: Content
    remark: Content = BLANK

    def lines(self, width: int, height: int = 0) -> list[Content]:
        left = Content.assemble(("─ ", "$stale"), self.title, " ")
        tail = Content.assemble(" ", self.remark, (" ─", "$stale")) if self.remark else BLANK
        room = width - left.cell_length - tail.cell_length
        if room < 1:
            return [left.truncate(width, ellipsis=True)]
        return [left.append(Content.styled("─" * room, "$stale")).append(tail)]


def section(title: str, remark: str = "") -> Rule:
    return Rule(Content.styled(title, "bold $label"), Content.styled(remark, "$label"))


@dataclass(frozen=True)
class Fitting(Filler):
    """The first of some texts that fits; nothing where none does."""

    texts: tuple[Content, ...]

    def drawn(self, width: int) -> Content:
        return next((each for each in self.texts if each.cell_length <= width), BLANK)


@dataclass(frozen=True)
class Bar(Filler):
    """A bar filled from 0 to ``share`` of its width, to half a column; NaN fills it.

    ``mark``: the share at which a limit is drawn; ``guard``: how wide the band is before and after
    it, also a share, in which neither pass nor fail is shown. It is hatched.
    """

    share: float
    style: str
    mark: float | None = None
    guard: float = 0.0

    def drawn(self, width: int) -> Content:
        halves = math.floor(2 * width * self.share + 1e-9) if self.share <= 1.0 else 2 * width
        whole, half = divmod(max(halves, 0), 2)
        filled = whole + half
        low = high = width
        if self.mark is not None and 0.0 < self.guard < math.inf:
            low = math.floor(width * (self.mark - self.guard) + 1e-9)
            low = min(max(low, filled), width)
            high = min(max(math.ceil(width * (self.mark + self.guard) - 1e-9), low), width)
        line = Content.assemble(
            ("█" * whole, self.style),
            ("▌" * half, f"{self.style} on $track"),
            ("░" * (low - filled), "$track on $track"),
            ("▒" * (high - low), "$ask on $track"),
            ("░" * (width - high), "$track on $track"),
        )
        if self.mark is None:
            return line
        at = min(math.floor(width * self.mark + 1e-9), width - 1)
        ground = f"$background on {self.style}" if at < filled else "$foreground on $track"
        return line[:at].append(Content.styled("│", ground)).append(line[at + 1 :])


@dataclass(frozen=True)
class SignedBar(Filler):
    """A bar from a middle line, to the left where ``share`` is negative; NaN has none."""

    share: float
    style: str

    def drawn(self, width: int) -> Content:
        half = (width - 1) // 2
        length = min(round(half * abs(self.share)), half) if math.isfinite(self.share) else 0
        filled, rest = Content.styled("▄" * length, f"{self.style}"), Content(" " * (half - length))
        none, line = Content(" " * half), Content.styled("│", "$label")
        parts = [rest, filled, line, none] if self.share < 0 else [none, line, filled, rest]
        return Content("").join(parts).stylize_before("on $panel")


@dataclass(frozen=True)
class Ticks(Filler):
    """Texts at their shares of the width, in rising order: the scale under a bar."""

    ticks: tuple[tuple[float, Content], ...]

    def drawn(self, width: int) -> Content:
        """Return the line; a text that would touch the one before is left out."""
        line = BLANK
        for share, text in self.ticks:
            gap = math.floor(width * share + 1e-9) - line.cell_length
            if gap >= min(line.cell_length, 1):
                line = line.append(" " * gap).append(text)
        return line


# -- large figures and words: three rows of half blocks, three columns a digit, one between -------

# 1 has a foot: without one it looks like 7. In ASCII the large text is one bold line.

_SHAPES = {
    "0": ("█▀█", "█ █", "▀▀▀"),
    "1": ("▄█ ", " █ ", "▀▀▀"),
    "2": ("▀▀█", "█▀▀", "▀▀▀"),
    "3": ("▀▀█", " ▀█", "▀▀▀"),
    "4": ("█ █", "▀▀█", "  ▀"),
    "5": ("█▀▀", "▀▀█", "▀▀▀"),
    "6": ("█▀▀", "█▀█", "▀▀▀"),
    "7": ("▀▀█", "  █", "  ▀"),
    "8": ("█▀█", "█▀█", "▀▀▀"),
    "9": ("█▀█", "▀▀█", "▀▀▀"),
    "+": (" ▄ ", "▀█▀", "   "),
    "-": ("  ", "▀▀", "  "),
    ".": (" ", " ", "▀"),
    ",": (" ", " ", "█"),
    " ": (" ", " ", " "),
    "P": ("█▀█", "█▀▀", "▀  "),
    "A": ("█▀█", "█▀█", "▀ ▀"),
    "S": ("█▀▀", "▀▀█", "▀▀▀"),
    "F": ("█▀▀", "█▀▀", "▀  "),
    "I": ("█", "█", "▀"),
    "L": ("█  ", "█  ", "▀▀▀"),
    "T": ("▀█▀", " █ ", " ▀ "),
    "V": ("█ █", "█ █", " ▀ "),
    "D": ("█▀▄", "█ █", "▀▀ "),
    "U": ("█ █", "█ █", "▀▀▀"),
    "E": ("█▀▀", "█▀▀", "▀▀▀"),
    "R": ("█▀█", "█▀▄", "▀ ▀"),
    "O": ("█▀█", "█ █", "▀▀▀"),
    "N": ("█▄ █", "█ ▀█", "▀  ▀"),
    "C": ("█▀▀", "█  ", "▀▀▀"),
    "H": ("█ █", "█▀█", "▀ ▀"),
    "G": ("█▀▀", "█ █", "▀▀▀"),
    "Ü": ("▀ ▀", "█ █", "▀▀▀"),
}


def figure(value_mm: float) -> str:
    """Return a length as it is shown in large digits; dashes for what is no number."""
    return decimal(f"{value_mm:.3f}") if math.isfinite(value_mm) else "-.---"


def has_shapes(text: str) -> bool:
    return all(letter in _SHAPES for letter in text)


def large_rows(text: str) -> tuple[str, str, str]:
    """Return three rows of equal length; raises `KeyError` for a letter without a shape."""
    shapes = [_SHAPES[letter] for letter in text.replace("−", "-")]
    top, middle, bottom = (" ".join(shape[row] for shape in shapes) for row in range(3))
    return top, middle, bottom


def large(text: str, style: str, glyphs: Glyphs) -> list[Content]:
    """Return three lines of equal width that show the text large; in ASCII the middle one does."""
    if glyphs.plain:
        shown = Content.styled(text, f"bold {style}")
        blank = Content(" " * shown.cell_length)
        return [blank, shown, blank]
    return [Content.styled(row, style) for row in large_rows(text)]
