"""The capabilities of the terminal, judged by its environment, and the glyphs for it.

A locale that is named and is not UTF-8 means ASCII: a glyph that a terminal cannot show breaks the
lines of 80 columns. No named locale, as in containers and over bare SSH, counts as UTF-8, which
terminals have had for decades. Terminals are judged by name because slim containers have no
terminfo. To override: ``LC_ALL=C.UTF-8``, ``TERM=xterm``.

Where Python finds no UTF-8 in the locale, it writes its own LC_CTYPE into the environment
(PEP 538); ``coerced`` leaves that out.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass


def has_colours(environment: Mapping[str, str]) -> bool:
    """Whether the terminal has colours and NO_COLOR is not set (https://no-color.org)."""
    return not environment.get("NO_COLOR") and not _is_colourless(environment)


def has_unicode(environment: Mapping[str, str], *, coerced: bool = False) -> bool:
    """Whether the terminal shows more than ASCII; ``coerced``: Python set LC_CTYPE."""
    # The kernel's console has 256 or 512 shapes, ours not among them.
    if _is_colourless(environment) or environment["TERM"] == "linux":
        return False
    names = ("LC_ALL", "LANG") if coerced else ("LC_ALL", "LC_CTYPE", "LANG")
    locale = next((environment[name] for name in names if environment.get(name)), "")
    return not locale or re.search(r"utf-?8", locale, re.IGNORECASE) is not None


def is_coerced() -> bool:
    """Whether this Python found no UTF-8 in its locale."""
    return bool(sys.flags.utf8_mode)


def _is_colourless(environment: Mapping[str, str]) -> bool:
    colourless = r"|dumb|unknown|vt52|vt[1-4]\d\d(-.*)?|.*-m(ono)?"
    return re.fullmatch(colourless, environment.get("TERM", "")) is not None


@dataclass(frozen=True, slots=True)
class Glyphs:
    """One set of shapes; each is a single column wide, but for the two bars of a pause.

    These and other shapes are written as they are: `to_ascii` replaces them where there is ASCII
    only.
    """

    states: dict[str, str]
    fresh: str = "●"
    moving: str = "►"
    stale: str = "○"
    lost: str = "×"
    locked: str = "■"
    gone: str = "□"
    warned: str = "▲"
    done: str = "√"
    degree: str = "°"
    plain: bool = False


UNICODE = Glyphs({
    "looking": "○", "idle": "○", "checking": "○", "running": "►", "pausing": "▌▌",
    "paused": "▌▌", "suspended": "?", "stopping": "▼", "done": "●", "intolerant": "▲",
    "aborted": "□", "fault": "×", "refused": "×", "silent": "×", "unreadable": "×", "gone": "×",
})  # fmt: skip
ASCII = Glyphs(
    UNICODE.states | {"pausing": "||", "paused": "||", "aborted": "#"}, degree="", plain=True
)

_PLAIN = str.maketrans(
    {
        "─": "-", "│": "|", "┌": "+", "┐": "+", "└": "+", "┘": "+", "├": "+", "┤": "+", "┬": "+",
        "┴": "+", "┼": "+", "═": "=", "║": "|", "╔": "+", "╗": "+", "╚": "+", "╝": "+",
        "►": ">", "◄": "<", "▲": "!", "▼": "V", "■": "#", "□": "=", "●": "*", "○": "o", "×": "X",
        "√": "v", "•": "*", "█": "#", "▀": "'", "▄": "_", "▌": "#", "▐": "#", "░": ".", "▒": "%",
        "▓": "#", "−": "-", "≤": "<", "°": " ", "±": "~", "·": ".", "…": "~", "⚠": "!", "→": ">",
    }
)  # fmt: skip


def to_ascii(text: str) -> str:
    """Return ``text`` in ASCII, letter by letter: known shapes by a similar one, others as ``?``.

    Shapes of the design are from the WGL4 set, which terminals' fonts have.
    """
    return text.translate(_PLAIN).encode("ascii", "replace").decode()
