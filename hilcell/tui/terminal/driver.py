"""Textual's terminal driver, with two differences: Esc acts the moment its byte arrives, and
without colours none is written.

Textual waits to see whether Esc begins a longer sequence, and hands keys to an event loop that may
be drawing. Neither may delay a stop, so the thread that reads the terminal calls it. The price: Alt
with a letter, and a sequence that is cut right after its Esc, also stop the run.

The same thread covers the state of a live run where the screen was not painted for some seconds: on
a PC that has no time for it, RUNNING would stay long after the end.

Textual has a filter for colours, but it leaves greys. Here the colours are removed from every SGR
sequence (ECMA-48, 8.3.117). A background of the theme becomes reverse video; a text box, which has
the cursor row's colour but not its weight, is underlined, so that the caret in it is still seen.
Backgrounds are recognised by their exact greys, so Textual must write them in 24 bits.
"""

from __future__ import annotations

import os
import re
import selectors
from codecs import getincrementaldecoder
from collections.abc import Callable
from functools import cache, lru_cache

from textual._xterm_parser import XTermParser
from textual.color import Color
from textual.drivers.linux_driver import LinuxDriver

from hilcell.tui.terminal.themes import PALETTES, ROLES

TICK_S = 0.05
LATE_S = 2.0
LATE = f"\x1b7\x1b[1;2H\x1b[0;7m NOT PAINTED > {LATE_S:g} s\x1b[0m\x1b8"  # over the state


def has_escape(read: bytes) -> bool:
    """Whether these bytes, read at once, hold the Esc key."""
    # Esc that begins no sequence, or as the kitty protocol writes it, however often held.
    escape = rb"\x1b(?![\[\]\\NOPX^_])|\x1b\[27(?:;\d*(?::[12])?)?u"
    return re.search(escape, read) is not None


class StopDriver(LinuxDriver):
    """Calls ``on_escape`` from the input thread; obeys NO_COLOR to the letter."""

    on_escape: Callable[[], object] | None = None
    is_late: Callable[[], bool] | None = None  # whether what is painted is too old
    _covered = False

    def write(self, data: str) -> None:
        super().write(without_colours(data, self._app.theme) if self._app.no_color else data)

    def run_input_thread(self) -> None:
        parser = XTermParser(self._debug)
        decode = getincrementaldecoder("utf-8")("replace").decode
        with selectors.DefaultSelector() as selector:
            selector.register(self.fileno, selectors.EVENT_READ)
            while not self.exit_event.is_set():
                if selector.select(TICK_S):
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
            super().write(LATE)
        self._covered = late

    def _read(self) -> bytes:
        try:
            return os.read(self.fileno, 4096)
        except OSError:
            return b""


BOLD, UNDERLINE, REVERSE = "1", "4", "7"


def without_colours(written: str, theme: str) -> str:
    """Return what Textual writes in a theme, without its colours."""
    style = r"\x1b\[([\d;:]+)m"
    return re.sub(style, lambda found: _style_without_colours(found[1], theme), written)


@lru_cache(1024)
def _style_without_colours(codes: str, theme: str) -> str:
    kept, ground = _split_codes(codes.split(";"))
    tones, boxes = _backgrounds(theme)
    if ground in boxes and BOLD not in kept:
        kept.append(UNDERLINE)
    elif ground in tones | boxes and REVERSE not in kept:
        kept.append(REVERSE)
    return f"\x1b[{';'.join(kept)}m" if kept else ""


def _split_codes(codes: list[str]) -> tuple[list[str], str]:
    """Return the codes that are no colours, and the background's numbers."""
    long = ("38", "48", "58")  # text, background, underline: a kind and its numbers follow
    short = [*range(30, 38), 39, *range(40, 48), 49, 59, *range(90, 98), *range(100, 108)]
    kept, ground = [], ""
    left = iter(codes)
    for code in left:
        if code in long:
            count = {"5": 1, "2": 3}.get(next(left, ""), 0)
            numbers = [next(left, "") for _ in range(count)]
            ground = ";".join(numbers) if code == "48" else ground
        elif code not in map(str, short) and code.partition(":")[0] not in long:
            kept.append(code)
    return kept, ground


@cache
def _backgrounds(theme: str) -> tuple[frozenset[str], frozenset[str]]:
    """Return, in Textual's greys, the fills, and the backgrounds of boxes and cursor."""
    palette = next(each for each in PALETTES if each.name == theme)
    tones = map(Color.parse, (palette.text, palette.badge, *map(palette.fill, ROLES)))
    box = Color.parse(palette.cursor)
    focused = box.tint(Color.parse(palette.text).with_alpha(0.05))  # Textual's `Input:focus`
    return frozenset(map(_monochrome, tones)), frozenset(map(_monochrome, (box, focused)))


def _monochrome(colour: Color) -> str:
    return ";".join(map(str, colour.monochrome.rgb))
