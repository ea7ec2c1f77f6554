"""One question, asked where an act cannot be taken back: Enter or y does it, q or n does not."""

from __future__ import annotations

from typing import ClassVar, TypeVar, cast

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.content import Content
from textual.screen import ModalScreen

from hilcell.tui.screens.application import Application
from hilcell.tui.widgets.panel import Panel

T = TypeVar("T")
FRAME = 2  # rows of a dialog's border


class Dialog(ModalScreen[T]):
    """A question and, under it, what may be answered: that stays in sight where room is short."""

    def compose(self) -> ComposeResult:
        """Build the box."""
        with Vertical(id="dialog"):
            yield Panel("question")
            yield Panel("answers")

    @property
    def deliberate(self) -> bool:
        """Whether the key under way is an answer: a scanner's Enter, or a held one, is none."""
        return cast("Application", self.app).unhurried

    def put(self, question: Content, answers: Content) -> None:
        """Show both."""
        self.query_one("#question", Panel).show(question)
        self.query_one("#answers", Panel).show(answers)

    def on_resize(self) -> None:
        """Let the question yield to the answers."""
        question, answers = self.query_one("#question"), self.query_one("#answers")
        room = self.app.size.height - FRAME - answers.size.height
        question.styles.max_height = max(room, 1)


def answer_keys(yes: str, no: str) -> Content:
    """Return the two keys of a dialog with what they do."""
    return Content.assemble(
        (" Enter ", "bold $on-quiet on $quiet"),
        f" {yes}   ",
        (" q ", "bold $on-quiet on $quiet"),
        f" {no}",
    )


class Confirm(Dialog[str]):
    """Returns the key that was pressed: ``yes``, ``no``, or one of the others offered."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y,enter", "reply('yes')", show=False, priority=True),
        Binding("n,q,backspace", "reply('no')", show=False, priority=True),
    ]

    def __init__(self, title: str, text: str, yes: str) -> None:
        super().__init__()
        self._title, self._text, self._yes = title, text, yes

    def on_mount(self) -> None:
        """Show the question."""
        question = Content.assemble((self._title, "bold $warn"), "\n", self._text, "\n")
        self.put(question, answer_keys(self._yes, "no"))

    def action_reply(self, word: str) -> None:
        """Close with the answer."""
        if word != "yes" or self.deliberate:
            self.dismiss(word)
