"""KRL text as statements of tokens: one statement a line, comments and ``&`` headers left out.

A byte order mark at the begin is passed over.

Every token knows where it stands, so that a number can be replaced and all else stays byte for
byte. ``;`` within a string starts no comment, and names ignore case.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from drivers.program_text import MARK
from hilcell.ports import HilcellError

_TOKEN = re.compile(
    rf"""(?P<skip>\A{MARK}(?:&[^\n]*)?|^&[^\n]*|;[^\n]*|[^\S\n]+)
      | (?P<end>\n)
      | (?P<string>"[^"\n]*"|'[^'\n]*')
      | (?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)
      | (?P<word>[\#$]?[A-Za-z_$][\w$]*)
      | (?P<sign>==|<=|>=|<>|.)""",
    re.VERBOSE | re.ASCII | re.MULTILINE,
)


class KrlError(HilcellError):
    """KRL that cannot be read; the message says what, its reader says where."""


@dataclass(frozen=True, slots=True)
class Token:
    """``word`` is the text in capitals; ``start`` counts characters from the file's begin."""

    kind: str
    text: str
    start: int

    @property
    def word(self) -> str:
        """Return the text in capitals, as KRL compares names."""
        return self.text.upper()

    @property
    def end(self) -> int:
        """Return where the next character stands."""
        return self.start + len(self.text)


@dataclass(frozen=True, slots=True)
class Statement:
    """The code of one line; never empty."""

    line: int
    tokens: tuple[Token, ...]

    @property
    def head(self) -> str:
        """Return the first word."""
        return self.tokens[0].word

    @property
    def is_label(self) -> bool:
        """Whether it is a place ``NAME:`` that a GOTO leads to."""
        return len(self.tokens) == 2 and self.tokens[1].text == ":"

    @property
    def is_at_any_time(self) -> bool:
        """Whether it declares an interrupt or a trigger."""
        return any(token.word in ("INTERRUPT", "TRIGGER") for token in self.tokens[:2])

    @property
    def begins(self) -> str:
        """Return the name of the program or function that it begins; "" for all others."""
        words = [token.word for token in self.tokens if token.kind == "word"]
        words = words[1:] if words[:1] == ["GLOBAL"] else words
        at = {"DEF": 1, "DEFFCT": 2}.get(words[0] if words else "", len(words))
        return words[at] if at < len(words) else ""


def statements(text: str) -> Iterator[Statement]:
    """Yield the statements of a file."""
    line, found = 1, list[Token]()
    for match in _TOKEN.finditer(text):
        kind = str(match.lastgroup)
        if kind == "end":
            if found:
                yield Statement(line, tuple(found))
            line, found = line + 1, []
        elif kind != "skip":
            found.append(Token(kind, match.group(), match.start()))
    if found:
        yield Statement(line, tuple(found))


def split(tokens: Sequence[Token], sign: str) -> list[Sequence[Token]]:
    """Split tokens at a sign that stands outside of all brackets."""
    parts, depth, begin = list[Sequence[Token]](), 0, 0
    for n, token in enumerate(tokens):
        depth += (token.text in "([{") - (token.text in ")]}")
        if depth == 0 and token.text == sign:
            parts.append(tokens[begin:n])
            begin = n + 1
    return [*parts, tokens[begin:]]


def closing(tokens: Sequence[Token], at: int) -> int:
    """Return where the bracket that opens at ``at`` closes; raises `KrlError`."""
    depth = 0
    for n in range(at, len(tokens)):
        depth += (tokens[n].text in "([{") - (tokens[n].text in ")]}")
        if depth == 0:
            return n
    raise KrlError(f"{tokens[at].text!r} is not closed on its line")


def text_of(tokens: Sequence[Token]) -> str:
    """Return tokens as one word in capitals, for comparison."""
    return "".join(token.word for token in tokens)


def quoted(tokens: Sequence[Token]) -> str:
    """Return tokens as the source has them, for messages; blanks between them are one."""
    gaps = (" " * (later.start > before.end) for before, later in pairwise(tokens))
    return "".join(gap + token.text for gap, token in zip(("", *gaps), tokens, strict=False))
