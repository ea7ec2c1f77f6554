"""The widgets that the screens are built of.

Every text passes a `TextPanel` or a `Table`. Both replace control and direction characters,
so that text from a device or an operator cannot reach the terminal as a command.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Generic, TypeVar

from rich.cells import cell_len, set_cell_size
from rich.segment import Segment
from rich.style import Style
from textual.binding import Binding, BindingsMap, BindingType
from textual.content import Content
from textual.css.styles import RulesMap
from textual.events import Key
from textual.geometry import Size
from textual.message import Message
from textual.scroll_view import ScrollView
from textual.scrollbar import ScrollBarRender
from textual.strip import Strip
from textual.style import Style as VisualStyle
from textual.visual import RenderOptions, Visual
from textual.widget import Widget
from textual.widgets import Input, Static

from hilcell.language import tr
from hilcell.sanitize import UNSAFE, clean
from hilcell.tui.layout import Lines
from hilcell.tui.terminal import to_ascii

T = TypeVar("T")


def _is_plain(widget: Widget) -> bool:
    return widget.app.has_class("plain")


def _safe(content: Content, *, plain: bool) -> Content:
    """Return content of the same length whose characters are all safe to print."""
    lines = (UNSAFE.sub("?", line) for line in content.plain.split("\n"))
    text = "\n".join(map(to_ascii, lines) if plain else lines)
    return Content(text, spans=list(content.spans))


class Shown(Visual):
    """Lines whose characters are all safe to print, as a panel paints them."""

    def __init__(self, source: Lines, *, plain: bool) -> None:
        self._source, self._plain = source, plain

    def content(self, width: int, height: int = 0) -> Content:
        lines = self._source.lines(width, height)
        return Content("\n").join(_safe(line, plain=self._plain) for line in lines)

    def render_strips(
        self, width: int, height: int | None, style: VisualStyle, options: RenderOptions
    ) -> list[Strip]:
        return self.content(width, height or 0).render_strips(width, height, style, options)

    def get_optimal_width(self, rules: RulesMap, container_width: int) -> int:
        return container_width

    def get_height(self, rules: RulesMap, width: int) -> int:
        return len(self._source.lines(width, 0))


class TextPanel(Static):
    """Shows content, or lines that are laid out as they are painted; never reads markup."""

    def __init__(self, id: str | None = None, *, classes: str | None = None) -> None:
        super().__init__("", markup=False, id=id, classes=classes)
        self._look: object = None

    def show(self, text: Content | str | Lines) -> None:
        """Show a text, where it differs from what is shown."""
        plain, size = _is_plain(self), self.content_size
        visual: Visual
        if isinstance(text, Lines):
            shown = visual = Shown(text, plain=plain)
            content = shown.content(size.width or self.app.size.width, size.height)
        else:
            content = visual = _safe(Content.assemble(text), plain=plain)
        look = content.plain, content.spans, size
        if look != self._look:
            self._look = look
            self.update(visual, layout=self._size_changes(visual))

    def _size_changes(self, visual: Visual) -> bool:
        """Whether the screen is to be laid out again: that costs more than the text itself."""
        size, rules = self.content_size, self.styles.get_rules()
        if (width := rules.get("width")) is not None and width.is_auto:
            return visual.get_optimal_width(rules, 0) != size.width
        if (height := rules.get("height")) is not None and not height.is_auto:
            return False
        return not size.width or visual.get_height(rules, size.width) != size.height


class TitledBox(Widget):
    """A box with a title in its border, and a note in the one below; painted when they change."""

    _titles: object = None

    def show_titles(self, title: Content, note: str) -> None:
        if (titles := (title.plain, title.spans, note)) != self._titles:
            self._titles = titles
            self.border_title = _safe(title, plain=_is_plain(self))
            self.border_subtitle = note


class PlainScrollBar(ScrollBarRender):
    """Draws the bar as reversed spaces, so that it is seen without colours, too."""

    VERTICAL_BARS: ClassVar[list[str]] = [" "]
    HORIZONTAL_BARS: ClassVar[list[str]] = [" "]


class Choice(TextPanel, can_focus=True):
    """Shows the chosen word between arrows, and which of many it is; posts `Turned`."""

    MANY = 4  # options that need no count

    class Turned(Message):
        """Another word was chosen."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left", "turn(-1)", show=False, priority=True),  # in the order typed
        Binding("right,space", "turn(1)", show=False, priority=True),
        Binding("home", "choose(0)", show=False, priority=True),
        Binding("end", "choose(-1)", show=False, priority=True),
    ]

    def __init__(self, words: Sequence[str], id: str, labels: Sequence[str] = ()) -> None:
        """``labels``: how the words are shown, where that is not by themselves."""
        super().__init__(id=id, classes="choice")
        self.words, self.index = tuple(words), 0
        self._labels = tuple(labels) or self.words

    @property
    def value(self) -> str:
        return self.words[self.index]

    def on_mount(self) -> None:
        self._draw()

    def action_turn(self, step: int) -> None:
        self.action_choose(self.index + step)

    def action_choose(self, index: int) -> None:
        """Choose a word by its index, the last one by -1."""
        self.index = index % len(self.words)
        self._draw()
        self.post_message(self.Turned())

    def _draw(self) -> None:
        count = (
            "  " + tr("{n} of {planned}", n=self.index + 1, planned=len(self.words))
            if len(self.words) > self.MANY
            else ""
        )
        self.show(f"< {self._labels[self.index]} >{count}")


class TextField(Input):
    """A text box whose keys act in the order typed, however fast they come.

    Textual inserts letters where they arrive, but passes every other key of an input up to the
    application first; a scanner of barcodes sends its next letters before that.
    """

    KEYS: ClassVar = BindingsMap(Input.BINDINGS).key_to_bindings

    async def on_key(self, event: Key) -> None:
        """Edit, or submit, before the next letter is taken."""
        for binding in self.KEYS.get(event.key, ()):
            event.stop()
            event.prevent_default()
            await self.run_action(binding.action)


Cell = str | tuple[str, str]  # a text, or a text and its tone


@dataclass(frozen=True)
class Column(Generic[T]):
    """One column: its header with the unit, its width, and the cell of each row.

    ``grows``: it takes all the room that the others leave, and its width at least. ``least`` and
    ``below``: the widths of a table that has it. A tone is a theme's variable; ``*`` before it is
    bold.
    """

    title: str
    width: int
    of: Callable[[T], Cell]
    right: bool = False
    grows: bool = False
    least: int = 0
    below: int = sys.maxsize

    def is_in(self, width: int) -> bool:
        return self.least <= width < self.below


class Table(ScrollView, Generic[T], can_focus=True):
    """A header, rows and a cursor. Only the rows in sight are drawn, so 10 000 cost what 20 cost.

    ``key``: the name of a row; ``tone``: that of its cells which have none of their own.

    Posts `RowSelected` on Enter and `RowHighlighted` when the cursor moves.
    """

    COMPONENT_CLASSES: ClassVar[set[str]] = {"table--head", "table--cursor"}
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding(key, action, show=False, priority=True)  # in the order typed
        for key, action in (
            ("up", "by(-1)"),
            ("down", "by(1)"),
            ("pageup", "page(-1)"),
            ("pagedown", "page(1)"),
            ("home", "to(0)"),
            ("end", "to(-1)"),
            ("enter", "choose"),
        )
    ]

    @dataclass
    class RowSelected(Message):
        """A row was chosen with Enter."""

        key: str

    @dataclass
    class RowHighlighted(Message):
        """The cursor moved to another row."""

        key: str

    def __init__(
        self,
        columns: Sequence[Column[T]],
        key: Callable[[T], str],
        *,
        empty: str,
        tone: Callable[[T], str] = lambda row: "",
        id: str | None = None,
    ) -> None:
        super().__init__(id=id)
        self.columns, self.empty = columns, empty
        self._key, self._row_tone = key, tone
        self.rows: Sequence[T] = ()
        self.cursor = 0
        self.follow = False  # keep the cursor on the last row while rows come

    @property
    def key(self) -> str:
        return self._key(self.rows[self.cursor]) if self.rows else ""

    def show_rows(self, rows: Sequence[T], columns: Sequence[Column[T]] | None = None) -> None:
        """Show these rows; the cursor stays on its row where that is still there."""
        if columns is not None:
            self.columns = columns
        key, last = self.key, max(len(rows) - 1, 0)
        if self.follow and self.cursor >= len(self.rows) - 1:
            self.cursor = last
        elif self.cursor > last or not rows or self._key(rows[self.cursor]) != key:
            matches = (n for n, row in enumerate(rows) if self._key(row) == key)
            self.cursor = next(matches, min(self.cursor, last))
        self.rows = rows
        self.on_resize()
        self.refresh()

    def on_resize(self) -> None:
        self.virtual_size = Size(self.size.width, len(self.rows) + 1)
        self._show_cursor()

    def choose(self, key: str) -> None:
        index = next((n for n, row in enumerate(self.rows) if self._key(row) == key), None)
        if index is not None:
            self._move(index)

    def action_by(self, step: int) -> None:
        self._move(self.cursor + step)

    def action_page(self, step: int) -> None:
        self._move(self.cursor + step * max(self.size.height - 2, 1))

    def action_to(self, index: int) -> None:
        self._move(index if index >= 0 else len(self.rows) + index)

    def action_choose(self) -> None:
        """Post the chosen row; the key is empty where there are no rows."""
        self.post_message(self.RowSelected(self.key))

    def _move(self, to: int) -> None:
        if not self.rows:
            return
        self.cursor = min(max(to, 0), len(self.rows) - 1)
        self._show_cursor()
        self.refresh()
        self.post_message(self.RowHighlighted(self.key))

    def _show_cursor(self) -> None:
        height = max(self.size.height - 1, 1)
        top = int(self.scroll_offset.y)
        if self.cursor < top:
            self.scroll_to(y=self.cursor, animate=False, force=True)
        elif self.cursor >= top + height:
            self.scroll_to(y=self.cursor - height + 1, animate=False, force=True)

    def render_line(self, y: int) -> Strip:
        """Draw one line: the header stays, the rows scroll under it."""
        base, index = self.rich_style, int(self.scroll_offset.y) + y - 1
        columns = [each for each in self.columns if each.is_in(self.size.width)]
        if y == 0:
            titles = {column: tr(column.title) for column in columns}
            return self._drawn(titles, self.get_component_rich_style("table--head"))
        if not self.rows and y == 1:
            return self._strip([Segment(self._shown(f" {self.empty}"), base)], base)
        if index >= len(self.rows):
            return Strip.blank(self.size.width, base)
        row = self.rows[index]
        cells = {column: column.of(row) for column in columns}
        if index == self.cursor:
            return self._drawn(cells, self.get_component_rich_style("table--cursor"), "►")
        return self._drawn(cells, base + self._tone(self._row_tone(row)))

    def _drawn(self, cells: Mapping[Column[T], Cell], style: Style, mark: str = " ") -> Strip:
        """Draw a row after its mark, each cell in its own tone where it has one."""
        segments = [Segment(self._shown(mark), style)]
        for n, (column, cell) in enumerate(cells.items()):
            text, tone = cell if isinstance(cell, tuple) else (cell, "")
            width = self._width(column, cells)
            text = self._fit(self._shown(clean(text)), width, right=column.right)
            segments += [Segment(" ", style)] * bool(n)
            segments.append(Segment(self._shown(text), style + self._tone(tone)))
        return self._strip(segments, style)

    def _strip(self, segments: Sequence[Segment], style: Style) -> Strip:
        return Strip(segments).adjust_cell_length(self.size.width, style).crop(0, self.size.width)

    def _shown(self, text: str) -> str:
        return to_ascii(text) if _is_plain(self) else text

    def _tone(self, tone: str) -> Style:
        """Return the style of a tone, ``*`` before it for bold."""
        name = tone.removeprefix("*")
        colour = self.app.theme_variables[name] if name else None
        return Style(color=colour, bold=tone != name or None)

    def _width(self, column: Column[T], columns: Collection[Column[T]]) -> int:
        if not column.grows:
            return column.width
        others = sum(each.width + 1 for each in columns if each is not column)
        room = self.scrollable_content_region.width  # beside the bar
        return max(room - 1 - others, column.width)

    @staticmethod
    def _fit(text: str, width: int, *, right: bool) -> str:
        """Return text in exactly so many cells; a wide letter takes two."""
        if cell_len(text) > width:
            return set_cell_size(text, width - 1) + "…"
        room = " " * (width - cell_len(text))
        return room + text if right else text + room
