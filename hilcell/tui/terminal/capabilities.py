"""What the terminal at hand can show, as the environment claims it.

A locale that is named and is no UTF-8 means ASCII: a shape that a terminal cannot show tears the
lines of 80 columns. One that is not named at all, as in containers and over bare SSH, says nothing
against UTF-8, which terminals have had for decades. Terminals are judged by name, for slim
containers have no terminfo. The way back is to name the truth: ``LC_ALL=C.UTF-8``, ``TERM=xterm``.

The trap: where Python finds no UTF-8 in the locale, it writes its own into the environment that it
then shows (PEP 538).
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping

_COLOURLESS = re.compile(r"|dumb|unknown|vt52|vt[1-4]\d\d(-.*)?|.*-m(ono)?")
_FEW_SHAPES = "linux"  # the kernel's console: 256 or 512 shapes, ours not among them
_UTF_8 = re.compile(r"utf-?8", re.IGNORECASE)


def has_colours(environment: Mapping[str, str]) -> bool:
    """Whether the terminal has colours, and nobody asked for none (https://no-color.org)."""
    return not environment.get("NO_COLOR") and not _is_colourless(environment)


def has_shapes(environment: Mapping[str, str], *, coerced: bool = False) -> bool:
    """Whether the terminal shows more than ASCII; ``coerced``: LC_CTYPE is Python's own word."""
    if _is_colourless(environment) or environment["TERM"] == _FEW_SHAPES:
        return False
    names = ("LC_ALL", "LANG") if coerced else ("LC_ALL", "LC_CTYPE", "LANG")
    locale = next((environment[name] for name in names if environment.get(name)), "")
    return not locale or _UTF_8.search(locale) is not None


def is_coerced() -> bool:
    """Whether this Python found no UTF-8 in its locale."""
    return bool(sys.flags.utf8_mode)


def _is_colourless(environment: Mapping[str, str]) -> bool:
    return _COLOURLESS.fullmatch(environment.get("TERM", "")) is not None
