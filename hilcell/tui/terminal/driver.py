"""Textual's terminal driver, with two differences: Esc acts the moment its byte arrives, and where
there are to be no colours, none is written.

Textual waits to see whether Esc begins a longer sequence, and hands keys to a loop that may be
drawing. Neither may hold up a stop, so the thread that reads the terminal calls it by itself.
The price: Alt with a letter, and a sequence that a bad link tears right after its Esc, stop the
run, too: both look like Esc with the next key.
"""

from __future__ import annotations

import os
import re
import selectors
from codecs import getincrementaldecoder
from collections.abc import Callable

from textual._xterm_parser import XTermParser
from textual.drivers.linux_driver import LinuxDriver

from hilcell.tui.terminal.no_colour import bare

TICK_S = 0.05
# Esc that begins no sequence, or as terminals with the kitty protocol write it, however often held.
_ESCAPE = re.compile(rb"\x1b(?![\[\]\\NOPX^_])|\x1b\[27(?:;\d*(?::[12])?)?u")


def has_escape(read: bytes) -> bool:
    """Whether these bytes, read at once, hold the Esc key."""
    return _ESCAPE.search(read) is not None


class StopDriver(LinuxDriver):
    """Calls ``on_escape`` from the input thread; obeys NO_COLOR to the letter."""

    on_escape: Callable[[], object] | None = None

    def write(self, data: str) -> None:
        """Write what is drawn."""
        super().write(bare(data, self._app.theme) if self._app.no_color else data)

    def run_input_thread(self) -> None:
        """Read the terminal until the screen ends."""
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

    def _read(self) -> bytes:
        try:
            return os.read(self.fileno, 4096)
        except OSError:
            return b""
