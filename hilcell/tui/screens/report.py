"""The report of a run: its figures here, the whole of it as one HTML file."""

from __future__ import annotations

import os
import webbrowser
from pathlib import Path

from textual.content import Content

from hilcell.errors import HilcellError
from hilcell.tui.engine import process as engine
from hilcell.tui.engine.scene import Scene
from hilcell.tui.screens.pages import TextPage

FILE = "report.html"


class ReportPage(TextPage):
    """Element 17. Both are recomputed from the journal, by the commands of the same names."""

    title_text = "Report"
    footer = ("stop", "history", "quit")

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder = folder
        self._where = "writing the report ..."
        self._figures = "computing the figures from the journal ..."

    def on_mount(self) -> None:
        """Write the report."""
        super().on_mount()
        self.cell.background(self._show_figures())
        self.cell.background(self._write())

    def text(self, scene: Scene | None) -> Content:
        """Return where the file is, and the figures."""
        return Content.assemble((self._where, "bold"), "\n\n", self._figures)

    async def _show_figures(self) -> None:
        runs = str(self._folder.parent)
        try:
            self._figures = await engine.ask_hilcell("show", self._folder.name, "--runs", runs)
        except HilcellError:
            self._figures = "the figures could not be computed"
            raise
        finally:
            self.show_again()

    async def _write(self) -> None:
        path = (self._folder / FILE).resolve()
        runs = str(self._folder.parent)
        try:
            await engine.ask_hilcell("report", self._folder.name, "--runs", runs, "-o", str(path))
        except Exception:
            self._where = "the report was not written"
            self.show_again()
            raise
        self._where = f"report written: {path}"
        if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
            webbrowser.open(path.as_uri())
        self.show_again()
