"""One cleaner for every string that a device sends, used at the driver's edge.

The trap: escape sequences, markup and bidirectional marks in a device's text reach terminals,
logs and reports raw and act there.
"""

from __future__ import annotations

import re

LONGEST = 200
UNSAFE = re.compile(  # the last range: bytes of a file's name that are no text
    "[\x00-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff]"
)


def clean(text: str) -> str:
    """Return ``text`` without control and direction characters, at most 200 characters long."""
    return UNSAFE.sub("", text)[:LONGEST].strip()
