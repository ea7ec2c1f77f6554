"""One of a few words, chosen with left and right or the space bar."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from textual.binding import Binding, BindingType

from hilcell.tui.widgets.panel import Panel


class Choice(Panel, can_focus=True):
    """Shows the chosen word between arrows."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left", "turn(-1)", show=False, priority=True),  # in the order typed
        Binding("right,space", "turn(1)", show=False, priority=True),
    ]

    def __init__(self, words: Sequence[str], id: str) -> None:
        super().__init__(id=id, classes="choice")
        self.words, self.index = tuple(words), 0

    @property
    def value(self) -> str:
        """Return the chosen word."""
        return self.words[self.index]

    def on_mount(self) -> None:
        """Show the first word."""
        self._draw()

    def action_turn(self, step: int) -> None:
        """Choose the next word."""
        self.index = (self.index + step) % len(self.words)
        self._draw()

    def _draw(self) -> None:
        self.show(f"< {self.value} >")
