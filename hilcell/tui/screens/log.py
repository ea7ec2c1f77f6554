"""The journal, record by record, with a filter."""

from __future__ import annotations

from textual.app import ComposeResult

from hilcell.tui.engine.scene import Scene
from hilcell.tui.screens.base import Page
from hilcell.tui.screens.find import Finding
from hilcell.tui.text.columns import Row
from hilcell.tui.text.record import COLUMNS, record_row
from hilcell.tui.widgets.table import Rows


class LogPage(Finding, Page):
    """Element 13: the newest two thousand records; the journal keeps all."""

    title_text = "Event log"
    footer = ("stop", "find", "pause", "quit")

    def __init__(self) -> None:
        super().__init__()
        self._rows: list[Row] = []
        self._seq = 0

    def body(self) -> ComposeResult:
        """Build rows and filter."""
        rows = Rows(COLUMNS, empty="no records", plain=self.cell.glyphs.plain)
        rows.follow = True
        yield rows
        yield self.find_box("filter: words of a record")

    def on_mount(self) -> None:
        """Begin at the newest record."""
        super().on_mount()
        self.query_one(Rows).action_to(-1)

    def show(self, scene: Scene | None) -> None:
        """Add what is new."""
        super().show(scene)
        if scene is None:
            return
        fresh = [record for record in scene.records if record.seq > self._seq]
        if fresh:
            self._seq = fresh[-1].seq
            self._rows += [record_row(record) for record in fresh]
            self.filter_rows()

    def filter_rows(self) -> None:
        """Show the records with all the words."""
        words = self.wanted.lower().split()
        wanted = [row for row in self._rows if all(w in " ".join(row.cells).lower() for w in words)]
        self.query_one(Rows).put(wanted)
