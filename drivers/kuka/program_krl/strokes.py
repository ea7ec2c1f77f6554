"""Strokes: relative motions along the tool after a point, which leave its numbers as they are.

``LIN_REL {X 20} #TOOL`` starts where the robot stands, so it takes the correction of the point
before it along. That is only known on a straight way from a motion to a point: not after a branch,
a loop's begin or end, a label or an own subprogram that moves. An own subprogram of nothing but
strokes is read at each of its calls. Programs of other files are taken to leave the robot where it
was; a note names them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass

from drivers.kuka.program_krl.data import KrlError, Statement, aggregate, closing, number, quoted
from drivers.kuka.program_krl.flow import ENDS, PARTS

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
    """Follows a program's statements in their order and knows where the robot stands."""

    def __init__(self, blocks: Mapping[str, Sequence[Statement]], moving: Set[str]) -> None:
        """Take the own subprograms by name, and those of them that move."""
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

    def stands_at(self, keys: Sequence[str]) -> None:
        """Take a motion to one of some targets, or to a place that is not known: to none."""
        self._keys, self._shift_mm = keys, (0.0, 0.0, 0.0)

    def pass_by(self, statement: Statement) -> list[Relative]:
        """Take a statement that is no motion; return the strokes of the subprogram it calls.

        Raises `KrlError` as `take` does.
        """
        if statement.head in self._drills:
            return [found for each in self._drills[statement.head] for found in self._from(each)]
        moves = any(token.word in self._moving for token in statement.tokens)
        if statement.head in BRANCHES or statement.is_label or moves:
            self.stands_at(())
        if moves and statement.is_at_any_time:
            self._interrupted = self._interrupted or statement.line
        return []

    def take(self, statement: Statement) -> list[Relative]:
        """Return the strokes that a relative motion may be; raises `KrlError`."""
        return [] if statement.line in self._read_at_calls else self._from(statement)

    def _from(self, statement: Statement) -> list[Relative]:
        """Return the strokes from where the robot stands now."""
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
        if not tokens or tokens[0].text != "{":
            raise KrlError(f"{head}: expected a relative motion by a structure of numbers")
        end = closing(tokens, 0) + 1
        fields = aggregate(tokens[:end])
        rest = tokens[end:]  # approximations may stand around its frame
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
