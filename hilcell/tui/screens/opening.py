"""The first thing painted, while the modules that read journals are loaded."""

from __future__ import annotations

from textual.app import ComposeResult
from textual.content import Content

from hilcell import __version__
from hilcell.tui.screens.base import SceneScreen
from hilcell.tui.widgets.panel import Panel

NOT_A_SAFETY_FUNCTION = "hilcell is not a safety function: keep the E-stop in reach."


class Opening(SceneScreen):
    """Says what is being opened."""

    footer = ("quit",)

    def __init__(self, run: str) -> None:
        super().__init__()
        self._run = run

    def compose(self) -> ComposeResult:
        """Build the lines."""
        yield Panel("title")
        yield Panel("what")
        yield Panel("notice")
        yield Panel("keys")

    def on_mount(self) -> None:
        """Show them."""
        self.panel("title").show(Content.styled(f"hilcell {__version__}", "bold"))
        what = f"opening run {self._run} ..." if self._run else "looking for a live run ..."
        self.panel("what").show(f"{what}\n\n{NOT_A_SAFETY_FUNCTION}")
        self.panel("notice").display = False
        super().on_mount()
