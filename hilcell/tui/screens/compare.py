"""Two runs side by side: what has drifted between two calibrations."""

from __future__ import annotations

from textual.content import Content

from hilcell.tui import engine
from hilcell.tui.scene import Scene
from hilcell.tui.screens.pages import TextPage


class ComparePage(TextPage):
    """Shows what `hilcell compare` says of two runs."""

    title_text = "Comparison"
    footer = ("stop", "quit")

    def __init__(self, first: str, second: str) -> None:
        super().__init__()
        self._first, self._second = first, second
        self._found = "reading both journals ..."

    def on_mount(self) -> None:
        """Compare."""
        super().on_mount()
        self.cell.background(self._compare())

    def text(self, scene: Scene | None) -> Content:
        """Return the comparison."""
        return Content(self._found)

    async def _compare(self) -> None:
        runs = str(self.cell.options.runs)
        try:
            self._found = await engine.ask_hilcell(
                "compare", self._first, self._second, "--runs", runs
            )
        except Exception:
            self._found = "the runs could not be compared"
            self.show_again()
            raise
        self.show_again()
