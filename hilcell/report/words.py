"""Strings of a journal, made harmless to look at.

Drivers clean what devices say, but operator, job and reasons come from elsewhere, and a journal
can be written by anybody. The trap: direction marks reorder what a reader sees, even escaped.
"""

from __future__ import annotations

import unicodedata

REPLACEMENT = "\N{REPLACEMENT CHARACTER}"
_UNSEEN = ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")  # controls, formats, surrogates, separators


def harmless(text: str) -> str:
    """Return ``text`` with every character that is not seen as itself replaced, so it shows."""
    return "".join(
        REPLACEMENT if unicodedata.category(character) in _UNSEEN else character
        for character in text
    )


def encodable(text: str) -> str:
    """Return ``text`` with bytes of a file's name that are no text replaced: no JSON holds them."""
    return text.encode(errors="replace").decode()
