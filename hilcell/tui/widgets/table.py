"""A table that draws only the rows in sight: ten thousand runs cost what twenty cost.

Cells are plain text; nothing in them is taken for markup, and control characters are cleaned.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from rich.cells import cell_len, set_cell_size
from rich.segment import Segment
from rich.style import Style
from textual.binding import Binding, BindingType
from textual.geometry import Size
from textual.message import Message
from textual.scroll_view import ScrollView
from textual.strip import Strip

from hilcell.clean import clean
from hilcell.tui.terminal.glyphs import to_ascii
from hilcell.tui.text.columns import Column, Row


class Rows(ScrollView, can_focus=True):
    """Rows under a header, with a cursor. Posts `Chosen` on Enter, `Moved` on a new cursor."""

    COMPONENT_CLASSES: ClassVar[set[str]] = {"rows--head", "rows--cursor"}
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

    class Chosen(Message):
        """A row was chosen with Enter."""

        def __init__(self, key: str) -> None:
            super().__init__()
            self.key = key

    class Moved(Message):
        """The cursor stands on another row."""

        def __init__(self, key: str) -> None:
            super().__init__()
            self.key = key

    def __init__(
        self, columns: Sequence[Column], *, empty: str, plain: bool = False, id: str | None = None
    ) -> None:
        super().__init__(id=id)
        self.columns = tuple(columns)
        self.empty, self.plain = empty, plain
        self.rows: Sequence[Row] = ()
        self.cursor = 0
        self.follow = False  # keep the cursor on the last row while rows come

    @property
    def key(self) -> str:
        """Return the key of the row under the cursor, or nothing."""
        return self.rows[self.cursor].key if self.rows else ""

    def put(self, rows: Sequence[Row], columns: Sequence[Column] | None = None) -> None:
        """Show these rows; the cursor stays on its row where that is still there."""
        if columns is not None:
            self.columns = tuple(columns)
        key, at_end = self.key, self.follow and self.cursor >= len(self.rows) - 1
        same = len(rows) > self.cursor and rows[self.cursor].key == key
        if not same:
            found = next((n for n, row in enumerate(rows) if row.key == key), None)
            self.cursor = min(self.cursor, max(len(rows) - 1, 0)) if found is None else found
        self.rows = rows
        self.virtual_size = Size(self.size.width, len(rows) + 1)
        if at_end and rows:
            self.cursor = len(rows) - 1
        self._show_cursor()
        self.refresh()

    def on_resize(self) -> None:
        """Keep the cursor in sight."""
        self.virtual_size = Size(self.size.width, len(self.rows) + 1)
        self._show_cursor()

    def choose(self, key: str) -> None:
        """Put the cursor on a row."""
        found = next((n for n, row in enumerate(self.rows) if row.key == key), None)
        if found is not None:
            self._move(found)

    def action_by(self, step: int) -> None:
        """Move the cursor by some rows."""
        self._move(self.cursor + step)

    def action_page(self, step: int) -> None:
        """Move the cursor by a page."""
        self._move(self.cursor + step * max(self.size.height - 2, 1))

    def action_to(self, index: int) -> None:
        """Move the cursor to the first or the last row."""
        self._move(index if index >= 0 else len(self.rows) + index)

    def action_choose(self) -> None:
        """Say that this row was chosen; the key is empty where there are no rows."""
        self.post_message(self.Chosen(self.key))

    def _move(self, to: int) -> None:
        if not self.rows:
            return
        self.cursor = min(max(to, 0), len(self.rows) - 1)
        self._show_cursor()
        self.refresh()
        self.post_message(self.Moved(self.key))

    def _show_cursor(self) -> None:
        height = max(self.size.height - 1, 1)
        top = int(self.scroll_offset.y)
        if self.cursor < top:
            self.scroll_to(y=self.cursor, animate=False, force=True)
        elif self.cursor >= top + height:
            self.scroll_to(y=self.cursor - height + 1, animate=False, force=True)

    def render_line(self, y: int) -> Strip:
        """Draw one line: the header stays, the rows scroll under it."""
        width = self.size.width
        if y == 0:
            style = self.get_component_rich_style("rows--head")
            titles = [column.title for column in self.columns]
            return self._strip(self._line(titles), style, width)
        index = int(self.scroll_offset.y) + y - 1
        base = self.rich_style
        if not self.rows and y == 1:
            return self._strip(self.empty, base, width)
        if index >= len(self.rows):
            return Strip.blank(width, base)
        row = self.rows[index]
        style = base + Style(color=self._colour(row.tone)) if row.tone else base
        if index == self.cursor:
            style = self.get_component_rich_style("rows--cursor")
        return self._strip(self._line(row.cells, cursor=index == self.cursor), style, width)

    def _colour(self, tone: str) -> str:
        return self.app.theme_variables[tone]

    def _strip(self, text: str, style: Style, width: int) -> Strip:
        shown = to_ascii(text) if self.plain else text
        return Strip([Segment(shown, style)]).adjust_cell_length(width, style).crop(0, width)

    def _line(self, cells: Sequence[str], *, cursor: bool = False) -> str:
        safe = [to_ascii(clean(cell)) if self.plain else clean(cell) for cell in cells]
        parts = [_fit(text, column) for text, column in zip(safe, self.columns, strict=False)]
        return (">" if cursor else " ") + " ".join(parts)


def _fit(text: str, column: Column) -> str:
    """Return text in exactly as many cells as the column has; a wide letter takes two."""
    if cell_len(text) > column.width:
        return set_cell_size(text, column.width - 1) + "…"
    room = " " * (column.width - cell_len(text))
    return room + text if column.right else text + room
