"""Scroll bars of whole cells: no fractions of blocks, which some fonts and ASCII have not."""

from __future__ import annotations

from typing import ClassVar

from textual.scrollbar import ScrollBarRender


class WholeBar(ScrollBarRender):
    """Draws the bar as reversed spaces, so that it is seen without colours, too."""

    VERTICAL_BARS: ClassVar[list[str]] = [" "]
    HORIZONTAL_BARS: ClassVar[list[str]] = [" "]
