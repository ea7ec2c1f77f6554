"""Earlier runs: a list with a filter, and the comparison of two."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import msgspec
from textual.app import ComposeResult
from textual.content import Content

from hilcell.errors import HilcellError
from hilcell.report.comparison import CHANGES, Change, Setting
from hilcell.tui.engine import process
from hilcell.tui.engine.background import run_in_thread
from hilcell.tui.keys import shown
from hilcell.tui.screens.base import Page
from hilcell.tui.screens.pages import CHOOSE, FilterScreen
from hilcell.tui.text.tables import columns_for, history_row
from hilcell.tui.widgets import Column, Row, Table, TextPanel
from hilcell.typed import decoded

if TYPE_CHECKING:
    from hilcell.journal.index import RunRow


class HistoryPage(FilterScreen, Page):
    """Element 12. The rows come from the index; a run is read only when it is opened."""

    TO_COMPARE = 2
    AGAIN_S = 3.0

    title_text = "History"
    footer = ("mark", "compare", "find", "stop", "quit")
    fixed: ClassVar[tuple[tuple[str, str], ...]] = (
        *Page.fixed,
        ("Enter", "open"),
        CHOOSE,
    )

    def __init__(self) -> None:
        super().__init__()
        self._runs: list[RunRow] = []
        self._marked: list[str] = []
        self._reading = False

    def body(self) -> ComposeResult:
        yield Table(columns_for(self.line_width), empty="reading the index ...")
        yield self.filter_box("filter: words, state:faulted, operator:ann, -word")

    def begin(self) -> None:
        """Read the index off the thread that takes keys."""
        super().begin()
        self._read_index()
        self.set_interval(self.AGAIN_S, self._read_index)  # runs begin and end

    def on_resize(self) -> None:
        """Show as many columns as fit; Textual calls the base class's, too."""
        if self.is_shown:
            self.filter_rows()

    def _read_index(self) -> None:
        """Read, once at a time: the first index of many runs takes a while."""
        if not self._reading:
            self._reading = True
            self.application.start_task(self._read())

    async def _read(self) -> None:
        from hilcell.journal.index import read_index

        try:
            self._runs = await run_in_thread(read_index, self.application.options.runs)
        finally:
            self._reading = False
        if self.is_shown:
            self.query_one(Table).empty = "no such run"
            self.filter_rows()

    def filter_rows(self) -> None:
        from hilcell.journal.index import matches

        found = [run for run in self._runs if matches(run, self.filter_text)]
        wide = self.line_width
        rows = [history_row(run, self._marked, wide) for run in found]
        self.query_one(Table).show_rows(rows, columns_for(wide))
        title = f"History: {len(found)} of {len(self._runs)} runs; errors in mm"
        self.panel("title").show(Content.styled(title, "bold"))

    def on_table_row_selected(self, message: Table.RowSelected) -> None:
        if message.key:
            self.application.open_run(self.application.options.runs / message.key)

    def do_mark(self) -> None:
        """Mark a run, or take its mark away; of more than two the oldest mark goes."""
        key = self.query_one(Table).key
        if key in self._marked:
            self._marked.remove(key)
        elif key:
            self._marked = [*self._marked, key][-self.TO_COMPARE :]
        self.filter_rows()

    def do_compare(self) -> None:
        if len(self._marked) != self.TO_COMPARE:
            self.show_notice(
                f"mark two runs with {shown(self.application.keymap['mark'][0])} first"
            )
            return
        first, second = sorted(self._marked)
        self.app.push_screen(ComparePage(first, second))


class ComparePage(Page):
    """Shows the output of `hilcell compare` for two runs."""

    COLUMNS = (
        Column("where", 16),
        Column("what", 20),
        Column("first", 7, right=True),
        Column("second", 7, right=True),
        Column("change", 8, right=True),
        Column("limit", 7, right=True),
        Column("verdict", 7),
    )

    title_text = "Comparison"
    footer = ("stop", "quit")

    def __init__(self, first: str, second: str) -> None:
        super().__init__()
        self._first, self._second = first, second

    def body(self) -> ComposeResult:
        yield TextPanel("comparison_text")
        yield Table(self.COLUMNS, empty="reading both journals ...")

    def begin(self) -> None:
        super().begin()
        self.application.start_task(self._compare())

    async def _compare(self) -> None:
        runs = str(self.application.options.runs)
        command = ("compare", self._first, self._second, "--runs", runs, "--json")
        try:
            found = decoded(await process.run_command(*command), Compared)
        except HilcellError:
            if self.is_shown:
                self.query_one(Table).empty = "nothing to compare"
                self.query_one(Table).refresh()
            raise
        if self.is_shown:
            self.panel("comparison_text").show(found.words)
            self.query_one(Table).show_rows(found.rows)


class Compared(msgspec.Struct, frozen=True, kw_only=True):
    """Two runs as `hilcell compare --json` prints them, by their names."""

    first: str
    second: str
    verdict: str
    settings: list[Setting]
    changes: list[Change]

    @property
    def words(self) -> Content:
        """Return which runs, in what they differ, and the verdict."""
        lines = [f"{self.first}  ->  {self.second}"]
        lines += [
            f"{each.key}: {each.first or '-'} -> {each.second or '-'}" for each in self.settings[:4]
        ]
        return Content.assemble("\n".join(lines), "\n", (self.verdict, "bold"))

    @property
    def rows(self) -> list[Row]:
        """Return a row for each change; one beyond its limit is coloured."""
        rows = []
        for each in self.changes:
            where, what, *figures, unit, verdict = (
                column.text(column.of(each), minus="-") for column in CHANGES
            )
            tone = "fault" if each.verdict == "beyond" else ""
            cells = where, f"{what}, {unit}", *figures, verdict
            rows.append(Row(f"{each.place}/{each.what}", cells, tone))
        return rows
