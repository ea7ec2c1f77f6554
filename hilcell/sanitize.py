"""Strings from outside, made harmless: at the driver's edge, and again before they are shown.

Escape sequences, markup and bidirectional marks in a device's text would reach terminals, logs and
reports raw and act there. Drivers clean the texts of devices; operator, job and reasons come from
elsewhere, and journal text is untrusted, so all text is cleaned again before it is shown.
"""

from __future__ import annotations

import re
import unicodedata

LONGEST = 200
REPLACEMENT = "\N{REPLACEMENT CHARACTER}"
UNSAFE = re.compile(  # the last range: bytes of a file's name that are no text
    "[\x00-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff]"
)


def clean(text: str) -> str:
    """Return ``text`` without control and direction characters, at most 200 characters long."""
    return UNSAFE.sub("", text)[:LONGEST].strip()


def harmless(text: str) -> str:
    """Return ``text`` with every invisible character replaced by a visible one."""
    invisible = ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")  # controls, formats, separators ..
    category = unicodedata.category
    return "".join(REPLACEMENT if category(each) in invisible else each for each in text)


def harmless_lines(text: str) -> str:
    """Return ``text`` with its line breaks, but no other control characters."""
    return "\n".join(map(harmless, text.split("\n")))


def encodable(text: str) -> str:
    """Return ``text`` with bytes of a file's name that are no text replaced: no JSON holds them."""
    return text.encode(errors="replace").decode()


def counted(count: int, noun: str) -> str:
    """Return a count with its noun: ``1 pose``, ``3 poses``."""
    return f"{count} {noun}{'s' * (count != 1)}"
