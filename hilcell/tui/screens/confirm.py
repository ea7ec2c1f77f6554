"""One question, asked where an act cannot be taken back: Enter or y does it, q or n does not."""

from __future__ import annotations

from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.content import Content
from textual.screen import ModalScreen

from hilcell.tui.panel import Panel


class Confirm(ModalScreen[str]):
    """Returns the key that was pressed: ``yes``, ``no``, or one of the others offered."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y,enter", "reply('yes')", show=False, priority=True),
        Binding("n,q,backspace", "reply('no')", show=False, priority=True),
    ]

    def __init__(self, title: str, text: str, yes: str, no: str = "no") -> None:
        super().__init__()
        self._title, self._text, self._yes, self._no = title, text, yes, no

    def compose(self) -> ComposeResult:
        """Build the dialog."""
        with Vertical(id="dialog"):
            yield Panel("question")

    def on_mount(self) -> None:
        """Show the question."""
        self.query_one("#question", Panel).show(
            Content.assemble(
                (self._title, "bold $warn"),
                "\n",
                self._text,
                "\n\n",
                (" Enter ", "bold $on-quiet on $quiet"),
                f" {self._yes}   ",
                (" q ", "bold $on-quiet on $quiet"),
                f" {self._no}",
            )
        )

    def action_reply(self, word: str) -> None:
        """Close with the answer."""
        self.dismiss(word)
