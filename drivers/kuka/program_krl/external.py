"""Where the external axes stand at a program's targets, and in which posture the arm does.

A component that a motion leaves out keeps its value from the motion before, a home move or another
to joints included. An external axis, as the slide E1, must stand at one place for all targets: a
program is corrected for one station.

Only a motion by joints takes a posture: S of its point, or the joints of a home move. All others
keep the one that the arm has, whatever S their points state. The bits are those of a status in
`hilcell.geometry.inverse`; joints tell those that need no arm.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from drivers.kuka.program_krl.data import EXTERNAL
from drivers.kuka.program_krl.flow import Flow
from drivers.kuka.program_krl.program import SLIDE, Kept, Target
from drivers.kuka.program_krl.tokens import Statement
from hilcell.errors import bounded


class Stop(NamedTuple):
    """Where a motion may end: at a target, ``key``, or at joints.

    ``values`` are those it states, by component; None where they stand in no file at hand.
    ``status`` is S where a motion by joints states it.
    """

    key: str
    values: Mapping[str, float] | None
    status: int | None = None


class Held(NamedTuple):
    """An axis' value, and the line of the motion that stated it.

    None of line 0 is stated by no motion yet, None of a line is no longer known from there on.
    """

    value: float | None = None
    line: int = 0


class ExternalRule:
    """Finds the values of the external axes at each target."""

    def __init__(
        self,
        file: str,
        blocks: Mapping[str, Sequence[Statement]],
        stops: Mapping[int, Sequence[Stop]],
        targets: Mapping[str, Target],
    ) -> None:
        """Take the motions' stops by line, and the targets by key."""
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
        """Return the first target where the slide's place is known, and the place, mm.

        One that is no longer known comes first, as not a number.
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
        """Return in words which motion gave a target its value; "" where it states it itself."""
        return "" if axis in target.numbers else f" of {self._file} line {line}"


class Bits(NamedTuple):
    """The bits of a status that are ``known``; nothing else, so that few states differ."""

    known: int = 0
    status: int = 0


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
                taken = _of_joints(stop.values or {})
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


def _of_joints(values: Mapping[str, float]) -> Bits:
    """Return the bits that joints in deg tell without the arm's links."""
    a3_deg, a5_deg = ((values.get(name, 0.0) + 180.0) % 360.0 - 180.0 for name in ("A3", "A5"))
    elbow, wrist, known, status = 0b010, 0b100, 0, 0
    if abs(a3_deg) > 15.0:  # an arm is stretched at some degrees beside zero, by its links
        known, status = known | elbow, status | elbow * (a3_deg > 0)
    if abs(a5_deg) > 0.01812:  # so near to zero the next motion may take either side
        known, status = known | wrist, status | wrist * (a5_deg < 0)
    return Bits(known, status)
