"""What the bytes of a terminal ask for in colours."""

from __future__ import annotations

import re

_SGR = re.compile(rb"\x1b\[([\d;:]*)m")
_PLAIN = {*range(30, 38), 39, *range(40, 48), 49, 59, *range(90, 98), *range(100, 108)}


def colours_of(raw: bytes) -> set[str]:
    """Return the kinds of colour that are asked for: ``16``, ``256``, ``truecolor``."""
    found: set[str] = set()
    for codes in _SGR.findall(raw):
        found |= _colours(codes.decode().split(";"))
    return found


def _colours(codes: list[str]) -> set[str]:
    found: set[str] = set()
    while codes:
        code = codes.pop(0)
        number, _, rest = code.partition(":")
        if number in ("38", "48", "58"):
            kind = rest[:1] or (codes.pop(0) if codes else "")
            found.add("256" if kind == "5" else "truecolor")
            if not rest:
                del codes[: 1 if kind == "5" else 3]
        elif number.isdigit() and int(number) in _PLAIN:
            found.add("16")
    return found
