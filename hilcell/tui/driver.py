"""Textual's terminal driver, with two differences: Esc acts the moment its byte arrives, and
without colours none is written.

Textual waits to see whether Esc begins a longer sequence, and hands keys to an event loop that may
be drawing. Neither may delay a stop, so the thread that reads the terminal calls it. The price: Alt
with a letter, and a sequence that is cut right after its Esc, also stop the run.

The same thread covers the state of a live run where the screen was not painted for some seconds: on
a PC that has no time for it, RUNNING would stay long after the end.

Textual has a filter for colours, but it leaves greys.
"""

from __future__ import annotations

import os
import re
import selectors
from codecs import getincrementaldecoder
from collections.abc import Callable
from functools import cache

from rich.segment import Segment
from rich.style import Style
from textual._xterm_parser import XTermParser
from textual.color import Color
from textual.drivers.linux_driver import LinuxDriver
from textual.filter import LineFilter

from hilcell.tui.themes import PALETTES, ROLES, SIXTEEN_COLOURS

LATE_S = 2.0


def has_escape(read: bytes) -> bool:
    """Whether these bytes, read at once, hold the Esc key."""
    # Esc that begins no sequence, or as the kitty protocol writes it, however often held.
    escape = rb"\x1b(?![\[\]\\NOPX^_])|\x1b\[27(?:;\d*(?::[12])?)?u"
    return re.search(escape, read) is not None


class StopDriver(LinuxDriver):
    """Calls ``on_escape`` from the input thread."""

    TICK_S = 0.05
    LATE_TEXT = f"\x1b7\x1b[1;2H\x1b[0;7m NOT PAINTED > {LATE_S:g} s\x1b[0m\x1b8"  # over the state

    on_escape: Callable[[], object] | None = None
    is_late: Callable[[], bool] | None = None  # whether what is painted is too old
    _covered = False

    def run_input_thread(self) -> None:
        parser = XTermParser(self._debug)
        decode = getincrementaldecoder("utf-8")("replace").decode
        with selectors.DefaultSelector() as selector:
            selector.register(self.fileno, selectors.EVENT_READ)
            while not self.exit_event.is_set():
                if selector.select(self.TICK_S):
                    read = self._read()
                    if not read:  # the terminal is gone: so is the screen, the run is not
                        self._loop.call_soon_threadsafe(self._app.exit)
                        return
                    if self.on_escape is not None and has_escape(read):
                        self.on_escape()
                    for event in parser.feed(decode(read)):
                        self.process_message(event)
                for event in parser.tick():
                    self.process_message(event)
                self._cover_when_late()

    def _cover_when_late(self) -> None:
        """Cover the state once, when what is painted has become too old."""
        late = self.is_late is not None and self.is_late()
        if late and not self._covered:
            self.write(self.LATE_TEXT)
        self._covered = late

    def _read(self) -> bytes:
        try:
            return os.read(self.fileno, 4096)
        except OSError:
            return b""


class WithoutColours(LineFilter):
    """Takes the colours out of all that is painted, in a theme of this name.

    A background of the theme becomes reverse video; a text box, which has the cursor row's colour
    but not its weight, is underlined, so that the caret in it is still seen.
    """

    @classmethod
    @cache  # what it has filtered is kept with it
    def of(cls, theme: str) -> WithoutColours:
        return cls(theme)

    def __init__(self, theme: str) -> None:
        super().__init__()
        palette = next(each for each in (*PALETTES, SIXTEEN_COLOURS) if each.name == theme)
        box = Color.parse(palette.cursor)
        focused = box.tint(Color.parse(palette.text).with_alpha(0.05))  # Textual's `Input:focus`
        fills = map(Color.parse, (palette.text, palette.badge, *map(palette.fill, ROLES)))
        self._boxes = {each.rich_color for each in (box, focused)}
        self._fills = self._boxes | {each.rich_color for each in fills}

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        return [Segment(text, style and self._bare(style)) for text, style, _ in segments]

    def _bare(self, style: Style) -> Style:
        bare = style.without_color
        if style.bgcolor in self._boxes and not style.bold:
            return bare + Style(underline=True)
        return bare + Style(reverse=True) if style.bgcolor in self._fills else bare
