"""A line or box of text that repaints only when its text has changed, and shows nothing raw.

Every text of the screen passes here: control and direction characters are replaced, so that a
device's or an operator's words can never reach the terminal as commands.
"""

from __future__ import annotations

from typing import Protocol, cast

from textual.content import Content
from textual.widgets import Static

from hilcell.clean import UNSAFE
from hilcell.tui.terminal.glyphs import Glyphs, to_ascii


class Drawn(Protocol):
    """The application: which shapes its terminal can show."""

    glyphs: Glyphs


def harmless(content: Content, *, plain: bool) -> Content:
    """Return content of the same length whose characters are all safe to print."""
    text = "\n".join(UNSAFE.sub("?", line) for line in content.plain.split("\n"))
    return Content(to_ascii_lines(text) if plain else text, spans=list(content.spans))


def to_ascii_lines(text: str) -> str:
    """Return text in ASCII, line by line."""
    return "\n".join(to_ascii(line) for line in text.split("\n"))


class Panel(Static):
    """Shows content; never reads markup."""

    def __init__(self, id: str | None = None, *, classes: str | None = None) -> None:
        super().__init__("", markup=False, id=id, classes=classes)
        self.content_shown: Content | None = None

    def show(self, content: Content | str) -> None:
        """Show content, where it differs from what is shown."""
        wanted = Content(content) if isinstance(content, str) else content
        safe = harmless(wanted, plain=cast("Drawn", self.app).glyphs.plain)
        if self.content_shown is None or not same(safe, self.content_shown):
            self.content_shown = safe
            self.update(safe)


def same(one: Content, other: Content) -> bool:
    """Whether two contents look the same."""
    return one.plain == other.plain and one.spans == other.spans
