"""KRL as statements of tokens, and the points and frame data that they declare.

A statement is a line; comments, ``&`` headers and a byte order mark are left out. Tokens have
positions, so that a number can be replaced byte for byte. ``;`` within a string starts no comment,
and names ignore case. Points are aggregates ``{X 1.0,Y 2.0,...}``; one whose components are plain
values is one token, of the kind "structure".

The trap: a component that an aggregate leaves out keeps its value from the motion before, so that
such a target is relative in disguise.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

from drivers.kuka.krl import POSE
from drivers.program_text import MARK, Number, Token, split
from hilcell.ports import HilcellError

_NUMBER = r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_STRING = r"'[^'\n]*'"
_COMPONENT = rf"[^\S\n]*([A-Za-z]\w*)(?:[^\S\n]+|(?=[-+']))([-+]?{_NUMBER}|{_STRING})[^\S\n]*"
_COMPONENTS = re.compile(_COMPONENT, re.ASCII)
_TOKEN = re.compile(
    rf"""(?P<skip>\A{MARK}(?:&[^\n]*)?|^&[^\n]*|;[^\n]*|[^\S\n]+)
      | (?P<end>\n)
      | (?P<string>"[^"\n]*"|{_STRING})
      | (?P<number>{_NUMBER})
      | (?P<structure>\{{(?:[^\S\n]*[A-Za-z]\w*[^\S\n]*:)?{_COMPONENT}(?:,{_COMPONENT})*\}})
      | (?P<word>[\#$]?[A-Za-z_$][\w$]*)
      | (?P<sign>==|<=|>=|<>|.)""",
    re.VERBOSE | re.ASCII | re.MULTILINE,
)


class KrlError(HilcellError):
    """KRL that cannot be read; the message states what, its reader adds where."""


@dataclass(frozen=True, slots=True)
class Statement:
    """The code of one line; never empty."""

    line: int
    tokens: tuple[Token, ...]

    @property
    def head(self) -> str:
        return self.tokens[0].word

    @property
    def is_label(self) -> bool:
        """Whether it is a place ``NAME:`` that a GOTO leads to."""
        return len(self.tokens) == 2 and self.tokens[1].text == ":"

    @property
    def is_at_any_time(self) -> bool:
        heads = [token.word for token in self.tokens[:2]]
        return "INTERRUPT" in heads or "TRIGGER" in heads

    @property
    def begins(self) -> str:
        """The name of the program or function that it begins; "" for all others."""
        if self.head not in ("GLOBAL", "DEF", "DEFFCT"):
            return ""
        words = [token.word for token in self.tokens if token.kind == "word"]
        words = words[1:] if words[0] == "GLOBAL" else words
        at = {"DEF": 1, "DEFFCT": 2}.get(words[0] if words else "", len(words))
        return words[at] if at < len(words) else ""


def statements(text: str) -> Iterator[Statement]:
    line, found = 1, list[Token]()
    for match in _TOKEN.finditer(text):
        kind = str(match.lastgroup)
        if kind == "end":
            if found:
                yield Statement(line, tuple(found))
            line, found = line + 1, []
        elif kind != "skip":
            code = match.group()
            found.append(Token(kind, code, match.start(), code.upper()))
    if found:
        yield Statement(line, tuple(found))


def closing(tokens: Sequence[Token], at: int) -> int:
    """Return where the bracket that opens at ``at`` closes; raises `KrlError`."""
    depth = 0
    for n in range(at, len(tokens)):
        depth += (tokens[n].text in "([{") - (tokens[n].text in ")]}")
        if depth == 0:
            return n
    raise KrlError(f"{tokens[at].text!r} is not closed on its line")


def text_of(tokens: Sequence[Token]) -> str:
    return "".join(token.word for token in tokens)


def quoted(tokens: Sequence[Token]) -> str:
    """Source text of tokens, for messages; blanks between them are one."""
    gaps = (" " * (later.start > before.end) for before, later in pairwise(tokens))
    return "".join(gap + token.text for gap, token in zip(("", *gaps), tokens, strict=False))


EXTERNAL = ("E1", "E2", "E3", "E4", "E5", "E6")
POINTS = ("E6POS", "POS", "FRAME")
AXES = ("E6AXIS", "AXIS")
KINDS = (*POINTS, *AXES, "FDAT")
MOST = {"S": 31, "T": 63}  # five bits of status; one bit of turn for each axis


@dataclass(frozen=True)
class Datum:
    """One declared value, or one aggregate in a motion: its position and components."""

    name: str
    kind: str
    file: str
    line: int
    tokens: Sequence[Token] = field(repr=False)
    is_global: bool = False

    @cached_property
    def fields(self) -> dict[str, Sequence[Token]]:
        """Return the tokens of each component; raises `KrlError`."""
        return aggregate(self.tokens)

    @cached_property
    def numbers(self) -> dict[str, Number]:
        """Return the pose's six numbers and the external axes'; raises `KrlError`."""
        fields = self.fields
        external = {name: number(name, fields[name]) for name in EXTERNAL if name in fields}
        return pose(self.name, fields) | external

    @cached_property
    def bits(self) -> dict[str, int]:
        """Return S and T where they are stated; raises `KrlError`."""
        fields = self.fields
        return {name: self._bits(name, fields[name]) for name in MOST if name in fields}

    @staticmethod
    def _bits(name: str, tokens: Sequence[Token]) -> int:
        """Return ``6`` or ``'B110'``."""
        text = text_of(tokens)
        try:
            value = int(text[2:-1], 2) if text.startswith("'B") else int(text)
        except ValueError as error:
            raise KrlError(f"{name} {text} is not a whole number") from error
        if not 0 <= value <= MOST[name]:
            raise KrlError(f"{name} {text} is not 0 to {MOST[name]}")
        return value


def aggregate(tokens: Sequence[Token]) -> dict[str, Sequence[Token]]:
    """Return the tokens of each component of ``{X 1.0,...}`` or ``{POS: X 1.0,...}``."""
    if not tokens or not opens(tokens[0]) or closing(tokens, 0) != len(tokens) - 1:
        raise KrlError(f"{quoted(tokens) or 'nothing'} is no structure of numbers")
    is_plain = tokens[0].kind == "structure"
    fields: dict[str, Sequence[Token]] = {}
    for name, value in _plain(tokens[0]) if is_plain else _components(tokens[1:-1]):
        if name in fields:
            raise KrlError(f"{name} is stated twice")
        fields[name] = value
    return fields


def opens(token: Token) -> bool:
    """Whether a token is or begins a structure."""
    return token.text[0] == "{"


def _plain(structure: Token) -> Iterator[tuple[str, Sequence[Token]]]:
    """Yield the components of a structure of one token."""
    for match in _COMPONENTS.finditer(structure.text):
        kind = "string" if match[2][0] == "'" else "number"
        value = Token(kind, match[2], structure.start + match.start(2), match[2].upper())
        yield match[1].upper(), (value,)


def _components(tokens: Sequence[Token]) -> Iterator[tuple[str, Sequence[Token]]]:
    for part in split(tokens[2:] if len(tokens) > 1 and tokens[1].text == ":" else tokens, ","):
        if len(part) < 2 or part[0].kind != "word":
            raise KrlError(f"{quoted(part) or 'an empty component'} is no component with a value")
        yield part[0].word, part[1:]


def number(name: str, tokens: Sequence[Token]) -> Number:
    """Return the number of one component; raises `KrlError`."""
    text = "".join(token.text for token in tokens)
    signed = len(tokens) == 2 and tokens[0].text in "+-"
    if tokens[-1].kind != "number" or not (signed or len(tokens) == 1):
        raise KrlError(f"{name} {text} is not a number")
    if not math.isfinite(float(text)):
        raise KrlError(f"{name} {text} is not finite")
    return Number(text, tokens[0].start, tokens[-1].end)


def pose(name: str, fields: Mapping[str, Sequence[Token]]) -> dict[str, Number]:
    """Return the six numbers of a pose; raises `KrlError`."""
    if missing := [each for each in POSE if each not in fields]:
        raise KrlError(
            f"{name} leaves out {', '.join(missing)}, which keep their value from before; state "
            "all of X Y Z A B C"
        )
    return {each: number(each, fields[each]) for each in POSE}


def declared(statement: Statement) -> tuple[str, list[tuple[str, Sequence[Token]]]]:
    """Kind, and name and value of each variable that a statement declares.

    The kind is empty for what declares no point, axes or frame data; the value is empty where none
    is given. An array's element is named with its index.
    """
    tokens = statement.tokens
    while tokens and tokens[0].word in ("DECL", "GLOBAL", "CONST"):
        tokens = tokens[1:]
    if len(tokens) < 2 or tokens[0].word not in KINDS or tokens[1].kind != "word":
        return "", []
    found = []
    for part in split(tokens[1:], ","):
        name, _, value = _assigned(part)
        found.append((name, value))
    return tokens[0].word, found


def _assigned(tokens: Sequence[Token]) -> tuple[str, Sequence[Token], Sequence[Token]]:
    """Name, index and value of ``NAME[INDEX]=VALUE``, each but the name may be missing."""
    at, index = 1, tokens[:0]
    if len(tokens) > 1 and tokens[1].text == "[":
        end = closing(tokens, 1)
        at, index = end + 1, tokens[2:end]
    value = tokens[at + 1 :] if len(tokens) > at and tokens[at].text == "=" else tokens[:0]
    return text_of(tokens[:1]), index, value


class DataList:
    """The declarations of a ``.dat``: ``data`` by name, array elements as ``NAME[1]``."""

    def __init__(self, file: str, found: Iterable[Statement]) -> None:
        self.data: dict[str, Datum] = {}
        self.kinds: dict[str, str] = {}
        self.problems: list[str] = []
        self._global = set[str]()  # names that other programs may use
        self._file = file
        for statement in found:
            try:
                self._take(statement)
            except KrlError as error:
                self.problems.append(f"{file} line {statement.line}: {error}")

    def _take(self, statement: Statement) -> None:
        kind, variables = declared(statement)
        is_global = any(token.word == "GLOBAL" for token in statement.tokens[:2])
        for name, value in variables:
            self.kinds[name] = kind
            if is_global:
                self._global.add(name)
            if value:
                self._keep(Datum(name, kind, self._file, statement.line, value, is_global))
        if kind:
            return
        base, index, value = _assigned(statement.tokens)  # ``XP={...}`` or ``XP[1]={...}``
        name = f"{base}[{text_of(index)}]" if index else base
        if base in self.kinds:
            if not value:
                raise KrlError(f"{base} is stated in parts; state all of its numbers at once")
            kind, is_global = self.kinds[base], base in self._global
            self._keep(Datum(name, kind, self._file, statement.line, value, is_global))
        elif base.startswith("$"):
            raise KrlError(f"{base} is set in a data list")

    def _keep(self, datum: Datum) -> None:
        if datum.name in self.data:
            raise KrlError(f"{datum.name} has a value already, line {self.data[datum.name].line}")
        self.data[datum.name] = datum

    def elements(self, base: str) -> list[str]:
        return [name for name in self.data if name.startswith(f"{base}[")]
