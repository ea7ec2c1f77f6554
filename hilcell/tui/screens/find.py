"""A filter under rows: hidden until asked for, it filters as one types."""

from __future__ import annotations

from abc import abstractmethod

from textual.widgets import Input

from hilcell.tui.screens.base import SceneScreen
from hilcell.tui.widgets.field import Field
from hilcell.tui.widgets.table import Rows


class Finding(SceneScreen):
    """A screen with rows and a filter; ``wanted`` is what was typed."""

    in_box = (("Enter", "to the rows"),)
    wanted = ""

    def find_box(self, hint: str) -> Input:
        """Return the filter's box, to stand under the rows."""
        box = Field(placeholder=hint, id="find")
        box.display = False
        return box

    @abstractmethod
    def filter_rows(self) -> None:
        """Show the rows that are wanted."""

    def do_find(self) -> None:
        """Open the filter."""
        box = self.query_one("#find", Input)
        box.display = True
        self.set_focus(box)  # at once: what is typed ahead belongs into it

    def on_input_changed(self, message: Input.Changed) -> None:
        """Filter as one types."""
        self.wanted = message.value
        message.input.display = bool(message.value) or message.input.has_focus  # never unseen
        self.filter_rows()

    def on_input_submitted(self) -> None:
        """Keep the filter and go back to the rows; an empty one closes."""
        box = self.query_one("#find", Input)
        box.display = bool(box.value)
        self.set_focus(self.query_one(Rows))  # at once, as above
