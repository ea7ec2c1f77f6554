"""The invariants in words, and for each how often it was judged and where it is broken."""

from __future__ import annotations

from dataclasses import dataclass, field

from hilcell.journal.journal import Record

INVARIANTS = {
    "I1": "the slide gets power only with the robot at rest at its safe pose, by a young reading",
    "I2": "the robot moves only with the slide at rest, held, and the strip at the station",
    "I3": "nothing is measured while slide or robot moves or settles",
    "I4": "a measurement is newer than the motion before it, and carries what it was made with",
    "I5": "nothing moves while the run waits or has ended",
    "I6": "the first reason of a fault is kept",
    "I7": "the devices are closed once, in bounded time",
    "I8": "no acknowledged point is lost, none is counted twice",
    "I9": "a resumed run repeats nothing acknowledged, and verifies station and tracker first",
    "I10": "a frame or a result uses only valid points of known set-ups of the tracker",
    "I11": "motions are ordered by the engine that holds the run",
    "I12": "every end leaves slide and robot held",
    "I13": "a lost screen never makes a run go on",
    "I14": "no reading beyond its greatest age is used",
    "I15": "{W} is framed at one set-up, and proven at the tracker's uncertainty",
    "I16": "the tracker is proven at each step's end, and before anything follows a pause",
    "I17": "what did not hold is not passed on as if it did",
    "I18": "who answers after a resume answered before, or it was accepted",
}


@dataclass(frozen=True, slots=True)
class Break:
    """A place where an invariant is broken."""

    seq: int
    what: str


@dataclass(slots=True)
class Proof:
    """``unproven`` are places where the journal says that a device could not tell."""

    checked: int = 0
    broken: list[Break] = field(default_factory=list)
    unproven: list[Break] = field(default_factory=list)

    @property
    def holds(self) -> bool:
        """Whether it is broken nowhere."""
        return not self.broken


class Tally:
    """The verdicts of all invariants, by name."""

    def __init__(self) -> None:
        self.verdicts = {name: Proof() for name in INVARIANTS}

    def check(self, invariant: str, record: Record, holds: bool, what: str) -> None:
        """Count one check; ``what`` says what is wrong where it does not hold."""
        verdict = self.verdicts[invariant]
        verdict.checked += 1
        if not holds:
            verdict.broken.append(Break(record.seq, what))

    def unproven(self, invariant: str, record: Record, what: str) -> None:
        """Note a place that cannot be judged."""
        self.verdicts[invariant].unproven.append(Break(record.seq, what))
