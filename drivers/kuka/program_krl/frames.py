"""Base and tool of a program's motions: one of each, or the program is refused.

Targets are in that base; its place is the caller's, {W} for `compensate`. A base is set by
``$BASE=``, ``BAS(#BASE,n)`` or the frame data of inline forms, ``FDAT_ACT=FP1`` for all motions
that follow, ``WITH $BASE=SBASE(FP1.BASE_NO)`` for one. Each is a number of the controller's tables,
or a place that the program states: a structure, ``$NULLFRAME``, number 0, or a frame of the
program's data list, which hides a table of the same name. Frame data used only by home moves are
ignored. Statements that may not be executed are refused: within a branch, after a jump, in a
subprogram. Here the text's order counts; `check_modal` follows the paths through the program.

Base and tool stay as last set, past the ends of branches, loops and subprograms. ``WITH`` is valid
for its own motion only. ``BAS(#CP_PARAMS,...)`` and its like set base and tool by the frame data
that ``FDAT_ACT`` was last set to, whatever was set since.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import NamedTuple

from drivers.kuka.krl import POSE
from drivers.kuka.program_krl.data import (
    POINTS,
    DataList,
    KrlError,
    Statement,
    aggregate,
    closing,
    opens,
    pose,
    quoted,
    text_of,
)
from drivers.kuka.program_krl.flow import STROKES, Flow
from drivers.program_text import Token, split

TABLES = {"base": "BASE_DATA", "tool": "TOOL_DATA"}
NEVER_SET = ("BASE_DATA", "TOOL_DATA", "$ACT_BASE", "$ACT_TOOL", "$ROBROOT", "$WORLD", "$NULLFRAME")


class Stated(NamedTuple):
    """A base or tool that a program sets, and where.

    ``number``: of the controller's own table; ``values``: X, Y, Z in mm and A, B, C in deg where
    known, by the program's own numbers or as the table's number 0.
    """

    line: int
    text: str
    number: int | None
    values: tuple[float, ...] | None = None

    @property
    def frame(self) -> tuple[int | None, tuple[float, ...] | None]:
        """Return the frame without where it is set."""
        return self.number, self.values

    def same(self, other: Stated) -> bool:
        return self.frame == other.frame


class Modal(NamedTuple):
    """Active base and tool, None as before the program, and those of FDAT_ACT."""

    base: Stated | None = None
    tool: Stated | None = None
    form: tuple[Stated, Stated] | None = None

    @property
    def frames(self) -> Hashable:
        """Return its frames without where they are set."""
        found = self.base, self.tool, *(self.form or (None, None))
        return tuple(None if each is None else each.frame for each in found)

    def by_form(self, form: tuple[Stated, Stated], line: int) -> Modal:
        """Return base and tool as FDAT_ACT has them, by the statement that changed them."""
        base, tool = (
            before if before is not None and before.same(each) else each._replace(line=line)
            for before, each in zip((self.base, self.tool), form, strict=True)
        )
        return Modal(base, tool, form)


class FrameRule:
    """Follows a program's statements in their order and refuses a second base or tool."""

    NULL = (0.0,) * len(POSE)  # number 0 of either table, and the controller's own root

    def __init__(self, data: DataList) -> None:
        self._data = data
        self._set: dict[str, Stated] = {}
        self._form: tuple[str, int] | None = None  # frame data in force, and their line
        self._forms_used: tuple[str, int] | None = None
        self._form_frames: tuple[Stated, Stated] | None = None  # of the first motion by form
        self._settings: dict[int, list[Callable[[Modal], Modal]]] = {}  # by their line
        self.motions: dict[int, tuple[str, str]] = {}  # by line: base's and tool's form by WITH
        self._changed: dict[str, int] = {}  # names that are assigned, by their first line
        self.frames_used = set[str]()  # of the data list, used as a base or tool
        self._moved = 0
        self._unsure = ""

    @property
    def base(self) -> Stated | None:
        return self._set.get("base") or (self._form_frames and self._form_frames[0])

    @property
    def tool(self) -> Stated | None:
        return self._set.get("tool") or (self._form_frames and self._form_frames[1])

    @property
    def by_form(self) -> bool:
        """Whether base and tool are those of inline forms, which `BAS(#BASE,...)` may not set."""
        return not self._set

    def take(self, statement: Statement, unsure: str = "") -> None:
        """Take a statement that is not a motion; ``unsure``: why it may never be executed. Raises
        `KrlError`.
        """
        self._unsure, tokens = unsure, statement.tokens
        self._settings[statement.line] = []
        for at, token in enumerate(tokens):
            if token.word == "BAS" and at + 1 < len(tokens) and tokens[at + 1].text == "(":
                self._bas(tokens[at + 2 : closing(tokens, at + 1)], statement.line)
            elif assigned_at(tokens, at):
                if at and token.word == "FDAT_ACT":
                    raise KrlError("FDAT_ACT is set within another statement: set it on its own")
                self._assign(token.word, tokens[at + 1 :], statement.line)

    def move(self, line: int, clause: Sequence[Token] = ()) -> None:
        """Take a motion to a Cartesian target and its ``WITH`` clause; raises `KrlError`."""
        own = self._form_of(clause)
        form = (own, line) if own else self._form
        tool_too = any(token.word == "$TOOL" for token in clause)
        self.motions[line] = (own, own * tool_too)
        self._moved = self._moved or line
        if form is None:
            return
        name, set_on = form
        numbers = self._numbers(name)
        self._form_frames = self._form_frames or self._numbered_by(name, line)
        if self._set:
            what, stated = next(iter(self._set.items()))
            raise KrlError(
                f"works with the base and tool of {name}, line {set_on}, while line {stated.line} "
                f"sets the {what} too; set them in one way"
            )
        if self._forms_used is None:
            self._forms_used = (numbers, line)
        elif self._forms_used[0] != numbers:
            raise KrlError(
                f"{name} changes base or tool: {numbers} here, {self._forms_used[0]} for the "
                f"motion of line {self._forms_used[1]}; correct such programs apart"
            )

    def stroke(self, line: int) -> None:
        """Take a relative motion, which runs in the tool that is in force."""
        self.motions[line] = ("", "")

    def of_form(self, name: str, line: int) -> tuple[Stated, Stated]:
        """Return base and tool of frame data, which may be known to other files alone."""
        try:
            return self._numbered_by(name, line)
        except (KeyError, KrlError):
            text = f"that of {name or 'FDAT_ACT'}, which is not in these files"
            return Stated(line, text, None), Stated(line, text, None)

    def after(self, line: int, state: Modal) -> Modal:
        for change in self._settings.get(line, ()):
            state = change(state)
        return state

    def _numbered_by(self, name: str, line: int) -> tuple[Stated, Stated]:
        """Return base and tool of frame data; raises `KeyError`, `KrlError`."""
        fields = self._data.data[name].fields
        tool, base = (
            self._numbered(what, fields[number], line, f"{name}, {number}", by=f" by {name}")
            for what, number in (("tool", "TOOL_NO"), ("base", "BASE_NO"))
        )
        return base, tool

    def _numbers(self, name: str) -> str:
        datum = self._data.data.get(name)
        if datum is None or datum.kind != "FDAT":
            raise KrlError(f"works in {name}, whose base and tool are not in the .dat file")
        self._refuse_changed(name)
        fields = datum.fields
        if "TOOL_NO" not in fields or "BASE_NO" not in fields:
            raise KrlError(f"{name} states no TOOL_NO or no BASE_NO")
        if text_of(fields.get("IPO_FRAME", ())) not in ("", "#BASE"):
            raise KrlError(f"{name}: the workpiece is carried by the robot, IPO_FRAME not #BASE")
        return f"TOOL_NO {text_of(fields['TOOL_NO'])}, BASE_NO {text_of(fields['BASE_NO'])}"

    def _bas(self, arguments: Sequence[Token], line: int) -> None:
        parts = split(arguments, ",")
        first = text_of(parts[0])
        if first in ("#BASE", "#TOOL"):
            what = first[1:].lower()
            number = parts[1] if len(parts) > 1 else ()
            self._set_once(what, self._numbered(what, number, line, f"BAS({first},...)"))
        elif first in ("#EX_BASE", "#TCP_IPO") or not first.startswith("#"):
            raise KrlError(f"BAS({first},...) may set another base")
        elif first == "#INITMOV" and (self._set or self._form or self._moved):
            raise KrlError(f"BAS({first},...) resets base and tool after they were set or used")
        elif first == "#FRAMES" and self._set:
            stated = next(iter(self._set.values()))
            raise KrlError(
                f"BAS({first},...) sets base and tool by FDAT_ACT after line {stated.line} has set "
                "them"
            )
        elif first == "#INITMOV":
            self._settings[line].append(lambda state: Modal(form=state.form))
        elif first in ("#FRAMES", "#PTP_PARAMS", "#CP_PARAMS"):  # by the frame data of FDAT_ACT
            self._settings[line].append(
                lambda state: (
                    state.by_form(state.form or self.of_form("", line), line)
                    if any(state)
                    else state
                )
            )

    def _assign(self, name: str, rest: Sequence[Token], line: int) -> None:
        if name in NEVER_SET:
            raise KrlError(f"{name} is changed at run time")
        self._changed.setdefault(name, line)
        if name == "FDAT_ACT":
            if len(rest) != 2 or rest[0].text != "=" or rest[1].kind != "word":
                raise KrlError(f"{name}{quoted(rest)} sets a base that is not in the .dat file")
            form, _ = self._form = (rest[1].word, line)
            self._settings[line].append(lambda state: state.by_form(self.of_form(form, line), line))
        elif name == "$IPO_MODE" and text_of(rest) != "=#BASE":
            raise KrlError("$IPO_MODE: the workpiece is carried by the robot")
        elif name in ("$BASE", "$TOOL"):
            what = name[1:].lower()
            self._set_once(what, self._stated(what, name, rest, line))
        elif name in self.frames_used or (
            name in self._data.data and self._data.data[name].kind == "FDAT"
        ):  # motions may work in frame data: forms are read as they stand
            raise KrlError(f"{name} is changed at run time, and motions work in it")

    def _stated(self, what: str, name: str, rest: Sequence[Token], line: int) -> Stated:
        """Return the frame that ``$BASE=...`` or ``$TOOL=...`` sets; raises `KrlError`."""
        value = rest[1:]
        if rest[0].text != "=" or not value:
            raise KrlError(f"{name}{quoted(rest)} is computed at run time")
        text = quoted(value)
        if opens(value[0]):
            numbers = pose(name, aggregate(value)).values()
            return Stated(line, text, None, tuple(each.value for each in numbers))
        if len(value) == 1 and value[0].word in ("$NULLFRAME", "$WORLD"):
            return Stated(line, text, None, self.NULL)
        element = len(value) == 4 and value[1].text == "[" and value[2].kind == "number"
        if not (element or (len(value) == 1 and value[0].kind == "word")):
            raise KrlError(f"{name}{quoted(rest)} is computed at run time")
        if value[0].word in self._data.kinds:
            return Stated(line, text, None, self._of_data(name, text_of(value)))
        if element and value[0].word == TABLES[what]:
            return self._numbered(what, value[2:3], line, name)
        raise KrlError(
            f"{name} is set to {text}, which is not in the program's .dat file: its place is not "
            f"known; set it by X Y Z A B C, or by a number of {TABLES[what]}"
        )

    def _of_data(self, name: str, key: str) -> tuple[float, ...]:
        """Return the numbers of a frame in the data list; raises `KrlError`."""
        base = key.partition("[")[0]
        self._refuse_changed(base)
        self.frames_used.add(base)
        datum = self._data.data.get(key)
        if datum is None or datum.kind not in POINTS:
            raise KrlError(f"{name} is set to {key}, which has no numbers in the .dat file")
        numbers = pose(f"{name} is set to {key}, which", datum.fields).values()
        return tuple(each.value for each in numbers)

    def _refuse_changed(self, name: str) -> None:
        if name in self._changed:
            raise KrlError(f"{name} is changed at run time, in line {self._changed[name]}")

    def _numbered(
        self, what: str, number: Sequence[Token], line: int, how: str, by: str = ""
    ) -> Stated:
        """Return the frame of a number of the controller's tables; raises `KrlError`."""
        if len(number) != 1 or not number[0].text.isdecimal():
            raise KrlError(f"{how} sets the {what} to {quoted(number) or 'nothing'}: no number")
        stated = int(number[0].text)
        text = f"{TABLES[what]}[{stated}]{by}"
        return Stated(line, text, stated, None if stated else self.NULL)

    def _set_once(self, what: str, stated: Stated) -> None:
        self._settings[stated.line].append(
            lambda state: (
                state._replace(base=stated) if what == "base" else state._replace(tool=stated)
            )
        )
        known = self._set.get(what)
        if known is not None:
            if known.same(stated):
                return
            raise KrlError(f"changes the {what} that line {known.line} has set")
        if self._unsure:
            raise KrlError(f"sets the {what} {self._unsure}: set it where the program begins")
        if self._moved:
            raise KrlError(f"changes the {what} after the motion of line {self._moved}")
        self._set[what] = stated
        if set(TABLES) <= set(self._set) and self._forms_used is None:
            self._form = None  # that of a home move, which no longer counts

    @staticmethod
    def _form_of(clause: Sequence[Token]) -> str:
        """Return the frame data that ``WITH`` names for base and tool alike, "" for none."""
        parts = [text_of(part) for part in split(clause, ",")]
        framing = [p for p in parts if p.startswith(("$BASE", "$TOOL", "$IPO_MODE", *NEVER_SET))]
        form = (
            r"\$BASE=SBASE\((\w+)\.BASE_NO\)|\$TOOL=STOOL2\((\w+)\)"
            r"|\$IPO_MODE=SIPO_MODE\((\w+)\.IPO_FRAME\)"
        )
        matches = [re.fullmatch(form, part) for part in framing]
        names = {match[match.lastindex or 0] if match else "" for match in matches}
        if not names:
            return ""
        if len(names) > 1 or "" in names or not any(p.startswith("$BASE") for p in framing):
            raise KrlError(
                f"WITH {', '.join(framing)}: a motion's own base or tool; expected both from one "
                "frame data, as inline forms write them: set $BASE and $TOOL before the motions"
            )
        return names.pop()


def assigned_at(tokens: Sequence[Token], at: int) -> bool:
    """Whether the name at ``at`` is assigned: ``NAME=``, ``NAME.X=``, ``NAME[I].X=``."""
    if tokens[at].kind != "word" or (at and tokens[at - 1].text == "."):
        return False
    at += 1
    while at < len(tokens) and tokens[at].text in (".", "["):
        at = closing(tokens, at) + 1 if tokens[at].text == "[" else at + 2
    return at < len(tokens) and tokens[at].text == "="


def check_modal(
    file: str, blocks: Mapping[str, Sequence[Statement]], frames: FrameRule
) -> list[str]:
    """Return the motions that may run in another base or tool than those of the program."""
    found: dict[int, str] = {}
    ask = "set FDAT_ACT and BAS(#FRAMES)" if frames.by_form else "set base and tool again"

    def judge(statement: Statement, what: str, used: Stated | None, stated: Stated | None) -> None:
        if used is stated or (used is not None and stated is not None and used.same(stated)):
            return
        expected = f"{stated.text} (line {stated.line})" if stated else "none set by the program"
        runs = (
            f"{used.text} (line {used.line})"
            if used
            else "that of before the program (WITH holds for its own motion alone)"
        )
        found.setdefault(
            statement.line,
            f"{file} line {statement.line}: {statement.head} may run in another {what}: expected "
            f"{expected}, got {runs}; {ask} before this motion",
        )

    def step(statement: Statement, before: Modal) -> list[Modal]:
        line, after = statement.line, frames.after(statement.line, before)
        if line in frames.motions:
            base, tool = frames.motions[line]
            judge(statement, "tool", frames.of_form(tool, line)[1] if tool else after.tool,
                  frames.tool)  # fmt: skip
            if statement.head not in STROKES:
                judge(statement, "base", frames.of_form(base, line)[0] if base else after.base,
                      frames.base)  # fmt: skip
        return [after]

    Flow(blocks, step, lambda state: state.frames).follow(Modal())
    return [found[line] for line in sorted(found)]
