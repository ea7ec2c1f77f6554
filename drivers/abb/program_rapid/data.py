"""RAPID as statements of tokens, routines, and the data that they declare.

Comments, the header between ``%%%`` and a byte order mark are left out. Names ignore case; a string
has its quotes doubled; a statement may go over several lines. A row of numbers, ``[1.0,2.0]``, is
one token, whose numbers are replaced byte for byte; a list of rows is one token too.

Sources: Technical reference manual, RAPID Overview (lexical elements, statements, routines) and
RAPID Instructions, Functions and Data types (robtarget, confdata, wobjdata, tooldata), 3HAC050917.
"""

from __future__ import annotations

import math
import re
from bisect import bisect_right
from collections.abc import Iterator, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

from drivers.program_text import CLOSES, MARK, OPENS, Number, Token, split
from hilcell.ports import HilcellError

NUMBER = r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_ROW = r"\[[\d.eE+\-,\s]*\]"
_TOKEN = re.compile(
    rf"""\s*(?:(?P<skip>\A{MARK}|![^\n]*|%%%[^%]*%%%)
      | (?P<row>{_ROW})
      | (?P<rows>\[\s*{_ROW}(?:\s*,\s*{_ROW})*\s*\])
      | (?P<string>"(?:[^"\n]|"")*")
      | (?P<number>{NUMBER})
      | (?P<word>[^\W\d]\w*)
      | (?P<sign>:=|<>|<=|>=|\S))""",
    re.VERBOSE,
)


class RapidError(HilcellError):
    """RAPID that cannot be read; the message states what, its reader adds where."""


@dataclass(frozen=True, slots=True)
class Statement:
    """A statement with its ``;``, the head of a block, or a word that ends one."""

    line: int
    tokens: Sequence[Token]

    @property
    def head(self) -> str:
        return self.tokens[0].word

    @property
    def words(self) -> Set[str]:
        return {token.word for token in self.tokens}


ALONE = ("ENDMODULE", "ENDPROC", "ENDFUNC", "ENDTRAP", "ENDIF", "ENDFOR", "ENDWHILE", "ENDTEST",
         "ENDRECORD", "ELSE", "UNDO", "BACKWARD")  # fmt: skip
LISTED = ("MODULE", "PROC", "FUNC", "TRAP", "RECORD", "ERROR")  # a list in brackets may follow
UNTIL = {
    "IF": ("THEN", ";"), "ELSEIF": ("THEN",), "WHILE": ("DO",), "FOR": ("DO",), "CASE": (":",),
}  # fmt: skip
OPERATORS = ("AND", "OR", "XOR", "NOT", "DIV", "MOD")


def statements(text: str) -> Iterator[Sequence[Token]]:
    found = [
        Token(kind, part, match.end() - len(part), part.upper() if kind == "word" else "")
        for match in _TOKEN.finditer(text)
        if (kind := str(match.lastgroup)) != "skip"
        for part in [match[kind]]
    ]
    at = 0
    while at < len(found):
        end = _end(found, at)
        if found[at].text != ";":
            yield found[at:end]
        at = end


def _end(tokens: Sequence[Token], at: int) -> int:
    """Return where the statement that begins at ``at`` ends."""
    word = tokens[at].word
    following = tokens[at + 1].text if at + 1 < len(tokens) else ""
    if word in ALONE:
        return at + 1
    if word and following == ":":  # a label, or DEFAULT
        return at + 2
    head = at + (word == "LOCAL")
    if head < len(tokens) and tokens[head].word in LISTED:
        named = {"FUNC": 3, "ERROR": 1}.get(tokens[head].word, 2)
        end = min(head + named, len(tokens))
        is_list = end < len(tokens) and tokens[end].text == "("
        return closing(tokens, end) + 1 if is_list else end
    if word == "TEST":
        ends = (n for n in range(at, len(tokens)) if tokens[n].word in ("CASE", "DEFAULT"))
        return next(ends, len(tokens))
    until = UNTIL.get(word, (";",))
    end = next(
        (n for n in range(at, len(tokens)) if (tokens[n].word or tokens[n].text) in until),
        len(tokens) - 1,
    )
    return _condition_end(tokens, at) if word == "IF" and tokens[end].text == ";" else end + 1


def _condition_end(tokens: Sequence[Token], at: int) -> int:
    """Return where the condition of ``IF condition statement;`` ends."""
    depth = 0
    for n in range(at + 1, len(tokens) - 1):
        depth += (tokens[n].text in OPENS) - (tokens[n].text in CLOSES)
        one, other = tokens[n], tokens[n + 1]
        is_value = (one.kind != "sign" or one.text in CLOSES) and one.word not in OPERATORS
        if not depth and is_value and other.word and other.word not in OPERATORS:
            return n + 1
    return len(tokens)


def closing(tokens: Sequence[Token], at: int) -> int:
    """Return where the bracket that opens at ``at`` closes; the last token where it does not."""
    depth = 0
    for n in range(at, len(tokens)):
        depth += (tokens[n].text in OPENS) - (tokens[n].text in CLOSES)
        if depth == 0:
            return n
    return len(tokens) - 1


def quoted(tokens: Sequence[Token]) -> str:
    """Source text of tokens, for messages; blanks between them are one."""
    gaps = (" " * (later.start > before.end) for before, later in pairwise(tokens))
    text = "".join(gap + token.text for gap, token in zip(("", *gaps), tokens, strict=False))
    return text if len(text) <= 60 else f"{text[:57]}..."


_COMMA = Token("sign", ",", 0, "")


class Arguments(NamedTuple):
    """Arguments of a call: those by place, and those by name, ``\\NAME`` or ``\\NAME:=value``."""

    placed: list[Sequence[Token]]
    named: dict[str, Sequence[Token]]

    @classmethod
    def of(cls, tokens: Sequence[Token]) -> Arguments:
        placed, named = list[Sequence[Token]](), dict[str, Sequence[Token]]()
        depth, begin, is_named = 0, 0, False
        for n, token in enumerate([*tokens, _COMMA]):
            text = token.text
            if text in OPENS:
                depth += 1
            elif text in CLOSES:
                depth -= 1
            elif text in ("\\", ",") and not depth:
                part = tokens[begin:n]
                if is_named and part:
                    named[part[0].word] = _bare(part[2:])
                elif part:
                    placed.append(_bare(part))
                begin, is_named = n + 1, text == "\\"
        return cls(placed, named)


def _bare(tokens: Sequence[Token]) -> Sequence[Token]:
    """Return an expression without brackets around it."""
    while (
        tokens
        and tokens[0].text == "("
        and len(tokens) > 2
        and closing(tokens, 0) == len(tokens) - 1
    ):
        tokens = tokens[1:-1]
    return tokens


def structure(tokens: Sequence[Token]) -> object:
    """Return a literal: a row as its token, a list of values, or a tuple of tokens for all else."""
    if len(tokens) == 1 and tokens[0].kind == "row":
        return tokens[0]
    if len(tokens) == 1 and tokens[0].kind == "rows":
        begin, text = tokens[0].start, tokens[0].text
        found = re.compile(_ROW).finditer(text, 1)
        return [Token("row", each.group(), begin + each.start(), "") for each in found]
    if not tokens or tokens[0].text != "[" or closing(tokens, 0) != len(tokens) - 1:
        return tuple(tokens)
    return [structure(part) for part in split(tokens[1:-1], ",")]


def floats(value: object, count: int, what: str) -> list[float]:
    """Return the values of a row; raises `RapidError`."""
    found = list[float]()
    with suppress(ValueError):
        if isinstance(value, Token):
            found = [float(each) for each in value.text[1:-1].split(",")]
    if len(found) != count or not all(map(math.isfinite, found)):
        raise RapidError(f"{what} is not {count} numbers")
    return found


def row(value: Token, count: int, what: str) -> list[Number]:
    """Return the numbers of a row; raises `RapidError`."""
    floats(value, count, what)
    at = value.start
    parts = re.finditer(r"[^\[\],\s]+", value.text)
    return [Number(each.group(), at + each.start(), at + each.end()) for each in parts]


@dataclass(frozen=True, slots=True)
class Datum:
    """One declaration: ``storage`` is CONST, VAR or PERS; ``value`` its tokens, maybe none.
    ``text``: its name as the source has it.
    """

    name: str
    text: str
    kind: str
    storage: str
    line: int
    is_local: bool
    value: Sequence[Token] = field(repr=False)


def declared(statement: Statement) -> Datum | None:
    """Return what a statement declares, or None."""
    tokens = statement.tokens
    scope = tokens[0].word if tokens[0].word in ("LOCAL", "TASK") else ""
    rest = tokens[1:] if scope else tokens
    if len(rest) < 4 or rest[0].word not in ("CONST", "VAR", "PERS"):
        return None
    at = closing(rest, 3) + 1 if rest[3].text == "{" else 3
    value = rest[at + 1 : -1] if rest[at : at + 1] and rest[at].text == ":=" else ()
    return Datum(
        rest[2].word,
        rest[2].text,
        rest[1].word,
        rest[0].word,
        statement.line,
        scope == "LOCAL",
        value,
    )


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter. ``is_named``: passed as ``\\NAME``; ``may_change``: it is INOUT, VAR or PERS."""

    name: str
    kind: str
    is_named: bool
    may_change: bool


@dataclass(slots=True)
class Routine:
    """A routine: its statements, those of its error handler among them, behind ``handler``."""

    name: str
    kind: str
    line: int
    is_local: bool
    parameters: Sequence[Parameter]
    statements: list[Statement] = field(default_factory=list, repr=False)
    handler: int | None = None  # the number of its first statement in a handler
    data: dict[str, Datum] = field(default_factory=dict, repr=False)
    locals: set[str] = field(default_factory=set, repr=False)  # all names of its own

    def takes(self, name: str) -> Parameter | None:
        return next((each for each in self.parameters if each.name == name), None)

    def matched(self, arguments: Arguments) -> Iterator[tuple[Parameter, Sequence[Token]]]:
        """Yield its parameters with what a call passes for them."""
        placed = (each for each in self.parameters if not each.is_named)
        yield from zip(placed, arguments.placed, strict=False)
        named = arguments.named
        yield from ((each, named[each.name]) for each in self.parameters if each.name in named)

    def is_handled(self, number: int) -> bool:
        """Whether a statement, by its number, runs in an error handler, or a trap."""
        return self.kind == "TRAP" or (self.handler is not None and number >= self.handler)


class Module:
    """The routines and data of a module's text, and where its head ends; raises `RapidError`."""

    def __init__(self, text: str) -> None:
        self.routines: dict[str, Routine] = {}
        self.data: dict[str, Datum] = {}
        self.head_end = 0
        self._is_ended = False
        self._open: Routine | None = None
        self._line_ends = [match.start() for match in re.finditer("\n", text)]
        for tokens in statements(text):
            statement = Statement(self.line(tokens[0].start), tokens)
            try:
                self._take(statement)
            except RapidError as error:
                raise RapidError(f"line {statement.line}: {error}") from error
        if not self.head_end:
            raise RapidError("no MODULE: expected the text of a RAPID module")
        if self._open is not None:
            raise RapidError(f"line {self._open.line}: {self._open.name} has no end")
        if not self._is_ended:
            last = len(text.rstrip().split("\n"))
            raise RapidError(f"line {last}: the module ends without ENDMODULE: is it truncated?")

    def _take(self, statement: Statement) -> None:
        at = int(statement.head == "LOCAL")
        word = statement.tokens[at].word if at < len(statement.tokens) else ""
        if not self.head_end:
            if word != "MODULE":
                raise RapidError("expected MODULE: the text of a RAPID module")
            self.head_end = statement.tokens[-1].end
        elif word in ("PROC", "FUNC", "TRAP"):
            self._begin(statement, word, at)
        elif word in ("ENDPROC", "ENDFUNC", "ENDTRAP"):
            self._open = None
        elif word == "ENDMODULE" and self._open is None:
            self._is_ended = True
        elif self._open is None:
            if datum := declared(statement):
                self._keep(self.data, datum)
        else:
            self._add(self._open, statement)

    def _begin(self, statement: Statement, kind: str, at: int) -> None:
        if self._open is not None:
            raise RapidError(f"{kind} within {self._open.name}, which has no end")
        opens = next((n for n, t in enumerate(statement.tokens) if t.text == "("), 0)
        name = statement.tokens[(opens or len(statement.tokens)) - 1].word
        parameters = list(_parameters(statement.tokens[opens + 1 : -1])) if opens else []
        if name in self.routines:
            raise RapidError(f"{name} is a routine of line {self.routines[name].line} already")
        self._open = Routine(name, kind, statement.line, bool(at), parameters)
        self._open.locals.update(each.name for each in parameters)
        self.routines[name] = self._open

    def _add(self, routine: Routine, statement: Statement) -> None:
        if statement.head in ("ERROR", "UNDO", "BACKWARD") and routine.handler is None:
            routine.handler = len(routine.statements)
        if statement.head == "FOR":
            routine.locals.add(statement.tokens[1].word)
        if datum := declared(statement):
            self._keep(routine.data, datum)
            routine.locals.add(datum.name)
        else:
            routine.statements.append(statement)

    @staticmethod
    def _keep(data: dict[str, Datum], datum: Datum) -> None:
        if datum.name in data:
            raise RapidError(f"{datum.name} is declared in line {data[datum.name].line} already")
        data[datum.name] = datum

    def line(self, at: int) -> int:
        """Return the line of a character, counted from 1."""
        return 1 + bisect_right(self._line_ends, at)

    def datum(self, name: str, routine: Routine) -> Datum | None:
        """Return the data that a name means in a routine; None for a parameter, or unknown."""
        return routine.data.get(name) if name in routine.locals else self.data.get(name)


def _parameters(tokens: Sequence[Token]) -> Iterator[Parameter]:
    for part in split(tokens, ","):
        for n, piece in enumerate(split(part, "\\")):
            for each in split(piece, "|"):
                words = [token.word for token in each if token.word]
                may_change = words[:1] in (["INOUT"], ["VAR"], ["PERS"], ["REF"])
                words = words[may_change:]
                if len(words) == 2:
                    yield Parameter(words[1], words[0], n > 0, may_change)
