"""Reads a RAPID module whose targets can be corrected safely; all else is refused, line by line.

Each motion names its tool and work object, so no state goes from one motion to the next but the
control of configurations. Corrected are motions to robtargets that are numbers of this module, by
name, as an element of an array, within the motion, or as a parameter of an own routine; ``Offs``
and ``RelTool`` of one keep its correction. A target that is also read, changed or passed on would
carry its correction to unchecked places: such a program is refused.

Left as they are, with a note: poses whose name says home, safe or park, by joints or not, and joint
targets of a routine before its first and behind its last motion to a robtarget, or in a routine
that this module does not call. Any other joint target may be a hole, and is refused.

Source: Technical reference manual, RAPID Instructions, Functions and Data types, 3HAC050917: the
motions named here, Offs, RelTool, PDispSet, EOffsSet, WaitWObj, ActUnit, SoftAct, ConfJ, ConfL.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from decimal import Decimal
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.abb.program_rapid.data import (
    OPERATORS,
    Arguments,
    Datum,
    Module,
    RapidError,
    Routine,
    Statement,
    closing,
    floats,
    quoted,
    row,
    structure,
)
from drivers.abb.program_rapid.program import Program, Target, from_quaternions
from drivers.program_text import CLOSES, OPENS, Token, source_text, split
from hilcell.cell.settings import SettingsError
from hilcell.compensation.programs import StatedBase, StatedTool, Stroke
from hilcell.errors import bounded
from hilcell.geometry.frames import matrix, zyx_from_pose
from hilcell.ports import Array
from hilcell.sanitize import counted

MOTIONS = {  # by name: the place of the tool among the arguments
    **dict.fromkeys(("MOVEJ", "MOVEL", "MOVEJDO", "MOVELDO", "MOVEJAO", "MOVELAO", "MOVEJGO",
                     "MOVELGO", "MOVEJSYNC", "MOVELSYNC", "TRIGGJIOS", "TRIGGLIOS"), 3),
    **dict.fromkeys(("TRIGGJ", "TRIGGL"), 4),
}  # fmt: skip
OPTIONS = {"CONC", "V", "T", "Z", "INPOS", "WOBJ", "TLOAD", *(f"T{n}" for n in range(2, 9)),
           *(f"TRIGGDATA{n}" for n in range(1, 4))}  # fmt: skip
_CIRCLE = "a circle through an auxiliary point is not corrected"
_SHIFTED = "it displaces all targets behind it, and where is not known"
_UNIT = "a work object or axis of another unit moves the targets"
_SEVERAL = "several robots move together"
_PATH = "the sensor's path is not that of the targets"
REFUSED = {
    **dict.fromkeys(("MOVEC", "MOVECDO", "MOVECAO", "MOVECGO", "MOVECSYNC", "TRIGGC"), _CIRCLE),
    **dict.fromkeys(("SEARCHL", "SEARCHC"), "it ends where a signal comes, not at its target"),
    **dict.fromkeys(("PDISPON", "PDISPSET", "EOFFSON", "EOFFSSET"), _SHIFTED),
    **dict.fromkeys(("WAITWOBJ", "DROPWOBJ", "ACTUNIT", "DEACTUNIT", "WAITSENSOR", "SYNCTOSENSOR",
                     "DROPSENSOR"), _UNIT),
    **dict.fromkeys(("SYNCMOVEON", "SYNCMOVEOFF", "SYNCMOVEUNDO", "SYNCMOVERESUME"), _SEVERAL),
    **dict.fromkeys(("CORRCON", "CORRWRITE"), _PATH),
    **dict.fromkeys(("MOVEEXTJ", "INDAMOVE", "INDCMOVE", "INDDMOVE", "INDRMOVE"),
                    "it moves external axes: the slide would leave its station"),
    **dict.fromkeys(("SETDATAVAL", "SETALLDATAVAL"), "it changes data by a name that is a text"),
    **dict.fromkeys(("STEPBWDPATH", "PATHRECMOVEBWD", "PATHRECMOVEFWD", "CLEARPATH"),
                    "where the robot goes then is not known"),
    "SOFTACT": "a soft axis does not reach its target",
}  # fmt: skip
PREFIXES = {"EGM": _PATH, "FC": _PATH, "ARC": "it is a motion of a process, which hilcell does not "
            "follow"}  # fmt: skip
MOVES_NOTHING = (
    "ACCSET", "ADD", "BITCLEAR", "BITSET", "BOOKERRNO", "BREAK", "CIRPATHMODE", "CLEAR",
    "CLEARIOBUFF", "CLKRESET", "CLKSTART", "CLKSTOP", "CLOSE", "CLOSEDIR", "CONFJ", "CONFL",
    "CONNECT", "CORRCLEAR", "CORRDISCON", "DECR", "EOFFSOFF", "ERRLOG", "ERRRAISE", "ERRWRITE",
    "EXIT", "EXITCYCLE", "GOTO", "GRIPLOAD", "IDELETE", "IDISABLE", "IENABLE", "IERROR", "INCR",
    "INVERTDO", "IPERS", "ISIGNALAI", "ISIGNALAO", "ISIGNALDI", "ISIGNALDO", "ISIGNALGI",
    "ISIGNALGO", "ISLEEP", "ITIMER", "IWATCH", "LOAD", "MECHUNITLOAD", "MOTIONSUP", "OPEN",
    "OPENDIR", "PATHACCLIM", "PATHRESOL", "PDISPOFF", "PULSEDO", "RAISE", "READANYBIN", "RESET",
    "RESETRETRYCOUNT", "RESTOPATH", "RETRY", "RETURN", "REWIND", "SAVE", "SET", "SETAO", "SETDO",
    "SETGO", "SETSYSDATA", "SINGAREA", "SOCKETACCEPT", "SOCKETBIND", "SOCKETCLOSE",
    "SOCKETCONNECT", "SOCKETCREATE", "SOCKETLISTEN", "SOCKETRECEIVE", "SOCKETSEND", "SOFTDEACT",
    "SPEEDREFRESH", "STARTMOVE", "STARTMOVERETRY", "STOP", "STOPMOVE", "STOPMOVERESET", "STOREPATH",
    "TPERASE", "TPREADDNUM", "TPREADFK", "TPREADNUM", "TPSHOW", "TPWRITE", "TRIGGCHECKIO",
    "TRIGGEQUIP", "TRIGGINT", "TRIGGIO", "TRIGGRAMPAO", "TRIGGSPEED", "TRYNEXT", "TUNERESET",
    "TUNESERVO", "UIMSGBOX", "UIMSGWRITE", "UISHOW", "UNLOAD", "VELSET", "WAITAI", "WAITAO",
    "WAITDI", "WAITDO", "WAITGI", "WAITGO", "WAITLOAD", "WAITROB", "WAITSYNCTASK", "WAITTIME",
    "WAITUNTIL", "WORLDACCLIM", "WRITE", "WRITEANYBIN", "WRITEBIN", "WRITESTRBIN", "WZBOXDEF",
    "WZCYLDEF", "WZDISABLE", "WZDOSET", "WZENABLE", "WZFREE", "WZLIMSUP", "WZSPHDEF",
)  # fmt: skip
READS_FRAMES = {  # instructions and functions that change no tool or work object that they get
    *MOTIONS, "MOVEABSJ", "ERRLOG", "ERRWRITE", "GRIPLOAD", "IPERS", "MECHUNITLOAD", "RETURN",
    "SETAO", "SETGO", "SETSYSDATA", "TPWRITE", "UIMSGWRITE", "WAITTIME", "WAITUNTIL", "WRITE",
    "WRITEANYBIN", "WRITEBIN", "WRITESTRBIN", "WZBOXDEF", "WZCYLDEF", "WZSPHDEF",
    "ABS", "ARGNAME", "CALCJOINTT", "CALCROBT", "CPOS", "CROBT", "CROSSPROD", "DEFACCFRAME",
    "DEFDFRAME", "DEFFRAME", "DISTANCE", "DOTPROD", "EULERZYX", "ISPERS", "ISVAR", "MIRPOS",
    "NORIENT", "NUMTOSTR", "OFFS", "ORIENTZYX", "POSEINV", "POSEMULT", "POSEVECT", "PRESENT",
    "RELTOOL", "ROUND", "SQRT", "TRUNC", "VALTOSTR", "VECTMAGN",
}  # fmt: skip
WORDS = ("IF", "ELSEIF", "ELSE", "ENDIF", "WHILE", "ENDWHILE", "FOR", "ENDFOR", "TEST", "CASE",
         "DEFAULT", "ENDTEST", "ERROR", "UNDO", "BACKWARD")  # fmt: skip
HOME = re.compile(
    r"(?:[a-z]{0,3}|\w*_)(?:home|safe|park)(?:_?pos(?:ition)?)?_?\w{0,3}", re.IGNORECASE
)
UNUSED = 8.9e9  # an external axis at or beyond it is not there


def load_program(path: Path) -> Program:
    """Read a module; raises `SettingsError`."""
    return read_program(path.name, source_text(path, "RAPID"))


def read_program(file: str, text: str) -> Program:
    """Return the program; raises `SettingsError` with all that is refused, by line."""
    try:
        module = Module(text)
    except RapidError as error:
        raise SettingsError(file, [f"{file} {error}"]) from error
    reader = _Reader(file, module)
    reader.read()
    if reader.problems:
        raise SettingsError(file, [f"{file} {problem}" for problem in reader.problems])
    if not reader.targets:
        none = "no motion to a robtarget with numbers in the module: nothing to correct"
        raise SettingsError(file, [none])
    return reader.program(text)


class Place(NamedTuple):
    """Where a motion goes: a target by its key, and the shift from it in its work object."""

    key: str
    shift_mm: tuple[float, ...] | None = None


class Frame(NamedTuple):
    """A tool or work object, by name; its pose (4, 4), None if another module declares it, or
    where a ``defect`` keeps the program from being corrected.
    """

    name: str
    line: int
    pose: Array | None
    defect: str = ""

    def same(self, other: Frame) -> bool:
        same_name = self.name.upper() == other.name.upper()
        if same_name or self.pose is None or other.pose is None:
            return same_name
        return bool(np.array_equal(self.pose, other.pose))


class Call(NamedTuple):
    """A call of an own routine."""

    routine: Routine
    arguments: Arguments


class _Reader:
    """Goes through the statements once for motions, and once more for other uses of data."""

    def __init__(self, file: str, module: Module) -> None:
        self._problems: dict[int, str] = {}  # the first of each line
        self.targets: dict[str, Target] = {}
        self._file, self._module = file, module
        self._strokes: list[tuple[int, str, Place]] = []
        self._frames: dict[str, Frame] = {}  # of all motions, by "tool" and "work object"
        self._elements_of: dict[str, dict[str, object]] = {}  # robtargets of data, as in `targets`
        self._places = set[int]()  # of names that a motion works with, by character
        self._used_names = set[tuple[str, str]]()  # names of targets, by the routine of that name
        self._known_frames: dict[str, Frame] = {}  # those that motions name
        self._changed: dict[tuple[str, str], bool] = {}  # parameters that get one, by routine
        self._motions_in: dict[Frame, set[int]] = {}  # lines, by tool or work object with a defect
        self._external: list[tuple[int, str, tuple[float | None, ...]]] = []  # of homes
        self._left: dict[str, int] = {}  # remarks on parts left unchanged, by their first line
        self._calls: dict[str, list[Call]] = {}
        for routine, statement in self._all():
            if statement.head in module.routines:
                arguments = Arguments.of(statement.tokens[1:-1])
                self._calls.setdefault(statement.head, []).append(Call(routine, arguments))

    def _all(self) -> Iterator[tuple[Routine, Statement]]:
        for routine in self._module.routines.values():
            for statement in routine.statements:
                yield routine, statement

    def read(self) -> None:
        self._each(self._take)
        for routine in self._module.routines.values():
            self._each_joint_target(routine)
        self._pass_on()
        self._each(self._check_uses)
        self._check_initial_values()
        self._check_external()
        for frame, lines in self._motions_in.items():
            motions = f"{counted(len(lines), 'motion')}, the first in line {min(lines)}"
            self._problems.setdefault(frame.line, f"{frame.name}: {frame.defect} ({motions})")

    @property
    def problems(self) -> list[str]:
        """All that is refused, by line."""
        return [f"line {line}: {self._problems[line]}" for line in sorted(self._problems)]

    def _each(self, act: Callable[[Routine, Statement], None]) -> None:
        for routine, statement in self._all():
            try:
                act(routine, statement)
            except RapidError as error:
                self._problems.setdefault(statement.line, str(error))

    # -- the first pass -----------------------------------------------------------------------

    def _take(self, routine: Routine, statement: Statement) -> None:
        head, tokens = statement.head, statement.tokens
        if any(token.text == '"' for token in tokens):
            raise RapidError("a string does not end on its line")
        moves = head in MOTIONS or head == "MOVEABSJ" or head in self._moving
        if moves and id(statement) in self._handled:
            raise RapidError(
                f"{tokens[0].text} moves in an error handler or trap, which may run at any time"
            )
        if head in MOTIONS:
            self._motion(routine, statement)
            return
        if head in REFUSED:
            raise RapidError(f"{tokens[0].text}: {REFUSED[head]}")
        prefix = next((each for each in PREFIXES if head.startswith(each)), "")
        if prefix and head not in self._module.routines:
            raise RapidError(f"{tokens[0].text}: {PREFIXES[prefix]}")
        if head == "SINGAREA" and "LOCKAXIS4" in statement.words:
            raise RapidError("SingArea\\LockAxis4 changes the orientation of targets")
        self._note_call(head, statement)

    @cached_property
    def _handled(self) -> set[int]:
        """Statements of error handlers and traps."""
        return {
            id(statement)
            for routine in self._module.routines.values()
            for n, statement in enumerate(routine.statements)
            if routine.is_handled(n)
        }

    @cached_property
    def _moving(self) -> set[str]:
        """Own routines that move, by themselves or by others of this module."""
        heads = {
            name: {statement.head for statement in routine.statements}
            for name, routine in self._module.routines.items()
        }
        found = {"MOVEABSJ", *MOTIONS}
        while more := {name for name, used in heads.items() if used & found} - found:
            found |= more
        return found & set(heads)

    def _note_call(self, head: str, statement: Statement) -> None:
        """Note a call of what is not known to leave the robot where it is."""
        known = head in (*WORDS, *MOVES_NOTHING, "MOVEABSJ") or head in self._module.routines
        is_label = len(statement.tokens) == 2 and statement.tokens[1].text == ":"
        if known or is_label or _assigns(statement.tokens):
            return
        name = statement.tokens[0].text if head else quoted(statement.tokens)
        inline = quoted(statement.tokens[1:-1])
        if "[[" in inline.replace(" ", ""):
            raise RapidError(f"{name} is called with data in brackets: where it moves is not known")
        note = (
            f"{name} is a routine of another module: its motions are not corrected, and it must "
            "leave tool, work object and slide as they are"
        )
        self._left.setdefault(note, statement.line)

    def _motion(self, routine: Routine, statement: Statement) -> None:
        head, word = statement.head, statement.tokens[0].text
        arguments, tool_at = Arguments.of(statement.tokens[1:-1]), MOTIONS[head]
        if len(arguments.placed) <= tool_at:
            raise RapidError(f"{word} has fewer than {tool_at + 1} arguments")
        if odd := [each for each in arguments.named if each not in OPTIONS]:
            meant = {"ID": _SEVERAL, "CORR": _PATH}
            why = meant.get(odd[0], "an option that hilcell does not follow")
            raise RapidError(f"{word}\\{odd[0]}: {why}")
        if head.endswith("SYNC"):
            self._check_synchronous(arguments.placed[4:])
        places = self._meant(routine, arguments.placed[0])
        by = head.removeprefix("MOVE").removeprefix("TRIGG")[0]
        for place in places:
            target = self.targets[place.key]
            if by not in self._uncontrolled and not target.is_controlled:
                self.targets[place.key] = replace(target, is_controlled=True)
            if place.shift_mm is not None:
                self._strokes.append((statement.line, quoted(arguments.placed[0]), place))
        if not places:
            return
        frames = {"tool": arguments.placed[tool_at], "work object": arguments.named.get("WOBJ", ())}
        for what, tokens in frames.items():
            self._places.update(token.start for token in tokens)
            self._set_frame(what, self._frames_of(routine, what, tokens), statement.line)

    def _check_synchronous(self, placed: Sequence[Sequence[Token]]) -> None:
        """Take the routine, named by a text, that runs in the middle of a corner."""
        name = quoted(placed[0]).strip('"').upper() if placed else ""
        if name in self._moving or name not in self._module.routines:
            raise RapidError(
                f"its routine {name} moves, or is not in this module: where the robot goes then "
                "is not known"
            )

    @cached_property
    def _uncontrolled(self) -> set[str]:
        """J and L, where all of the program's ``ConfJ`` and ``ConfL`` switch the control off."""
        said: dict[str, set[bool]] = {}
        for _, statement in self._all():
            if statement.head in ("CONFJ", "CONFL"):
                said.setdefault(statement.head[4:], set()).add("OFF" in statement.words)
        return {letter for letter, off in said.items() if off == {True}}

    # -- targets ------------------------------------------------------------------------------

    def _meant(self, routine: Routine, tokens: Sequence[Token]) -> list[Place]:
        """Return the places that a motion's target may be; raises `RapidError`."""
        if not tokens:
            raise RapidError("it has no target")
        first = tokens[0]
        if first.text == "*":
            raise RapidError("its target * is not in the text")
        if first.word in ("OFFS", "RELTOOL") and len(tokens) > 1 and tokens[1].text == "(":
            return self._beside(routine, tokens)
        if is_home(first.text) and not routine.takes(first.word):
            remark = f"home pose {first.text} is left unchanged: no hole may be there"
            line = self._module.line(first.start)
            self._left.setdefault(remark, line)
            self._note_external(routine, tokens, line)
            return []
        self._places.add(first.start)
        return [Place(key) for key in self._named(routine, tokens)]

    def _named(
        self, routine: Routine, tokens: Sequence[Token], within: tuple[str, ...] = ()
    ) -> list[str]:
        """Return the keys of the robtargets that a name may mean, as they are added."""
        name, start = tokens[0].word, tokens[0].start
        if tokens[0].text == "[" or tokens[0].kind == "rows":
            key = f"@:{start}"
            self._keep(key, "target", self._module.line(start), structure(tokens))
            return [key]
        if not name or (len(tokens) > 1 and tokens[1].text != "{"):
            raise RapidError(f"its target {quoted(tokens)} is computed at run time")
        if parameter := routine.takes(name):
            if parameter.may_change:
                raise RapidError(f"{name}, a parameter of {routine.name}, may be changed there")
            self._used_names.add((routine.name, name))
            passed = self._passed(routine, name, within)
            return [
                key for caller, value, outer in passed for key in self._named(caller, value, outer)
            ]
        return self._declared(routine, name, tokens)

    def _declared(self, routine: Routine, name: str, tokens: Sequence[Token]) -> list[str]:
        """Return the keys of declared robtargets, one or elements of an array, as added."""
        datum = self._module.datum(name, routine)
        if datum is None or not datum.value:
            raise RapidError(f"{tokens[0].text} is not a robtarget with numbers in this module")
        if datum.kind != "ROBTARGET":
            raise RapidError(f"{datum.text} is {datum.kind.lower()}, expected a robtarget")
        scope = f"{routine.name}:" if name in routine.locals else ""
        if len(tokens) == 1 and scope + name in self.targets:
            return [scope + name]
        elements = self._elements_of.get(scope + name)
        if elements is None:
            elements = dict(_elements(name, structure(datum.value)))
            self._elements_of[scope + name] = elements
            self._used_names |= {
                (each.name, name)
                for each in self._module.routines.values()
                if (name not in each.locals if not scope else each is routine)
            }
        wanted = quoted(tokens).upper().replace(" ", "")
        chosen = [wanted] if wanted in elements else []
        if len(tokens) > 1 and any(token.word for token in tokens[2:-1]):
            chosen = list(elements)  # an index that is computed may be any
        if not chosen:
            raise RapidError(f"{quoted(tokens)} is no element of {datum.text}, line {datum.line}")
        for each in chosen:
            if scope + each not in self.targets:
                label = datum.text + each.removeprefix(name)
                self._keep(scope + each, label, datum.line, elements[each])
        return [scope + each for each in chosen]

    def _passed(
        self, routine: Routine, name: str, within: tuple[str, ...]
    ) -> list[tuple[Routine, Sequence[Token], tuple[str, ...]]]:
        """Return what this module's calls of a routine pass for a parameter; raises `RapidError`.

        ``within``: the routines whose parameters are being looked up.
        """
        if routine.name in within:
            raise RapidError(f"{routine.name} calls itself: its {name} is not known")
        outer: tuple[str, ...] = (*within, routine.name)
        found = [
            (call.routine, value, outer)
            for call in self._calls.get(routine.name, ())
            for parameter, value in routine.matched(call.arguments)
            if parameter.name == name and value
        ]
        if not found:
            remark = (
                f"no call in this module passes {name} to {routine.name}: motions to it are not "
                "corrected"
            )
            self._left.setdefault(remark, routine.line)
        return found

    def _keep(self, key: str, name: str, line: int, value: object) -> None:
        try:
            self.targets[key] = _target(name, line, value)
        except RapidError as error:
            raise RapidError(f"{name} (line {line}): {error}") from error

    def _beside(self, routine: Routine, tokens: Sequence[Token]) -> list[Place]:
        """Return the places of ``Offs(p,x,y,z)`` or ``RelTool(p,x,y,z)``; raises `RapidError`."""
        word = tokens[0].text
        if closing(tokens, 1) != len(tokens) - 1:
            raise RapidError(f"its target {quoted(tokens)} is computed at run time")
        arguments = Arguments.of(tokens[2:-1])
        if len(arguments.placed) != 4:
            raise RapidError(f"{word} has {len(arguments.placed)} arguments, expected 4")
        for name, value in arguments.named.items():
            if self._numbers(routine, value) != [0.0]:
                raise RapidError(
                    f"{word}\\{name} turns the tool: only shifts keep the correction of the target"
                )
        if arguments.placed[0][:1] and arguments.placed[0][0].word in ("OFFS", "RELTOOL"):
            raise RapidError(f"{word} of {arguments.placed[0][0].text}: state one shift")
        numbers = (self._numbers(routine, each) for each in arguments.placed[1:])
        shifts_mm = np.array([*product(*numbers)])
        found = list[Place]()
        for place in self._meant(routine, arguments.placed[0]):
            R = np.eye(3)
            if word.upper() == "RELTOOL":
                turn = [each.value for each in self.targets[place.key].numbers[3:]]
                R = from_quaternions([turn])[0]
            found += [Place(place.key, each) for each in map(tuple, (shifts_mm @ R.T).tolist())]
        return found

    def _numbers(
        self, routine: Routine, tokens: Sequence[Token], within: tuple[str, ...] = ()
    ) -> list[float]:
        """Return the values that a number, a constant or a parameter may have."""
        sign = -1.0 if tokens[:1] and tokens[0].text == "-" else 1.0
        bare = tokens[1:] if tokens[:1] and tokens[0].text in "+-" else tokens
        if len(bare) == 1 and bare[0].kind == "number":
            return [sign * float(bare[0].text)]
        if len(bare) == 1 and bare[0].word:
            name = bare[0].word
            if (parameter := routine.takes(name)) and not parameter.may_change:
                passed = self._passed(routine, name, within)
                if not routine.is_local and passed:
                    remark = (
                        f"{routine.name} is not LOCAL: shifts of other modules' calls count too"
                    )
                    self._left.setdefault(remark, routine.line)
                if passed:
                    return [
                        sign * value
                        for caller, tokens_of, outer in passed
                        for value in self._numbers(caller, tokens_of, outer)
                    ]
            datum = self._module.datum(name, routine)
            if datum is not None and (datum.storage, datum.kind) == ("CONST", "NUM"):
                return [sign * value for value in self._numbers(routine, datum.value, within)]
        raise RapidError(
            f"its shift {quoted(tokens)} is computed at run time, expected numbers or CONST num"
        )

    # -- tool and work object -----------------------------------------------------------------

    def _frames_of(
        self, routine: Routine, what: str, tokens: Sequence[Token], within: tuple[str, ...] = ()
    ) -> list[Frame]:
        if not tokens:
            return [Frame("wobj0", 0, np.eye(4))]
        name, text = tokens[0].word, tokens[0].text
        if len(tokens) > 1 or not name:
            raise RapidError(f"its {what} {quoted(tokens)} is computed at run time")
        if routine.takes(name):
            return [
                frame
                for caller, value, outer in self._passed(routine, name, within)
                for frame in self._frames_of(caller, what, value, outer)
            ]
        if name in ("TOOL0", "WOBJ0"):
            return [Frame(text, 0, np.eye(4))]
        datum = self._module.datum(name, routine)
        if datum is None:
            self._known_frames[name] = Frame(text, 0, None)
        elif name not in self._known_frames:
            try:
                self._known_frames[name] = Frame(text, datum.line, _frame_of(datum))
            except RapidError as error:
                self._known_frames[name] = Frame(text, datum.line, None, str(error))
        return [self._known_frames[name]]

    def _set_frame(self, what: str, frames: Sequence[Frame], line: int) -> None:
        for frame in frames:
            if frame.defect:
                self._motions_in.setdefault(frame, set()).add(line)
                continue
            known = self._frames.setdefault(
                what, frame if frame.line else frame._replace(line=line)
            )
            if not known.same(frame):
                raise RapidError(
                    f"its {what} is {frame.name}, that of other motions "
                    f"{known.name} (line {known.line}): correct the motions of each apart"
                )

    # -- joint targets ------------------------------------------------------------------------

    def _each_joint_target(self, routine: Routine) -> None:
        """Leave the joint targets of a routine that are no holes; refuse the others."""
        moves = [n for n, each in enumerate(routine.statements) if each.head in MOTIONS]
        is_aside = not moves and (not self._calls.get(routine.name) or is_home(routine.name))
        for n, statement in enumerate(routine.statements):
            if statement.head != "MOVEABSJ":
                continue
            arguments = Arguments.of(statement.tokens[1:-1])
            stated = arguments.placed[0] if arguments.placed else ()
            name = quoted(stated)
            outside = bool(moves) and (n < moves[0] or n > moves[-1])
            if "ID" in arguments.named:
                self._problems.setdefault(statement.line, f"MoveAbsJ\\ID: {_SEVERAL}")
            elif not (is_home(name) or outside or is_aside):
                problem = (
                    f"MoveAbsJ {name}: a joint target may be a hole, and is not corrected; state "
                    "it as a robtarget, or a home with HOME, SAFE or PARK in its name"
                )
                self._problems.setdefault(statement.line, problem)
            else:
                remark = f"joint target {name} is left unchanged: no hole may be there"
                self._left.setdefault(remark, statement.line)
                self._note_external(routine, stated, statement.line)

    def _note_external(self, routine: Routine, stated: Sequence[Token], line: int) -> None:
        """Take the external axes of what is left unchanged, where it has numbers in this module."""
        datum = self._module.datum(stated[0].word, routine) if stated else None
        value = structure(datum.value if datum else stated)
        for each in (each for _, each in _elements("", value) if isinstance(each, list)):
            try:
                external = tuple(map(_axis, floats(each[-1], 6, "its extax")))
                self._external.append((line, quoted(stated), external))
            except RapidError as error:
                self._problems.setdefault(line, f"{quoted(stated)}: {error}")

    def _check_external(self) -> None:
        """Refuse targets at which external axes stand elsewhere than at the first one."""
        if not self.targets:
            return
        first = next(iter(self.targets.values()))
        for target in self.targets.values():
            if target.external != first.external:
                problem = (
                    f"{target.name} has other external axes (extax) than {first.name} of line "
                    f"{first.line}: a program is corrected for one station"
                )
                self._problems.setdefault(target.line, problem)
        for line, name, external in self._external:
            pairs = zip(external, first.external, strict=True)
            if any(at is not None and other is None for at, other in pairs):
                problem = (
                    f"{name} moves external axes, and the targets do not say where they stand "
                    "(extax): state it in both, or in none"
                )
                self._problems.setdefault(line, problem)

    # -- the second pass ----------------------------------------------------------------------

    def _check_uses(self, routine: Routine, statement: Statement) -> None:
        tokens = statement.tokens
        called = self._module.routines.get(statement.head)
        for at, token in enumerate(tokens):
            if not token.word or token.start in self._places:
                continue
            if _is_of_another(tokens, at):
                continue
            if token.word in self._known_frames and token.word not in routine.locals:
                self._check_frame_use(statement, at)
            if (routine.name, token.word) not in self._used_names:
                continue
            if _is_assigned(tokens, at):
                raise RapidError(f"{token.text} is changed at run time")
            if called is None or not self._is_passed_on(called, tokens, at):
                raise RapidError(
                    f"{token.text} is used besides moving to it: its correction would go there too"
                )

    def _pass_on(self) -> None:
        """Add the parameters to which names of targets are passed."""
        calls = [(name, call) for name, found in self._calls.items() for call in found]
        before = -1
        while before != len(self._used_names):
            before = len(self._used_names)
            for name, call in calls:
                for parameter, value in self._module.routines[name].matched(call.arguments):
                    if value and (call.routine.name, value[0].word) in self._used_names:
                        self._used_names.add((name, parameter.name))

    @staticmethod
    def _is_passed_on(called: Routine, tokens: Sequence[Token], at: int) -> bool:
        """Whether a token is an argument of an own routine that may only move to it."""
        return any(
            value and value[0].start == tokens[at].start and not parameter.may_change
            for parameter, value in called.matched(Arguments.of(tokens[1:-1]))
        )

    def _check_initial_values(self) -> None:
        """Refuse data that begin with a target's value, in the module or in a routine."""
        for routine in (None, *self._module.routines.values()):
            for datum in (routine or self._module).data.values():
                for token in datum.value:
                    is_used = token.word in self._elements_of  # of the module
                    if routine:
                        is_used = (routine.name, token.word) in self._used_names
                    if is_used and token.word:
                        problem = f"{datum.text} begins as {token.text}: its correction would go"
                        self._problems.setdefault(datum.line, f"{problem} there too")

    def _check_frame_use(self, statement: Statement, at: int) -> None:
        tokens, token = statement.tokens, statement.tokens[at]
        if _is_assigned(tokens, at):
            raise RapidError(f"{token.text} is changed at run time, and motions work in it")
        name, handed = _call_around(tokens, at)
        if called := self._module.routines.get(name.word):
            is_changed = any(
                parameter.may_change
                and token in value[:1]
                and self._is_changed(called, parameter.name)
                for parameter, value in called.matched(Arguments.of(handed))
            )
        else:
            is_assignment = name is tokens[0] and _assigns(tokens)
            is_changed = not (is_assignment or name.word in READS_FRAMES or name.word in WORDS)
        if is_changed:
            raise RapidError(f"{name.text} may change {token.text}, and motions work in it")

    def _is_changed(self, routine: Routine, parameter: str) -> bool:
        """Whether a routine may change what it gets for a parameter, by itself or by others."""
        key = (routine.name, parameter)
        if key not in self._changed:
            self._changed[key] = False  # by a call within itself
            try:
                for statement in routine.statements:
                    for at, token in enumerate(statement.tokens):
                        if token.word == parameter and not _is_of_another(statement.tokens, at):
                            self._check_frame_use(statement, at)
            except RapidError:
                self._changed[key] = True
        return self._changed[key]

    # -- the result ---------------------------------------------------------------------------

    def program(self, text: str) -> Program:
        base, tool = self._frames["work object"], self._frames["tool"]
        stated_base = stated_tool = None
        if base.pose is not None:
            values = tuple(zyx_from_pose(base.pose[None])[0].tolist())
            stated_base = StatedBase(f"{self._file} line {base.line}", values)
        if tool.pose is not None:
            where = f"{self._file} line {tool.line}"
            stated_tool = StatedTool(where, tool.name, None, tool.pose)
        places = {key: n for n, key in enumerate(self.targets)}
        strokes = [
            Stroke(
                f"{what} ({self._file} line {line}) from {self.targets[place.key].name}",
                places[place.key],
                place.shift_mm or (0.0, 0.0, 0.0),
            )
            for line, what, place in self._strokes
        ]
        return Program(
            self._file,
            text,
            list(self.targets.values()),
            self._module.head_end,
            list(self._notes()),
            strokes,
            stated_base,
            stated_tool,
        )

    def _notes(self) -> Iterator[str]:
        """Yield the parts that were left as they are, and those that reach further."""
        yield from (f"{what} (line {line})" for what, line in self._left.items())
        for what, frame in self._frames.items():
            if frame.pose is None:
                yield (
                    f"its {what} {frame.name} (line {frame.line}) is in another module: it "
                    "must be that of the targets"
                )
        yield "the base frame of the controller must be zero, so that its world is {B}"
        data = self._module.data
        shared = [
            each
            for each in dict.fromkeys(key.partition("{")[0] for key in self.targets)
            if each in data and not data[each].is_local
        ]
        shared = [data[each].text for each in shared]
        if shared:
            yield (
                f"not LOCAL: {', '.join(bounded(shared))}: other modules that use them get their "
                "correction, too"
            )
        for key, elements in self._elements_of.items():
            scope = key.removesuffix(key.rpartition(":")[2])
            keys = [scope + each for each in elements]
            names = [self.targets[each].name for each in keys if each in self.targets]
            array = names[0].partition("{")[0]
            left = [array + each[each.index("{") :] for each in keys if each not in self.targets]
            if left:
                yield f"elements of {array} that no motion uses, left: {', '.join(bounded(left))}"
        used = {key.partition("{")[0] for key in self.targets}
        unused = [
            each.text
            for each in data.values()
            if each.kind == "ROBTARGET" and each.name not in used and not is_home(each.name)
        ]
        if unused:
            yield f"not used by a motion, left: {', '.join(bounded(unused))}"


def is_home(name: str) -> bool:
    """Whether a name says that no hole is there: pHome, jSafe1, Target_Home, park_pos."""
    return HOME.fullmatch(name) is not None


def _assigns(tokens: Sequence[Token]) -> bool:
    """Whether a statement is an assignment, and no call with an option."""
    return any(token.text == ":=" for token in split(tokens, "\\")[0])


def _is_assigned(tokens: Sequence[Token], at: int) -> bool:
    """Whether the name at ``at`` is assigned: ``name:=``, ``name.trans.x:=``, ``name{1}:=``."""
    if at:
        return False
    at += 1
    while at < len(tokens) and tokens[at].text in (".", "{"):
        at = closing(tokens, at) + 1 if tokens[at].text == "{" else at + 2
    return at < len(tokens) and tokens[at].text == ":="


def _is_of_another(tokens: Sequence[Token], at: int) -> bool:
    """Whether the name at ``at`` is that of a component, or of an option."""
    return at > 0 and tokens[at - 1].text in (".", "\\")


def _call_around(tokens: Sequence[Token], at: int) -> tuple[Token, Sequence[Token]]:
    """Return the name and arguments of the innermost call, of a function or the statement's own,
    that the name at ``at`` is handed to.
    """
    depth = 0
    for n in range(at - 1, 1, -1):
        depth += (tokens[n].text in OPENS) - (tokens[n].text in CLOSES)
        if depth > 0:
            depth, name = 0, tokens[n - 1]
            if tokens[n].text == "(" and name.word and name.word not in OPERATORS:
                return name, tokens[n + 1 : closing(tokens, n)]
    return tokens[0], tokens[1:-1]


def _elements(name: str, value: object, index: str = "") -> Iterator[tuple[str, object]]:
    """Yield the robtargets of a value: itself, or the elements of an array of any dimensions."""
    is_one = isinstance(value, list) and bool(value) and isinstance(value[0], Token)
    if is_one or not isinstance(value, list):
        yield f"{name}{{{index}}}" if index else name, value
        return
    for n, each in enumerate(value, start=1):
        yield from _elements(name, each, f"{index},{n}" if index else str(n))


def _axis(value: float) -> float | None:
    return None if value >= UNUSED else value


def _target(name: str, line: int, value: object) -> Target:
    """Return the target of a robtarget's value; raises `RapidError`."""
    if not isinstance(value, list) or len(value) != 4:
        raise RapidError("is not a robtarget in numbers: [[x,y,z],[q1..q4],[cf..],[eax..]]")
    trans, rot = row(value[0], 3, "its place"), row(value[1], 4, "its orientation")
    conf, external = floats(value[2], 4, "its configuration"), floats(value[3], 6, "its extax")
    check_unit([each.text for each in rot])
    if not all(each.is_integer() for each in conf):
        raise RapidError("has a configuration that is not of whole numbers")
    cf1, cf4, cf6, cfx = map(int, conf)
    if cfx not in range(8):
        raise RapidError(f"has cfx {cfx}, expected 0 to 7")
    axes = tuple(map(_axis, external))
    return Target(name, line, [*trans, *rot], (cf1, cf4, cf6), cfx, axes)


def check_unit(texts: Sequence[str]) -> None:
    """Raise `RapidError` for a quaternion whose length is off 1 by more than its rounding."""
    length = math.hypot(*map(float, texts))
    if abs(length - 1.0) <= 1e-6:
        return
    exponents = [Decimal(each).as_tuple().exponent for each in texts]
    decimals = max(-each for each in exponents if isinstance(each, int))
    if not 0 < decimals < 6 or not abs(length - 1.0) <= 10.0**-decimals:
        raise RapidError(
            f"its orientation {', '.join(texts)} has the length {length:.6f}, expected 1: it is no "
            "rotation"
        )


def _frame_of(datum: Datum) -> Array:
    """Return the pose (4, 4) of tooldata or wobjdata; raises `RapidError`."""
    value: object = structure(datum.value)
    if not isinstance(value, list) or datum.kind not in ("TOOLDATA", "WOBJDATA"):
        raise RapidError(f"is {datum.kind.lower()} without numbers in this module")
    said = ["" if isinstance(each, (list, Token)) else quoted(each).upper() for each in value]
    if datum.kind == "TOOLDATA":
        if len(value) != 3 or said[0] != "TRUE":
            raise RapidError("its robhold is not TRUE: the robot does not hold this tool")
        return _pose(value[1])
    if len(value) != 5 or said[0] != "FALSE":
        raise RapidError("its robhold is not FALSE: the robot holds the part")
    if said[1] != "TRUE" or said[2] != '""':
        raise RapidError(
            f"its frame moves with another unit (ufprog {said[1]}, ufmec {said[2]}): where the "
            "targets are is not known"
        )
    return _pose(value[3]) @ _pose(value[4])


def _pose(value: object) -> Array:
    if not isinstance(value, list) or len(value) != 2:
        raise RapidError("its frame is not in numbers")
    turn = floats(value[1], 4, "its orientation")
    check_unit([each.strip() for each in value[1].text[1:-1].split(",")])
    return matrix(from_quaternions([turn])[0], np.array(floats(value[0], 3, "its place")))
