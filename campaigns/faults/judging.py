"""Whether a run took a fault as the catalogue wants: its end, its alarm, its journal, its result.

The letters of an end: "-" it went on, R it measured again, I it dropped a block, P it suspended, N
it finished and said that the result is not good, S safe stop, X refused, A aborted, J storage
fault, K killed, "!" anything else.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from campaigns.faults.phases import Phase
from campaigns.faults.script import Case, Ran
from campaigns.faults.table import Fault
from hilcell.ports import Array
from tests.whole.bench import judge as broken_invariants

LETTERS = {0: "-", 1: "N", 2: "X", 3: "S", 4: "A", 7: "J", -9: "K"}
WORDS = {
    "-": "went on",
    "R": "tried again, went on",
    "I": "measured a block again",
    "P": "suspended, went on",
    "N": "finished, exit 1",
    "S": "safe stop",
    "X": "refused",
    "A": "stopped",
    "J": "storage fault",
    "K": "killed",
    "!": "exit",
}
# A phase in which a device is not asked, or in which nothing works yet, allows other ends, too.
ALSO = {Phase.PAUSED: "-", Phase.RESUMING: "-XS", Phase.TEARDOWN: "A"}
# Where nothing asks the rail any more its dead wire shows at the close, which must see it at rest.
ASKED_AT_THE_CLOSE, NOT_AT_REST = (Phase.ROBOT, Phase.PAUSED, Phase.TEARDOWN), "HC-C32"
SAME_MM = 0.15  # by how much the error of a base frame may differ from that of a calm run


@dataclass(frozen=True)
class Judged:
    """The reaction in words, and all that is wrong with it."""

    reaction: str
    problems: tuple[str, ...]


def judged(fault: Fault, case: Case, ran: Ran, undisturbed: Ran) -> Judged:
    struck = ran.exits[ran.session - 1]
    letter = _letter(ran, struck)
    code = _code(ran) if letter in "SXJ" else ""
    problems = [*ran.notes]
    if not ran.struck:
        problems.append("the phase was not reached")
    if letter not in fault.ends + ALSO.get(case.phase, ""):
        problems.append(f"{WORDS[letter]}, expected one of {fault.ends}")
    codes = fault.codes or ("HC-",)
    of_abb = case.cell == "abb" and case.phase is Phase.TEARDOWN  # it must see the arm at rest, too
    if of_abb or ("HC-R" in codes and case.phase in ASKED_AT_THE_CLOSE):
        codes = (*codes, NOT_AT_REST)
    if (letter == "S" or code) and not code.startswith(codes):
        problems.append(f"alarm {code}")
    problems += broken(ran)
    problems += unlike(ran, undisturbed)
    if not case.injection.lasts and ran.exits[-1] not in (0, 1):
        problems.append(f"not resumed: exits {ran.exits}: {ran.errors[-300:]}")
    words = f"{WORDS[letter]} {code}".rstrip()
    return Judged(words, tuple(problems))


def broken(ran: Ran) -> list[str]:
    """Return what no run may do, whatever strikes it."""
    found = broken_invariants(event for event in ran.events if "seq" in event)
    if "Traceback" in ran.errors or 5 in ran.exits:
        found.append(f"internal error: {ran.errors[-400:]}")
    return found


def _letter(ran: Ran, code: int) -> str:
    letter = LETTERS.get(code, "!")
    if letter not in "-N":
        return letter
    whats = {event.get("what") for event in ran.events if event["kind"] == "event"}
    if any(event.get("to") == "suspended" for event in ran.events):
        return "P"
    if "tracker moved" in whats:
        return "I"
    return "R" if letter == "-" and "no reading" in whats else letter


def _code(ran: Ran) -> str:
    """Return the alarm's code at the end of the session that was struck.

    A session that was refused has no end in the journal: its message has the code.
    """
    ends = [event for event in ran.events if event["kind"] == "end"]
    if len(ends) >= ran.session:
        error = ends[ran.session - 1].get("error") or {}
        codes = [each["code"] for each in (*error.get("causes", ()), error) if each.get("code")]
        if codes:
            return str(codes[0])
    said = re.findall(r"HC-[A-Z]\d\d", ran.errors)
    return str(said[-1]) if said else ""


def unlike(ran: Ran, undisturbed: Ran) -> list[str]:
    """Return where a run that ended with 0 has an error that one without a fault has not."""
    if ran.exits[-1] != 0:
        return []
    wanted, found = _base(undisturbed), _base(ran)
    if wanted is None or found is None:
        return ["no base frame"]
    wanted, found = wanted - _origin(undisturbed.T_W_B), found - _origin(ran.T_W_B)
    off_mm = float(np.linalg.norm(found - wanted))
    return [] if off_mm <= SAME_MM else [f"exit 0, and the base frame is {off_mm:.3f} mm off"]


def _base(ran: Ran) -> Array | None:
    """Return the origin (3,) of the base frame that a run has found."""
    found = [event["matrix"] for event in ran.events if event.get("key") == "base"]
    return _origin(found[-1]) if found else None


def _origin(matrix: list[list[float]]) -> Array:
    return np.array(matrix, dtype=float)[:3, 3]
