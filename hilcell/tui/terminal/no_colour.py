"""Output without colours: what a background told is told by reverse video.

Textual has a filter of its own for this, but greys are colours, too. Here every SGR sequence
(ECMA-48, 8.3.117) that leaves is freed of colours. A background that the theme names is reversed;
a text box, which has the cursor row's colour but not its weight, is underlined, so that the caret
in it is still seen.

The trap: backgrounds are known by their exact greys, so Textual must write them in 24 bits.
"""

from __future__ import annotations

import re
from functools import cache, lru_cache

from textual.color import Color

from hilcell.tui.terminal.themes import PALETTES, TONES

_SGR = re.compile(r"\x1b\[([\d;:]+)m")
_LONG = ("38", "48", "58")  # text, background, underline: a kind and its numbers follow
_NUMBERS = {"5": 1, "2": 3}
_SHORT = frozenset(
    map(str, [*range(30, 38), 39, *range(40, 48), 49, 59, *range(90, 98), *range(100, 108)])
)
FOCUS_TINT = 0.05  # of the text's colour, as in Textual's style of `Input:focus`
BOLD, UNDERLINE, REVERSE = "1", "4", "7"


def bare(written: str, theme: str) -> str:
    """Return what Textual writes in a theme, without its colours."""
    return _SGR.sub(lambda found: _bare_style(found[1], theme), written)


@lru_cache(1024)
def _bare_style(codes: str, theme: str) -> str:
    kept, ground = _parted(codes.split(";"))
    tones, boxes = _grounds(theme)
    if ground in boxes and BOLD not in kept:
        kept.append(UNDERLINE)
    elif ground in tones | boxes and REVERSE not in kept:
        kept.append(REVERSE)
    return f"\x1b[{';'.join(kept)}m" if kept else ""


def _parted(codes: list[str]) -> tuple[list[str], str]:
    """Return the codes that are no colours, and the background's numbers."""
    kept, ground = [], ""
    left = iter(codes)
    for code in left:
        if code in _LONG:
            numbers = [next(left, "") for _ in range(_NUMBERS.get(next(left, ""), 0))]
            ground = ";".join(numbers) if code == "48" else ground
        elif code not in _SHORT and code.partition(":")[0] not in _LONG:
            kept.append(code)
    return kept, ground


@cache
def _grounds(theme: str) -> tuple[frozenset[str], frozenset[str]]:
    """Return, in Textual's greys, the backgrounds of tones and caret, and of boxes and cursor."""
    palette = next(each for each in PALETTES if each.name == theme)
    tones = (Color.parse(getattr(palette, name)) for name in (*TONES, "text"))
    box = Color.parse(palette.cursor)
    focused = box.tint(Color.parse(palette.text).with_alpha(FOCUS_TINT))
    return frozenset(map(_grey, tones)), frozenset(map(_grey, (box, focused)))


def _grey(colour: Color) -> str:
    return ";".join(map(str, colour.monochrome.rgb))
