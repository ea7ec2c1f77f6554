"""What commands say on stderr, for people; data goes to stdout.

The trap: names of folders, values of cell files and words of a journal are anybody's, and escape
sequences in them act on the terminal.
"""

from __future__ import annotations

import sys

from hilcell.clean import harmless


def tell(text: str) -> None:
    """Print lines on stderr, with nothing in them that a terminal obeys."""
    print(harmless_lines(text), file=sys.stderr)


def harmless_lines(text: str) -> str:
    """Return ``text`` with its lines, and nothing else in it that a terminal obeys."""
    return "\n".join(map(harmless, text.split("\n")))
