"""Pages over a run: alarms, interlocks, one point, report and event log."""

from __future__ import annotations

import os
import webbrowser
from abc import abstractmethod
from pathlib import Path

import msgspec
from textual.app import ComposeResult
from textual.containers import VerticalScroll
from textual.content import Content
from textual.widgets import Input

from hilcell.errors import HilcellError
from hilcell.tui.engine import process
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.layout import BLANK, Lines, Stack
from hilcell.tui.screens.base import BaseScreen, Page
from hilcell.tui.text.devices import interlock_page
from hilcell.tui.text.finished import report_lines
from hilcell.tui.text.points import point_page
from hilcell.tui.text.tables import log_columns, record_row
from hilcell.tui.widgets import Row, Table, TextField, TextPanel
from hilcell.typed import Json, decoded


class TextPage(Page):
    """A page of text that scrolls."""

    fixed = (*Page.fixed, ("▲▼", "scroll"))

    def body(self) -> ComposeResult:
        with VerticalScroll(classes="scroll", id="body", can_focus=True):
            yield TextPanel("text")

    def show(self, view: RunView | None) -> None:
        super().show(view)
        self.panel("text").show(self.text(view))

    @abstractmethod
    def text(self, view: RunView | None) -> Content | Lines:
        """Return the text of the page."""


class AlarmPage(TextPage):
    """Every alarm: its meaning, its place, the steps to take."""

    title_text = "Alarms"
    footer = ("stop", "acknowledge", "pause", "quit")

    def text(self, view: RunView | None) -> Content | Lines:
        """Return the alarms, newest first."""
        if view is None:
            return Content("")
        return self.alarm_context().page(view.alarms, self.application.shown_session.latch)


class InterlockPage(TextPage):
    """The interlocks: each condition of motion, and the last reading of each device."""

    title_text = "Interlocks: conditions before anything moves"
    footer = ("stop", "pause", "quit")

    def text(self, view: RunView | None) -> Content:
        return interlock_page(view, self.application.glyphs) if view is not None else Content("")


class DetailPage(TextPage):
    """One point, with everything that is known of it."""

    title_text = "One point"
    footer = ("stop", "pause", "alarms", "retake", "quit")

    def __init__(self, key: str) -> None:
        super().__init__()
        self._key = key

    def text(self, view: RunView | None) -> Content | Lines:
        return point_page(view, self._key) if view is not None else BLANK

    def do_retake(self) -> None:
        self.application.retake(self._key)


BEGIN = "1970-01-01T00:00:00+00:00"  # before any record is read
CHOOSE = ("▲▼", "move")


class FilterScreen(BaseScreen):
    """A screen with rows and a filter; ``filter_text`` is what was typed."""

    in_box = (("Enter", "to the rows"),)  # from the filter
    filter_text = ""

    def filter_box(self, hint: str) -> Input:
        """Return the filter's text box, shown under the rows."""
        box = TextField(placeholder=hint, id="find")
        box.display = False
        return box

    @abstractmethod
    def filter_rows(self) -> None:
        """Show the rows that match the filter."""

    def do_find(self) -> None:
        box = self.query_one("#find", Input)
        box.display = True
        self.set_focus(box)  # at once: keys typed ahead belong into it

    def on_input_changed(self, message: Input.Changed) -> None:
        self.filter_text = message.value
        message.input.display = bool(message.value) or message.input.has_focus  # never unseen
        self.filter_rows()

    def on_input_submitted(self) -> None:
        """Keep the filter and go back to the rows; an empty one closes."""
        box = self.query_one("#find", Input)
        box.display = bool(box.value)
        self.set_focus(self.query_one(Table))  # at once, as above


class LogPage(FilterScreen, Page):
    """Element 13: the newest two thousand records; the journal keeps all."""

    title_text = "Event log"
    fixed = (*Page.fixed, CHOOSE)
    footer = ("stop", "find", "pause", "quit")

    def __init__(self) -> None:
        super().__init__()
        self._rows: list[Row] = []
        self._seq = 0

    def body(self) -> ComposeResult:
        rows = Table(log_columns(BEGIN), empty="no records")
        rows.follow = True
        yield rows
        yield self.filter_box("filter: words of a record")

    def begin(self) -> None:
        super().begin()
        self.query_one(Table).action_to(-1)

    def show(self, view: RunView | None) -> None:
        """Add what is new."""
        super().show(view)
        if view is None:
            return
        fresh = [record for record in view.records if record.seq > self._seq]
        if fresh:
            self._seq = fresh[-1].seq
            self._rows += [record_row(record) for record in fresh]
            self.filter_rows()

    def filter_rows(self) -> None:
        words = self.filter_text.lower().split()
        wanted = [row for row in self._rows if all(w in " ".join(row.cells).lower() for w in words)]
        view = self.application.view
        begun = view.records[0].t if view is not None and view.records else BEGIN
        self.query_one(Table).show_rows(wanted, log_columns(begun))


class ReportPage(TextPage):
    """Element 17. Both are recomputed from the journal, by the commands of the same names."""

    title_text = "Report"
    footer = ("stop", "history", "quit")

    def __init__(self) -> None:
        super().__init__()
        self._where = "writing the report ..."
        self._state = "computing the figures from the journal ..."
        self._figures: Json | None = None

    def begin(self) -> None:
        super().begin()
        folder = self.application.shown_session.folder
        self.application.start_task(self._show_figures(folder))
        self.application.start_task(self._write(folder))

    def text(self, view: RunView | None) -> Lines:
        where = self._where, "bold"
        if self._figures is None:
            return Stack(where, BLANK, self._state)
        log = view.log if view is not None else None
        return Stack(where, BLANK, report_lines(self._figures, log))

    async def _show_figures(self, folder: Path) -> None:
        runs = str(folder.parent)
        try:
            text = await process.run_command("show", folder.name, "--json", "--runs", runs)
            self._figures = decoded(text.partition("\n")[0], Json)  # remarks follow
        except (HilcellError, msgspec.DecodeError) as error:
            self._state = "the figures could not be computed"
            if isinstance(error, HilcellError):
                raise
            raise HilcellError(f"hilcell show: no figures in its output: {error}") from error
        finally:
            self.show_again()

    async def _write(self, folder: Path) -> None:
        path, runs = (folder / "report.html").resolve(), str(folder.parent)
        try:
            await process.run_command("report", folder.name, "--runs", runs, "-o", str(path))
        except Exception:
            self._where = "the report was not written"
            self.show_again()
            raise
        self._where = f"report written: {path}"
        if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
            webbrowser.open(path.as_uri())
        self.show_again()
