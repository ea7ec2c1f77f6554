"""Which base and tool a program's motions work in: one of each, or the program is refused.

Targets are taken in that base; its place is the caller's, {W} for `compensate`. A base is set by
``$BASE=``, ``BAS(#BASE,n)`` or the frame data of inline forms, ``FDAT_ACT=FP1`` for all motions
that follow, ``WITH $BASE=SBASE(FP1.BASE_NO)`` for one. Home moves bring frame data of their own,
which count for nothing as long as only home moves use them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from drivers.kuka.program_krl.data import POSE, DataList, aggregate, number
from drivers.kuka.program_krl.tokens import (
    KrlError,
    Statement,
    Token,
    closing,
    quoted,
    split,
    text_of,
)

SET_ONCE = {"$BASE": "base", "$TOOL": "tool"}
NEVER_SET = (
    "BASE_DATA",
    "TOOL_DATA",
    "$ACT_BASE",
    "$ACT_TOOL",
    "$ROBROOT",
    "$WORLD",
    "$NULLFRAME",
)
WORLDS = ("$NULLFRAME", "$WORLD")
BAS_SETS = {"#BASE": "base", "#TOOL": "tool"}
BAS_RESETS = ("#INITMOV",)
BAS_REFUSED = ("#EX_BASE",)
WITH_FORM = re.compile(
    r"\$BASE=SBASE\((\w+)\.BASE_NO\)|\$TOOL=STOOL2\((\w+)\)|\$IPO_MODE=SIPO_MODE\((\w+)\.IPO_FRAME\)"
)


class StatedTool(NamedTuple):
    """The tool that a program states, and where; ``number`` is None where it has none."""

    line: int
    text: str
    number: int | None


class FrameRule:
    """Follows a program's statements in their order and refuses a second base or tool."""

    def __init__(self, data: DataList) -> None:
        self._data = data
        self._set: dict[str, int] = {}
        self._form: tuple[str, int] | None = None  # frame data in force, and their line
        self._forms_used: tuple[str, int] | None = None
        self.stated: tuple[int, list[float]] | None = None  # base by its numbers, and its line
        self.tool: StatedTool | None = None
        self._moved = 0

    def take(self, statement: Statement) -> None:
        """Take a statement that is not a motion; raises `KrlError`."""
        tokens = statement.tokens
        for at, token in enumerate(tokens):
            if token.word == "BAS" and at + 1 < len(tokens) and tokens[at + 1].text == "(":
                self._bas(tokens[at + 2 : closing(tokens, at + 1)], statement.line)
            elif assigned_at(tokens, at):
                self._assign(token.word, tokens[at + 1 :], statement.line)

    def move(self, line: int, clause: Sequence[Token] = ()) -> None:
        """Take a motion to a Cartesian target and its ``WITH`` clause; raises `KrlError`."""
        form = _form_of(clause, line) or self._form
        self._moved = self._moved or line
        if form is None:
            return
        name, set_on = form
        numbers = self._numbers(name)
        tool_no = self._data.data[name].fields()["TOOL_NO"]
        self.tool = self.tool or StatedTool(
            line, f"{name}, TOOL_NO {quoted(tool_no)}", _whole(tool_no)
        )
        if self._set:
            what, line_set = next(iter(self._set.items()))
            raise KrlError(
                f"works with the base and tool of {name}, line {set_on}, while line {line_set} "
                f"sets the {what} too; one base is wanted"
            )
        if self._forms_used is None:
            self._forms_used = (numbers, line)
        elif self._forms_used[0] != numbers:
            raise KrlError(
                f"{name} changes base or tool: {numbers} here, {self._forms_used[0]} for the "
                f"motion of line {self._forms_used[1]}; correct such programs apart"
            )

    def _numbers(self, name: str) -> str:
        datum = self._data.data.get(name)
        if datum is None or datum.kind != "FDAT":
            raise KrlError(f"works in {name}, whose base and tool are not in the .dat file")
        fields = datum.fields()
        if "TOOL_NO" not in fields or "BASE_NO" not in fields:
            raise KrlError(f"{name} states no TOOL_NO or no BASE_NO")
        if text_of(fields.get("IPO_FRAME", ())) not in ("", "#BASE"):
            raise KrlError(f"{name}: the workpiece is carried by the robot, IPO_FRAME not #BASE")
        return f"TOOL_NO {text_of(fields['TOOL_NO'])}, BASE_NO {text_of(fields['BASE_NO'])}"

    def _bas(self, arguments: Sequence[Token], line: int) -> None:
        parts = split(arguments, ",")
        first = text_of(parts[0])
        if first in BAS_SETS:
            self._set_once(BAS_SETS[first], line)
            if first == "#TOOL":
                number = parts[1] if len(parts) > 1 else ()
                self.tool = StatedTool(line, f"TOOL_DATA[{text_of(number)}]", _whole(number))
        elif first in BAS_REFUSED or not first.startswith("#"):
            raise KrlError(f"BAS({first},...) may set another base")
        elif first in BAS_RESETS and (self._set or self._form or self._moved):
            raise KrlError(f"BAS({first},...) resets base and tool after they were set or used")

    def _assign(self, name: str, rest: Sequence[Token], line: int) -> None:
        if name in NEVER_SET:
            raise KrlError(f"{name} is changed at run time")
        if name == "FDAT_ACT":
            self._form = (_plain_name(name, rest), line)
        elif name == "$IPO_MODE" and text_of(rest) != "=#BASE":
            raise KrlError("$IPO_MODE: the workpiece is carried by the robot")
        elif name in SET_ONCE:
            _check_fixed(name, rest)
            self._set_once(SET_ONCE[name], line)
            if name == "$BASE" and (values := _stated(rest[1:])) is not None:
                self.stated = line, values
            if name == "$TOOL":
                number = rest[3:4] if rest[1].word == "TOOL_DATA" and len(rest) > 3 else ()
                self.tool = StatedTool(line, quoted(rest[1:]), _whole(number))

    def _set_once(self, what: str, line: int) -> None:
        if what in self._set:
            raise KrlError(f"changes the {what} that line {self._set[what]} has set")
        if self._moved:
            raise KrlError(f"changes the {what} after the motion of line {self._moved}")
        self._set[what] = line


def _whole(tokens: Sequence[Token]) -> int | None:
    return int(tokens[0].text) if len(tokens) == 1 and tokens[0].text.isdecimal() else None


def assigned_at(tokens: Sequence[Token], at: int) -> bool:
    """Whether the name at ``at`` is assigned: ``NAME=``, ``NAME.X=``, ``NAME[I].X=``."""
    if tokens[at].kind != "word" or (at and tokens[at - 1].text == "."):
        return False
    at += 1
    while at < len(tokens) and tokens[at].text in (".", "["):
        at = closing(tokens, at) + 1 if tokens[at].text == "[" else at + 2
    return at < len(tokens) and tokens[at].text == "="


def _form_of(clause: Sequence[Token], line: int) -> tuple[str, int] | None:
    """Return the frame data that a ``WITH`` clause names for base and tool alike."""
    parts = [text_of(part) for part in split(clause, ",")]
    framing = [p for p in parts if p.startswith(("$BASE", "$TOOL", "$IPO_MODE", *NEVER_SET))]
    matches = [WITH_FORM.fullmatch(part) for part in framing]
    names = {match[match.lastindex or 0] if match else "" for match in matches}
    if not names:
        return None
    if len(names) > 1 or "" in names or not any(p.startswith("$BASE") for p in framing):
        raise KrlError(f"{', '.join(framing)}: one frame data for base and tool is wanted")
    return names.pop(), line


def _plain_name(name: str, rest: Sequence[Token]) -> str:
    if len(rest) != 2 or rest[0].text != "=" or rest[1].kind != "word":
        raise KrlError(f"{name}{quoted(rest)} sets a base that is not in the .dat file")
    return rest[1].word


def _stated(value: Sequence[Token]) -> list[float] | None:
    """Return x, y, z, a, b, c of a base that is set by numbers, or to the controller's world."""
    if value[0].word in WORLDS:
        return [0.0] * len(POSE)
    if value[0].text != "{":
        return None
    fields = aggregate(value)
    missing = [name for name in POSE if name not in fields]
    if missing:
        raise KrlError(
            f"$BASE leaves out {', '.join(missing)}, which keep their value from before; state all "
            "of X Y Z A B C"
        )
    return [number(name, fields[name]).value for name in POSE]


def _check_fixed(name: str, rest: Sequence[Token]) -> None:
    """Refuse what is no fixed frame: a name, an element with a number, or a structure."""
    value = rest[1:]
    named = len(value) == 1 and value[0].kind == "word"
    numbered = len(value) == 4 and value[1].text == "[" and value[2].kind == "number"
    if rest[0].text == "=" and (named or numbered):
        return
    if rest[0].text == "=" and value and value[0].text == "{":
        aggregate(value)
        return
    raise KrlError(f"{name}{quoted(rest)} is computed at run time")
