"""URScript as lines: one statement a line, comments left out, the texts of strings blanked.

Every statement keeps the columns of its line, so that a number can be replaced and all else stays
byte for byte. Names are sensitive to case.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass

from drivers.program_text import MARK, Number
from hilcell.clean import clean
from hilcell.ports import HilcellError

LONGEST_QUOTE = 80
NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
POSE = re.compile(r"p\[\s*" + r"\s*,\s*".join(f"({NUMBER})" for _ in range(6)) + r"\s*\]", re.ASCII)
_QUIET = re.compile(r"\"[^\"]*\"|#.*")


class UrScriptError(HilcellError):
    """A statement that is refused; the message says why, its reader says where."""


@dataclass(frozen=True, slots=True)
class Statement:
    """The code of one line, and the character of the file at which it starts."""

    line: int
    start: int
    code: str
    source: str

    @property
    def quoted(self) -> str:
        """Return it as the file has it, for messages."""
        text = clean(self.source)
        return text if len(text) <= LONGEST_QUOTE else f"{text[: LONGEST_QUOTE - 3]}..."


def statements(text: str) -> Iterator[Statement]:
    """Yield the statements of a file."""
    start = 0
    for line, whole in enumerate(text.split("\n"), start=1):
        code = _QUIET.sub(_blank, whole)
        if not start and code.startswith(MARK):
            code = " " * len(MARK) + code[len(MARK) :]
        bare = code.strip()
        if bare:
            at = len(code) - len(code.lstrip())
            source = whole[at : at + len(bare)]
            yield Statement(line, start + at, bare, source)
        start += len(whole) + 1


def comments(text: str) -> Iterator[str]:
    """Yield what stands behind a ``#``."""
    for line in text.split("\n"):
        for match in _QUIET.finditer(line):
            if match.group().startswith("#"):
                yield match.group()[1:]


def _blank(match: re.Match[str]) -> str:
    text = match.group()
    return " " * len(text) if text.startswith("#") else f'"{" " * (len(text) - 2)}"'


def split(text: str) -> list[str]:
    """Split arguments at commas outside of all brackets; raises `UrScriptError`."""
    parts, depth, begin = list[str](), 0, 0
    for at, sign in enumerate(text):
        depth += (sign in "([") - (sign in ")]")
        if depth < 0:
            break
        if depth == 0 and sign == ",":
            parts.append(text[begin:at])
            begin = at + 1
    if depth:
        raise UrScriptError("its brackets do not close on its line")
    return [*parts, text[begin:]]


def pose(text: str, start: int) -> list[Number] | None:
    """Return the numbers of ``p[x, y, z, rx, ry, rz]``, None where it is no such pose.

    ``text`` begins at the character ``start`` of its file. Raises `UrScriptError` for a number
    beyond any range.
    """
    match = POSE.fullmatch(text)
    if match is None:
        return None
    found = [Number(match[n], start + match.start(n), start + match.end(n)) for n in range(1, 7)]
    if not all(math.isfinite(each.value) for each in found):
        raise UrScriptError("a number of its pose is not finite")
    return found
