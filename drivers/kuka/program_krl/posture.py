"""The arm's posture at a program's targets, by the motion before where they do not state it.

Only a motion by joints takes a posture: S of its point, or the joints of a home move. All others
keep the one that the arm has, whatever S their points state. The bits are those of a status in
`hilcell.geometry.inverse`; joints tell those that need no arm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from drivers.kuka.program_krl.external import Stop
from drivers.kuka.program_krl.flow import Flow
from drivers.kuka.program_krl.program import Kept, Target
from drivers.kuka.program_krl.tokens import Statement

ALL, ELBOW, WRIST = 0b111, 0b010, 0b100
SINGULAR_DEG = 0.01812  # of A5: so near to zero the next motion may take either side
STRETCHED_DEG = 15.0  # of A3: an arm is stretched at some degrees beside zero, by its links


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
                taken = Bits(ALL, stop.status & ALL)
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
    a3_deg, a5_deg = (_wrapped(values.get(name, 0.0)) for name in ("A3", "A5"))
    known = status = 0
    if abs(a3_deg) > STRETCHED_DEG:
        known, status = known | ELBOW, status | ELBOW * (a3_deg > 0)
    if abs(a5_deg) > SINGULAR_DEG:
        known, status = known | WRIST, status | WRIST * (a5_deg < 0)
    return Bits(known, status)


def _wrapped(angle_deg: float) -> float:
    return (angle_deg + 180.0) % 360.0 - 180.0
