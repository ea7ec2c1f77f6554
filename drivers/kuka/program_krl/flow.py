"""Every path that a KRL program may take, and what a motion keeps from the motion before it.

A state, such as the slide's position, is passed from a statement to those after it, through
branches, loops, jumps and the program's own subprograms; conditions are not judged, so that a path
may be followed that is never taken. Subprograms of interrupts and triggers may run after any
statement.

A component that a motion leaves out keeps its value from the motion before, a home move or another
to joints included. An external axis, as the slide E1, must have one position for all targets: a
program is corrected for one station.

Only a motion by joints sets a posture: S of its point, or the joints of a home move. All others
keep the arm's, whatever S their points state. The bits are those of a status in
`hilcell.geometry.inverse`; `Bits.of_joints` derives those that need no arm.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence, Set
from dataclasses import dataclass
from itertools import chain
from typing import Generic, NamedTuple, TypeVar

from drivers.kuka.krl import SLIDE
from drivers.kuka.program_krl.data import (
    EXTERNAL,
    KrlError,
    Statement,
    aggregate,
    closing,
    number,
    opens,
    quoted,
)
from drivers.kuka.program_krl.program import Kept, Target
from hilcell.errors import bounded

State = TypeVar("State", bound=Hashable)

ENDS = {
    "ENDIF": "IF", "ENDSWITCH": "SWITCH", "ENDFOR": "FOR", "ENDWHILE": "WHILE", "ENDLOOP": "LOOP",
    "UNTIL": "REPEAT",
}  # fmt: skip
PARTS = {"ELSE": "IF", "CASE": "SWITCH", "DEFAULT": "SWITCH"}
LOOPS = ("FOR", "WHILE", "LOOP", "REPEAT")


class _Open(NamedTuple):
    """An open branch or loop: its word, position, parts, and jumps to its end."""

    word: str
    at: int
    parts: list[int]
    exits: list[int]


class Flow(Generic[State]):
    """Follows states through a program's statements by ``step``, called for each of them.

    Of states with one ``key`` the first represents all: otherwise the number of paths through
    branches would grow exponentially.
    """

    DEEPEST = 50  # calls of subprograms within one another: controllers have at most 20

    def __init__(
        self,
        blocks: Mapping[str, Sequence[Statement]],
        step: Callable[[Statement, State], list[State]],
        key: Callable[[State], Hashable] = lambda state: state,
    ) -> None:
        self._blocks, self._step, self._key = blocks, step, key
        self._next = {name: self._successors(block) for name, block in blocks.items()}
        self._done: dict[tuple[str, Hashable], list[State]] = {}
        self._depth = 0
        found = [each for block in blocks.values() for each in block]
        self._any_time = dict.fromkeys(
            name for each in found if each.is_at_any_time for name in self._called(each)
        )
        called = {name for each in found for name in self._called(each)}
        self._entries = [name for n, name in enumerate(blocks) if n == 0 or name not in called]

    def follow(self, begin: State) -> None:
        """Follow the first program, and each that no path from others leads to, from ``begin``.
        Raises `KrlError` where subprograms call one another too deeply.
        """
        for name in (*self._entries, *self._blocks):
            if not any(entered == name for entered, _ in self._done):
                self._through(name, begin)

    def _through(self, name: str, begin: State) -> list[State]:
        begun = name, self._key(begin)
        if begun in self._done:
            return self._done[begun]
        self._done[begun] = [begin]  # as it calls itself
        self._depth += 1
        if self._depth > self.DEEPEST:
            raise KrlError(
                f"{name} is called within more than {self.DEEPEST} others; call it directly"
            )
        block, following, ends = self._blocks[name], self._next[name], list[State]()
        at_any_time = self._any_time if name not in self._any_time else ()
        seen, todo = set[tuple[int, Hashable]](), [(0, begin)]
        while todo:
            at, state = todo.pop()
            place = at, self._key(state)
            if place in seen:
                continue
            seen.add(place)
            if at >= len(block):
                ends.append(state)
                continue
            left = self._after(block[at], state)
            more = [self._through(each, s) for each in at_any_time for s in left]
            left = self._distinct([*left, *chain.from_iterable(more)])
            todo += [(after, each) for after in following[at] for each in left]
        self._done[begun] = ends
        self._depth -= 1
        return ends

    def _after(self, statement: Statement, state: State) -> list[State]:
        if statement.is_at_any_time:
            return [state]
        left = self._distinct(self._step(statement, state))
        for name in self._called(statement):
            left = self._distinct([end for each in left for end in self._through(name, each)])
        return left

    def _distinct(self, states: list[State]) -> list[State]:
        if len(states) == 1:
            return states
        found: dict[Hashable, State] = {}
        for each in states:
            found.setdefault(self._key(each), each)
        return list(found.values())

    def _called(self, statement: Statement) -> list[str]:
        pairs = zip(statement.tokens, statement.tokens[1:], strict=False)
        return [one.word for one, other in pairs if other.text == "(" and one.word in self._blocks]

    @staticmethod
    def _close(
        begun: _Open, end: int, block: Sequence[Statement], following: list[list[int]]
    ) -> None:
        """Lead the paths of a branch or loop that ends at ``end`` to their successors."""
        at, parts = begun.at, begun.parts
        if begun.word in LOOPS:
            following[end] = [at] if begun.word != "REPEAT" else [at, end + 1]
            if begun.word in ("FOR", "WHILE"):
                following[at].append(end + 1)
            for each in begun.exits:
                following[each] = [end + 1]
            return
        for each in parts:
            following[each] = [end]
        first = [] if begun.word == "SWITCH" else [at + 1]
        whole = any(block[each].head in ("ELSE", "DEFAULT") for each in parts)
        following[at] = [*first, *(each + 1 for each in parts), *([] if whole else [end])]

    @staticmethod
    def _successors(block: Sequence[Statement]) -> list[list[int]]:
        """Return for each statement the places of those that may follow; the block's end is one."""
        following = [[n + 1] for n in range(len(block))]
        labels = {each.head: n for n, each in enumerate(block) if each.is_label}
        opened: list[_Open] = []
        for n, each in enumerate(block):
            if each.head in (*LOOPS, "IF", "SWITCH"):
                opened.append(_Open(each.head, n, [], []))
            elif each.head in PARTS and opened and opened[-1].word == PARTS[each.head]:
                opened[-1].parts.append(n)
            elif each.head in ENDS and opened and opened[-1].word == ENDS[each.head]:
                Flow._close(opened.pop(), n, block, following)
            elif each.head == "EXIT":
                loops = [one for one in opened if one.word in LOOPS]
                following[n] = []
                (loops[-1].exits if loops else []).append(n)
            elif each.head == "GOTO":
                label = each.tokens[1].word if len(each.tokens) > 1 else ""
                following[n] = [labels.get(label, len(block))]
            elif each.head in ("RETURN", "RESUME", "END", "ENDFCT"):
                following[n] = [len(block)]
        return following


class Stop(NamedTuple):
    """Where a motion may end: at a target, ``key``, or at joints.

    ``values`` are the external axes and joints that it states; None if not defined in these files.
    ``status`` is S where a motion by joints states it.
    """

    key: str
    values: Mapping[str, float] | None
    status: int | None = None


class Held(NamedTuple):
    """An axis' value, and the line of the motion that set it. None of line 0: not set by any motion
    yet; None of a line: unknown from there on.
    """

    value: float | None = None
    line: int = 0


class ExternalRule:
    """Determines the values of the external axes at each target."""

    def __init__(
        self,
        file: str,
        blocks: Mapping[str, Sequence[Statement]],
        stops: Mapping[int, Sequence[Stop]],
        targets: Mapping[str, Target],
    ) -> None:
        self._file, self._stops, self._targets = file, stops, targets
        stated = {
            name
            for found in stops.values()
            for stop in found
            for name in EXTERNAL
            if stop.values is not None and name in stop.values
        }
        self._held = {name: self._follow(name, blocks) for name in sorted(stated)}

    def _follow(
        self, axis: str, blocks: Mapping[str, Sequence[Statement]]
    ) -> dict[str, list[Held]]:
        """Return the values of an axis that each target may be reached with."""
        held: dict[str, set[Held]] = {key: set() for key in self._targets}

        def step(statement: Statement, before: Held) -> list[Held]:
            after = list[Held]()
            for stop in self._stops.get(statement.line, ()):
                found = before
                if stop.values is None and before.value is not None:
                    found = Held(None, statement.line)
                elif stop.values is not None and axis in stop.values:
                    found = Held(stop.values[axis], statement.line)
                after.append(found)
                if stop.key in held:
                    held[stop.key].add(found)
            return after or [before]

        Flow(blocks, step, lambda each: (each.value, each.line > 0)).follow(Held())
        return {key: sorted(found, key=lambda each: each.line) for key, found in held.items()}

    def problems(self) -> list[str]:
        """Return the targets that an axis has another value at than at the first one."""
        found = []
        for axis, held in self._held.items():
            known = [
                (target, value, f"{axis} {value:g}{self._by(target, axis, line)}")
                for target, values in ((self._targets[key], held[key]) for key in held)
                for value, line in values
                if value is not None
            ]
            found += [
                f"{target.file} line {target.line}: {target.name} has {stands}, "
                f"{known[0][0].where} has {known[0][2]}: a program is corrected for one station"
                for target, value, stands in known
                if value != known[0][1]
            ]
        return found

    def notes(self) -> list[str]:
        """Return the targets where an axis is not known although the program states it."""
        return [
            f"{axis} is not known at {', '.join(bounded(names))}: no motion in these files says "
            "where it stands there; it must stand as at the station"
            for axis, held in self._held.items()
            if (names := [self._targets[key].name for key, values in held.items()
                          if any(value is None for value, _ in values)])
        ]  # fmt: skip

    def slide(self) -> tuple[str, float] | None:
        """First target with a known slide position, and that position, mm. One that is no longer
        known comes first, as NaN.
        """
        found = [
            (self._targets[key], value, line)
            for key, values in self._held.get(SLIDE, {}).items()
            for value, line in values
        ]
        for target, value, line in found:
            if value is None and line:
                where = f"{target.where} states no {SLIDE}: the home move of line {line}, which"
                return f"{where} has no numbers in these files,", math.nan
        known = [
            (f"{target.where} by {SLIDE}{by}" if by else target.where, value)
            for target, value, line in found
            if value is not None
            for by in [self._by(target, SLIDE, line)]
        ]
        return known[0] if known else None

    def _by(self, target: Target, axis: str, line: int) -> str:
        """Return the motion that gave a target its value; "" where the target states it."""
        return "" if axis in target.numbers else f" of {self._file} line {line}"


class Bits(NamedTuple):
    """The bits of a status that are ``known``; nothing else, so that few states differ."""

    known: int = 0
    status: int = 0

    @staticmethod
    def of_joints(values: Mapping[str, float]) -> Bits:
        """Return the bits that joints in deg determine without the arm's links."""
        a3_deg, a5_deg = ((values.get(name, 0.0) + 180.0) % 360.0 - 180.0 for name in ("A3", "A5"))
        elbow, wrist, known, status = 0b010, 0b100, 0, 0
        if abs(a3_deg) > 15.0:  # an arm is stretched at some degrees beside zero, by its links
            known, status = known | elbow, status | elbow * (a3_deg > 0)
        if abs(a5_deg) > 0.01812:  # so near to zero the next motion may take either side
            known, status = known | wrist, status | wrist * (a5_deg < 0)
        return Bits(known, status)


def kept_postures(
    file: str,
    blocks: Mapping[str, Sequence[Statement]],
    stops: Mapping[int, Sequence[Stop]],
    targets: Mapping[str, Target],
) -> list[Kept]:
    """Return the targets that are reached in the posture of a motion before, as far as known."""
    found: dict[str, set[Bits]] = {key: set() for key in targets}
    lines: dict[Bits, int] = {}  # of the first motion that takes a posture

    def step(statement: Statement, before: Bits) -> list[Bits]:
        after = list[Bits]()
        for stop in stops.get(statement.line, ()):
            taken = before
            if not stop.key:
                taken = Bits.of_joints(stop.values or {})
            elif stop.status is not None:
                taken = Bits(0b111, stop.status & 0b111)
            else:
                found[stop.key].add(before)
            if taken != before:
                lines[taken] = min(statement.line, lines.get(taken, statement.line))
            after.append(taken)
        return after or [before]

    Flow(blocks, step).follow(Bits())
    return [
        Kept(f"{targets[key].where}, kept from {file} line {lines[each]}", *each)
        for key, bits in found.items()
        for each in sorted(bits)
        if each.known
    ]


STROKES = ("LIN_REL", "SLIN_REL")
MOTIONS = (
    "PTP", "LIN", "CIRC", "SPTP", "SLIN", "SCIRC", "SPL", "SPLINE", "PTP_SPLINE", "PTP_REL",
    "CIRC_REL", "SPTP_REL", "SCIRC_REL", "ASYPTP",
)  # fmt: skip
BRANCHES = {
    *ENDS, *ENDS.values(), *PARTS, "DEF", "DEFFCT", "GLOBAL", "END", "ENDFCT", "GOTO", "EXIT",
    "RETURN", "RESUME",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Relative:
    """A stroke of line ``line``: where it begins and ends, in the tool's frame, from ``key``."""

    word: str
    line: int
    key: str
    from_mm: tuple[float, float, float]
    shift_mm: tuple[float, float, float]


class StrokeRule:
    """Follows a program's statements in order and tracks the robot's last target.

    ``LIN_REL {X 20} #TOOL`` starts at the robot's position, so it carries the correction of the
    point before it. That point is known only on a straight path from a motion to a point: not after
    a branch, a loop's begin or end, a label or an own subprogram that moves. An own subprogram of
    strokes only is read at each of its calls. Programs of other files are assumed to leave the
    robot in place; a note names them.
    """

    def __init__(self, blocks: Mapping[str, Sequence[Statement]], moving: Set[str]) -> None:
        self._moving = moving
        self._drills = {
            name: strokes
            for name, block in blocks.items()
            if (strokes := self._only_strokes(block, moving)) and self._is_called(name, blocks)
        }
        self._read_at_calls = {each.line for block in self._drills.values() for each in block}
        self._keys: Sequence[str] = ()
        self._shift_mm = (0.0, 0.0, 0.0)
        self._interrupted = 0  # the line of an interrupt that may move the robot at any time

    def start_at(self, keys: Sequence[str]) -> None:
        """Start strokes at one of these targets; without any the place is unknown."""
        self._keys, self._shift_mm = keys, (0.0, 0.0, 0.0)

    def pass_by(self, statement: Statement) -> list[Relative]:
        """Take a statement that is no motion; return the strokes of the subprogram it calls. Raises
        `KrlError` as `take` does.
        """
        if statement.head in self._drills:
            return [found for each in self._drills[statement.head] for found in self._from(each)]
        moves = any(token.word in self._moving for token in statement.tokens)
        if statement.head in BRANCHES or statement.is_label or moves:
            self.start_at(())
        if moves and statement.is_at_any_time:
            self._interrupted = self._interrupted or statement.line
        return []

    def take(self, statement: Statement) -> list[Relative]:
        """Return the strokes that a relative motion may be; raises `KrlError`."""
        return [] if statement.line in self._read_at_calls else self._from(statement)

    def _from(self, statement: Statement) -> list[Relative]:
        keys, self._keys = self._keys, ()  # where it leads is not known if it is refused
        shift_mm = self._shift(statement)
        if self._interrupted:
            raise KrlError(
                f"{statement.head} is a relative motion, and the interrupt or trigger of line "
                f"{self._interrupted} may move the robot before it"
            )
        if not keys:
            raise KrlError(
                f"{statement.head} is a relative motion, and the point before it is not known: "
                "move to a point with X, Y, Z just before it, outside of branches"
            )
        begin = self._shift_mm
        x, y, z = (a + b for a, b in zip(begin, shift_mm, strict=True))
        self._keys, self._shift_mm = keys, (x, y, z)
        return [Relative(statement.head, statement.line, key, begin, (x, y, z)) for key in keys]

    @staticmethod
    def _only_strokes(block: Sequence[Statement], moving: Set[str]) -> list[Statement]:
        """Return the strokes of a subprogram of strokes alone, without a branch; else none."""
        strokes = [each for each in block if each.head in STROKES]
        others = [each for each in block if each.head not in (*STROKES, "END")]
        straight = all(
            each.head not in BRANCHES
            and not each.is_label
            and not any(token.word in {*moving, *STROKES, *MOTIONS} for token in each.tokens)
            for each in others
        )
        return strokes if straight else []

    @staticmethod
    def _is_called(name: str, blocks: Mapping[str, Sequence[Statement]]) -> bool:
        """Whether a subprogram is called, and only by statements of their own: ``NAME( )``."""
        calls = [each for block in blocks.values() for each in block for token in each.tokens
                 if token.word == name]  # fmt: skip
        return bool(calls) and all(
            each.head == name and len(each.tokens) == 3 and each.tokens[1].text == "("
            for each in calls
        )

    @staticmethod
    def _shift(statement: Statement) -> tuple[float, float, float]:
        """Return X, Y, Z of a relative motion along the tool; raises `KrlError`."""
        head, tokens = statement.head, statement.tokens[1:]
        if not tokens or not opens(tokens[0]):
            raise KrlError(f"{head}: expected a relative motion by a structure of numbers")
        end = closing(tokens, 0) + 1
        fields = aggregate(tokens[:end])
        rest = tokens[end:]  # approximations may surround its frame
        words = [token.word for token in rest if token.text != ","]
        frames = [word for word in words if word in ("#TOOL", "#BASE")]
        left = set(words) - {"#TOOL", "#BASE", "C_DIS", "C_VEL", "C_ORI", "C_SPL"}
        if left or len(frames) > 1:
            raise KrlError(
                f"{head} is a relative motion with {quoted(rest)}, which is not understood"
            )
        others = [name for name in fields if name not in ("X", "Y", "Z")]
        if others:
            raise KrlError(
                f"{head} is a relative motion that changes {', '.join(others)}: only strokes in "
                "X, Y, Z keep the correction of the point before them"
            )
        if frames != ["#TOOL"]:
            raise KrlError(
                f"{head} is a relative motion in the base: only strokes along the tool, #TOOL, "
                "keep the correction of the point before them"
            )
        values = {name: number(name, each).value for name, each in fields.items()}
        x, y, z = (values.get(name, 0.0) for name in "XYZ")
        return x, y, z
