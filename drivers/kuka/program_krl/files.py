"""Reads a KRL program whose targets can be corrected safely; all else is refused, line by line.

A program is ``NAME.src`` with its ``NAME.dat``. Only absolute motions to points that are numbers in
it are corrected. A point that is also read, changed or passed on would carry its correction to
unchecked places: such a program is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from drivers.kuka.krl import JOINTS, POSE
from drivers.kuka.program_krl.data import (
    AXES,
    EXTERNAL,
    POINTS,
    DataList,
    Datum,
    KrlError,
    Statement,
    closing,
    declared,
    number,
    opens,
    quoted,
    statements,
    text_of,
)
from drivers.kuka.program_krl.flow import (
    ENDS,
    MOTIONS,
    STROKES,
    ExternalRule,
    Relative,
    Stop,
    StrokeRule,
    kept_postures,
)
from drivers.kuka.program_krl.frames import FrameRule, assigned_at, check_modal
from drivers.kuka.program_krl.program import DATA, Program, Target
from drivers.program_text import Token, source_text
from hilcell.cell.settings import SettingsError, unreadable
from hilcell.compensation.programs import StatedBase, StatedTool, Stroke
from hilcell.geometry.frames import pose_from_zyx

ABSOLUTE = ("PTP", "LIN", "SPTP", "SLIN")


def load_program(path: Path) -> Program:
    """Read a program with the data list beside it; raises `SettingsError`."""
    try:
        found = [
            each
            for each in path.parent.iterdir()
            if each.stem.lower() == path.stem.lower()
            and each.suffix.lower() == DATA
            and each.is_file()
        ]
    except OSError as error:
        raise unreadable(str(path), error) from error
    if len(found) > 1:
        names = ", ".join(sorted(each.name for each in found))
        raise SettingsError(str(path), [f"several data lists beside it: {names}; leave one"])
    data = found[0] if found else None
    return read_program(
        path.name, source_text(path, "KRL"), (data.name, source_text(data, "KRL")) if data else None
    )


def read_program(source: str, text: str, data: tuple[str, str] | None) -> Program:
    """Program of a ``.src`` (name, text) and its ``.dat`` (name, text), if it has one. Raises
    `SettingsError` with everything that cannot be corrected safely, by file and line.
    """
    name, content = data or (source, "")
    found = DataList(name, statements(content)) if data else None
    reader = _Reader(source, list(statements(text)), found)
    reader.read()
    if reader.problems:
        raise SettingsError(source, reader.problems)
    return reader.program({source: text} | ({name: content} if data else {}))


class _Surely:
    """Follows a program's statements: which may not be executed before its motions."""

    CONDITIONAL = ("IF", "SWITCH", "WHILE", "FOR")

    def __init__(self, moving: Set[str]) -> None:
        """Take the own subprograms that move."""
        self.first = self.program = ""
        self._moving = moving
        self._open: list[tuple[str, int]] = []
        self._jump = self._exit = self._call = 0  # lines

    def begin(self, program: str) -> None:
        """Begin a program or subprogram; "" is a header that begins none."""
        if program:
            self.first, self.program = self.first or program, program
            self._open, self._jump, self._exit = [], 0, 0

    def take(self, statement: Statement) -> None:
        if statement.head in self.CONDITIONAL:
            self._open.append((statement.head, statement.line))
        elif ENDS.get(statement.head) in self.CONDITIONAL and self._open:
            self._open.pop()
        elif statement.head == "GOTO":
            self._jump = self._jump or statement.line
        elif statement.head == "EXIT":
            self._exit = self._exit or statement.line
        if statement.head in ("ENDLOOP", "ENDFOR", "ENDWHILE", "UNTIL"):
            self._exit = 0
        if any(token.word in self._moving for token in statement.tokens):
            self._call = self._call or statement.line

    @property
    def doubt(self) -> str:
        """Why the statement may not be executed before the motions; "" where it is."""
        if self.program != self.first:
            return f"in {self.program}, not in {self.first}"
        if self._open:
            word, line = self._open[-1]
            return f"within the {word} of line {line}"
        if self._call:
            return f"after line {self._call}, by which a subprogram may have moved"
        if self._exit:
            return f"after the EXIT of line {self._exit}"
        return f"after the GOTO of line {self._jump}" if self._jump else ""


class _Reader:
    """Goes through the statements once for motions, and once more for other uses of points."""

    JOINTWISE = ("PTP", "SPTP")
    HOMES = ("HOME", "XHOME", *(f"XHOME{n}" for n in range(1, 6)))
    CONTROL = (
        "IF", "WHILE", "UNTIL", "FOR", "WAIT", "SWITCH", "CASE", "RETURN", "WHEN", "TO", "STEP",
        "AND", "OR", "NOT", "EXOR", "B_AND", "B_OR", "B_NOT", "B_EXOR", "BAS", "DIV", "MOD", "SEC",
        "PRIO", "DELAY", "DISTANCE", "PATH",
    )  # fmt: skip
    MOVES_NOTHING = (
        "PULSE", "ANIN", "ANOUT", "SIGNAL", "COPEN", "CCLOSE", "CREAD", "CWRITE", "CIOCTL", "SREAD",
        "SWRITE", "MSGNOTIFY", "MSGSTATE", "MSGQUIT", "MSGDIALOG",
        "IR_STOPM",  # the controller's own, which each program declares for its stop messages
        "ABS", "SQRT", "SIN", "COS", "TAN", "ACOS", "ASIN", "ATAN", "ATAN2", "ROUND", "FRAND",
        "FORWARD", "INVERSE", "INV_POS", "CAST_TO", "CAST_FROM", "VARSTATE", "VARTYPE",
        "GETVARSIZE", "STRADD", "STRCLEAR", "STRCOPY", "STRCOMP", "STRFIND", "STRLEN", "STRDECLLEN",
        "STRTOBOOL", "STRTOINT", "STRTOREAL", "STRTOSTRING", "STRTOFRAME", "STRTOPOS", "STRTOE6POS",
        "STRTOAXIS", "STRTOE6AXIS", "GET_SIG_INF", "GET_DECL_PLACE", "GETCYCDEF", "GETSYSSTATE",
        "GET_SYSTEM_DATA", "IS_KEY_PRESSED", "ISMESSAGESET", "TIMER_LIMIT", "MBX_REC", "SYNC",
        "SYNCCMD", "WSPACEGIVE", "WSPACETAKE", "SET_KRLMSG", "EXISTS_KRLMSG", "CLEAR_KRLMSG",
        "SET_KRLDLG", "EXISTS_KRLDLG", "SET_KRLDLGANSWER", "GET_MSGBUFFER", "ERR_CLEAR",
        "ERR_RAISE", "DELETE_BACKWARD_BUFFER",
    )  # fmt: skip
    JOINT_TARGET = "{}: joint targets are not corrected; state the target as X, Y, Z, A, B, C"

    def __init__(self, file: str, found: list[Statement], data: DataList | None) -> None:
        self.targets: dict[str, Target] = {}
        self._lacks_data = data is None
        self._data = data or DataList(file, ())
        self.problems = list(self._data.problems)
        self._file, self._found = file, found
        self._frames = FrameRule(self._data)
        self._own = {each.begins for each in found if each.begins}
        self._blocks = _blocks(found)
        moves = {*MOTIONS, *STROKES, *self._blocks}
        moving = {  # subprograms that move, or may: those that have a motion or call another
            name
            for name, block in self._blocks.items()
            if any(token.word in moves for statement in block for token in statement.tokens)
        }
        self._stroke_rule, self._surely = StrokeRule(self._blocks, moving), _Surely(moving)
        self._relative: list[Relative] = []
        self._missing: list[str] = []  # names that the data list beside it would have
        self._local = {name for each in found for name in _local(each)}
        self._assigned = {name for each in found for name in _assigned(each)}
        self._places: set[int] = set()  # of the names of targets in motions
        self._moves_in: dict[str, int] = {}  # subprograms that move to a target, by the first line
        self._left: dict[str, int] = {}  # homes and other files' programs, by their first line
        self._stops: dict[int, list[Stop]] = {}  # by the line of their motion

    def read(self) -> None:
        self._each(self._take)
        if self._missing:
            self.problems = [self._no_data()]  # the others follow from it
            return
        used = {target.name.partition("[")[0] for target in self.targets.values()}
        self._each(partial(self._check_uses, used))
        try:
            self.problems += self._external.problems()
        except KrlError as error:
            self.problems.append(f"{self._file}: {error}")
        self._check_called()
        if not self.problems:
            self.problems += check_modal(self._file, self._blocks, self._frames)
        if not self.targets and not self.problems:
            self.problems.append("no motion to a point with X, Y, Z: nothing to correct")

    def _each(self, act: Callable[[Statement], None]) -> None:
        for statement in self._found:
            try:
                act(statement)
            except KrlError as error:
                self.problems.append(f"{self._file} line {statement.line}: {error}")

    def _no_data(self) -> str:
        stem = self._file.rpartition(".")[0] or self._file
        names = list(dict.fromkeys(self._missing))
        more = ", ..." if len(names) > 5 else ""
        return (
            f"{stem}.dat is missing beside it, expected with the points {', '.join(names[:5])}"
            f"{more}; copy both files of the program into one folder"
        )

    def program(self, texts: dict[str, str]) -> Program:
        """Return what was read from ``texts``, by file name."""
        base, tool, external = self._frames.base, self._frames.tool, self._external
        stated_base = stated_tool = None
        if base is not None and base.values is not None:
            stated_base = StatedBase(f"{self._file} line {base.line}", base.values)
        if tool is not None:
            frame = None if tool.values is None else pose_from_zyx(*tool.values)
            where = f"{self._file} line {tool.line}"
            stated_tool = StatedTool(where, tool.text, tool.number, frame)
        return Program(
            texts,
            list(self.targets.values()),
            self._notes() + external.notes(),
            self._strokes(),
            stated_base,
            stated_tool,
            external.slide(),
            kept_postures(self._file, self._blocks, self._stops, self.targets),
        )

    def _strokes(self) -> list[Stroke]:
        keys = list(self.targets)
        found = []
        for each in self._relative:
            target = self.targets[each.key]
            R = pose_from_zyx(*(target.numbers[name].value for name in POSE))[:3, :3]
            where = f"{each.word} ({self._file} line {each.line}) from {target.where}"
            begin, end = (np.array([each.from_mm, each.shift_mm]) @ R.T).tolist()
            found.append(Stroke(where, keys.index(each.key), tuple(end), tuple(begin)))
        return found

    @cached_property
    def _external(self) -> ExternalRule:
        return ExternalRule(self._file, self._blocks, self._stops, self.targets)

    def _notes(self) -> list[str]:
        """Return the parts that were left as they are, and those that reach further."""
        used = {target.name for target in self.targets.values()}
        shared = [
            name for name in used if name in self._data.data and self._data.data[name].is_global
        ]
        unused = [d.name for d in self._data.data.values() if d.kind in POINTS]
        unused = [
            name
            for name in unused
            if name not in used and name.partition("[")[0] not in self._frames.frames_used
        ]
        remarks = [f"{what} (line {line})" for what, line in self._left.items()]
        if (tool := self._frames.tool) is not None:
            remarks.append(
                f"its tool is {tool.text} (line {tool.line}): it must be that of the targets"
            )
        aside = dict.fromkeys(
            str(each.line) for each in self._relative if each.shift_mm[:2] != each.from_mm[:2]
        )
        if aside:
            remarks.append(
                f"strokes that are not along z of the tool, the drill's axis in {{T}}: line "
                f"{', '.join(aside)}; they are corrected as they stand"
            )
        remarks += [
            f"{name} is GLOBAL: other programs that use it get its correction, too"
            for name in sorted(shared)
        ]
        return remarks + ([f"not used by a motion, left: {', '.join(unused)}"] if unused else [])

    # -- the first pass -----------------------------------------------------------------------

    def _take(self, statement: Statement) -> None:
        tokens = statement.tokens
        if self._is_header(statement):
            self._surely.begin(statement.begins)
            return
        self._surely.take(statement)
        if any(token.text in ('"', "'") for token in tokens):
            raise KrlError("a string does not end on its line")
        if statement.head in STROKES:
            self._frames.stroke(statement.line)
            self._relative += self._stroke_rule.take(statement)
            return
        self._refuse_motions(statement)
        self._relative += self._stroke_rule.pass_by(statement)
        colons = any(token.text == ":" for token in self._outside_braces(tokens))
        if colons and not statement.is_label:
            raise KrlError("the geometric operator ':' computes a frame at run time")
        if statement.head in ABSOLUTE:
            self._motion(statement)
        else:
            self._frames.take(statement, self._surely.doubt)
            self._check_calls(statement)

    def _motion(self, statement: Statement) -> None:
        self._stroke_rule.start_at(())
        self._moves_in.setdefault(self._surely.program, statement.line)
        target, rest = _target(statement.tokens)
        clause = self._clause(rest)
        name = text_of(target)
        if opens(target[0]):
            inline = Datum(f"{statement.head} target", "", self._file, statement.line, target)
            if set(inline.fields) & set(JOINTS):
                self._joint_target(statement, inline)
                return
            self._frames.move(statement.line, clause)
            self._add({f"{statement.line}": inline}, statement)
            self._stroke_rule.start_at([f"{statement.line}"])
            return
        self._places.add(target[0].start)
        if statement.head in self.JOINTWISE and self._stays(name, statement.line):
            return
        self._frames.move(statement.line, clause)
        meant = {each.name: each for each in self._meant(target)}
        self._add(meant, statement)
        self._stroke_rule.start_at(list(meant))

    def _joint_target(self, statement: Statement, inline: Datum) -> None:
        """Leave a first motion to all six joints as it is, a home move; refuse any other."""
        stated = f"{statement.head} {quoted(inline.tokens)}"
        numbers = {name: number(name, each) for name, each in inline.fields.items()}
        if self.targets or statement.head not in self.JOINTWISE or not set(JOINTS) <= set(numbers):
            raise KrlError(self.JOINT_TARGET.format(stated))
        values = {name: each.value for name, each in numbers.items()}
        self._stops[statement.line] = [Stop("", values)]
        self._left.setdefault(f"{stated}: joint targets are left unchanged", statement.line)

    def _stays(self, name: str, line: int) -> bool:
        """Whether this is a home move, or one to where the robot is, which are left unchanged."""
        if name == "$AXIS_ACT":
            return True
        kind = self._data.kinds.get(name, "E6AXIS" if name in self.HOMES else "")
        if kind not in AXES or name in self._local:
            return False
        if name not in self.HOMES:
            raise KrlError(self.JOINT_TARGET.format(name))
        self._stops[line] = [Stop("", self._joints(name))]
        self._left.setdefault(f"home move {name}: joint targets are left unchanged", line)
        return True

    def _joints(self, name: str) -> dict[str, float] | None:
        """Return the numbers of a home of the data list; None where they are not known."""
        if name not in self._data.data or name in self._assigned:
            return None
        fields = self._data.data[name].fields
        return {each: number(each, fields[each]).value for each in (*JOINTS, *EXTERNAL)
                if each in fields}  # fmt: skip

    def _meant(self, target: Sequence[Token]) -> list[Datum]:
        """Return the points that a motion's target names: one, or any element of an array."""
        base, name = target[0].word, text_of(target)
        if base in self._local:
            raise KrlError(f"{base} is a variable of the program: its place is not known")
        names = [name] if name in self._data.data else []
        if len(target) > 1 and target[2].kind != "number":
            names = self._data.elements(base)
        if not names and self._lacks_data:
            self._missing.append(base)
        if not names:
            raise KrlError(f"{name} is not a point with numbers in the program's .dat file")
        found = [self._data.data[each] for each in names]
        if found[0].kind in AXES:
            raise KrlError(self.JOINT_TARGET.format(name))
        if found[0].kind not in POINTS:
            raise KrlError(f"{name} is {found[0].kind}, which is no point")
        return found

    def _add(self, meant: Mapping[str, Datum], motion: Statement) -> None:
        self._stops[motion.line] = stops = list[Stop]()
        for key, datum in meant.items():
            known = self.targets.get(key)
            target = self._target_of(datum, by_joints=motion.head in self.JOINTWISE)
            if known is None or (known.posture is None and motion.head in self.JOINTWISE):
                self.targets[key] = target
            external = {
                name: target.numbers[name].value for name in EXTERNAL if name in target.numbers
            }
            stops.append(Stop(key, external, target.status))

    def _target_of(self, datum: Datum, *, by_joints: bool) -> Target:
        try:
            numbers, bits = datum.numbers, datum.bits if by_joints else {}
        except KrlError as error:
            if datum.file == self._file:
                raise
            raise KrlError(f"{datum.name} of {datum.file} line {datum.line}: {error}") from error
        status = bits.get("S")
        posture = status if "T" in bits else None
        return Target(datum.name, datum.file, datum.line, numbers, posture, status)

    def _check_calls(self, statement: Statement) -> None:
        tokens = statement.tokens
        for at, token in enumerate(tokens[:-1]):
            called = token.kind == "word" and tokens[at + 1].text == "("
            if not called or token.word in self.CONTROL:
                continue
            handed = tokens[at + 2 : closing(tokens, at + 1)]
            points = [t.word for t in handed if self._data.kinds.get(t.word, "FDAT") != "FDAT"]
            if points or any(map(opens, handed)):
                raise KrlError(
                    f"{token.word} is called with the motion parameter "
                    f"{points[0] if points else quoted(handed)}: where it moves is not known"
                )
            known = token.word in self._own or token.word in self.MOVES_NOTHING
            # Functions of EthernetKRL exchange data alone.
            if not known and not token.word.startswith("EKI_"):
                note = (
                    f"{token.word} is another program: its motions are not corrected, and it must "
                    "leave base, tool, slide and posture as they are"
                )
                self._left.setdefault(note, statement.line)

    # -- the second pass ----------------------------------------------------------------------

    def _check_uses(self, used: Set[str], statement: Statement) -> None:
        if self._is_header(statement):
            return
        for at, token in enumerate(statement.tokens):
            if token.word in used and token.start not in self._places:
                if assigned_at(statement.tokens, at):
                    raise KrlError(f"{token.word} is changed at run time")
                raise KrlError(
                    f"{token.word} is used besides moving to it: its correction would go there too"
                )

    def _check_called(self) -> None:
        """Refuse motions that another file calls, where the base and tool of this one count."""
        stated = self._frames.base or self._frames.tool
        for name, line in self._moves_in.items():
            called = any(
                token.word == name
                for block, found in self._blocks.items()
                if block != name
                for statement in found
                for token in statement.tokens
            )
            if stated is not None and name != self._surely.first and not called:
                self.problems.append(
                    f"{self._file} line {line}: {name} moves, and no statement of this file calls "
                    f"it: it may run without the base and tool of line {stated.line}; set them in "
                    f"{name}, in a file of its own"
                )

    @staticmethod
    def _refuse_motions(statement: Statement) -> None:
        """Refuse the motions that cannot be corrected, wherever in the statement they are."""
        for at, token in enumerate(statement.tokens):
            word = token.word
            if word.endswith("_REL") and word.removesuffix("_REL") in (*ABSOLUTE, "CIRC", "SCIRC"):
                raise KrlError(f"{word} is a relative motion: where it goes is not known")
            if word in ("CIRC", "SCIRC"):
                raise KrlError(f"{word}: a circle through an auxiliary point is not corrected")
            if word in ("SPLINE", "PTP_SPLINE", "SPL"):
                raise KrlError(f"{word}: splines are not corrected")
            if word == "ASYPTP":
                raise KrlError(f"{word} moves external axes: the slide would leave its station")
            if word in ABSOLUTE and at:
                raise KrlError(f"{word} within another statement is not understood")

    @staticmethod
    def _is_header(statement: Statement) -> bool:
        """Whether it declares programs and their parameters, where ``:`` states a direction."""
        words = ("DEF", "DEFFCT", "EXT", "EXTFCT", "EXTP", "EXTFCTP", "CHANNEL")
        return statement.head in words or bool(statement.begins)

    @staticmethod
    def _clause(rest: Sequence[Token]) -> Sequence[Token]:
        """Return what follows ``WITH`` after a target; refuse all else but approximations."""
        approximations = ("C_PTP", "C_DIS", "C_VEL", "C_ORI", "C_SPL")
        while rest and (rest[0].word in approximations or rest[0].text == ","):
            rest = rest[1:]
        if rest and rest[0].word != "WITH":
            raise KrlError(f"{quoted(rest)} after the target makes it a computed target")
        return rest[1:]

    @staticmethod
    def _outside_braces(tokens: Sequence[Token]) -> list[Token]:
        outside, depth = list[Token](), 0
        for token in tokens:
            depth += (token.text == "{") - (token.text == "}")
            if depth == 0:
                outside.append(token)
        return outside


def _target(tokens: Sequence[Token]) -> tuple[Sequence[Token], Sequence[Token]]:
    if len(tokens) < 2 or not (tokens[1].kind == "word" or opens(tokens[1])):
        raise KrlError(f"{tokens[0].word} has no target that is understood")
    end = 2
    if opens(tokens[1]):
        end = closing(tokens, 1) + 1
    elif len(tokens) > 2 and tokens[2].text == "[":
        end = closing(tokens, 2) + 1
    return tokens[1:end], tokens[end:]


def _blocks(found: Sequence[Statement]) -> dict[str, list[Statement]]:
    blocks: dict[str, list[Statement]] = {}
    current = ""
    for statement in found:
        current = statement.begins or current
        if not statement.begins:
            blocks.setdefault(current, []).append(statement)
    return blocks


def _local(statement: Statement) -> list[str]:
    """Return the points that a statement declares in the program, and a header's parameters."""
    if statement.begins:
        return [token.word for token in statement.tokens[2:] if token.kind == "word"]
    try:
        _, variables = declared(statement)
        return [name for name, _ in variables]
    except KrlError:
        return []


def _assigned(statement: Statement) -> list[str]:
    tokens = statement.tokens
    try:
        return [token.word for at, token in enumerate(tokens) if assigned_at(tokens, at)]
    except KrlError:
        return []
