"""The lines of T2SA, by which SpatialAnalyzer is commanded over TCP: replies, codes, positions.

Requests are ``!COMMAND:values`` or ``?QUESTION:values``; values are separated by semicolons. Every
request has one reply, ``ACK-300 text`` or ``ERR-305 text``; older versions write ``ERR-305: text``.
Replies have no number. A position stands in the text as ``result x,y,z`` or ``result:
X:x;Y:y;Z:z``, after the point's name and before a date in the PC's own format.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from hilcell.clean import clean
from hilcell.ports import Array

PORT = 50_000
HALT, STATUS, LASER, LASER_ON = "!HALT", "?STAT", "?LSTA", "!LST:1"
READY = ("Instrument is connected", "READY")
BUSY = 201
FARTHEST = 1e9  # beyond the reach of any tracker, in whichever unit
LONGEST_WORDS = 120
# Codes of the vendor's list that a measurement, or a question of one, may bring.
CODES = {
    200: ("HC-T23", "command rejected"),
    BUSY: ("HC-T21", "busy"),
    301: ("HC-T70", "laser not switched"),
    305: ("HC-T11", "measurement of the point failed"),
    306: ("HC-T72", "no such group or point"),
    323: ("HC-T70", "instrument interface not started"),
    330: ("HC-T13", "halted"),
    338: ("HC-T70", "instrument not ready"),
    340: ("HC-T11", "measurement of the group failed"),
    341: ("HC-T70", "not connected to SpatialAnalyzer"),
    346: ("HC-T72", "no such object in the job"),
    347: ("HC-T70", "no such instrument in the job"),
}
UNKNOWN = ("HC-T24", "not known")


class T2saError(Exception):
    """A line that is no reply, or a text without a position."""


@dataclass(frozen=True, slots=True)
class Reply:
    """One reply; ``code`` is that of the line, ``text`` is cleaned."""

    accepted: bool
    code: int
    text: str

    @property
    def is_result(self) -> bool:
        """Whether it answers a measurement, or a question for a position."""
        return self.accepted and re.search(r"\bresult\b", self.text) is not None

    @property
    def is_ready(self) -> bool:
        """Whether it states that nothing is under way."""
        return self.accepted and self.text.startswith(READY)

    @property
    def is_laser(self) -> bool:
        """Whether it states the laser."""
        return self.accepted and re.search(r"\b(?:LON|LOFF|LNC|WARM)\b", self.text) is not None

    @property
    def found(self) -> str:
        """Return the code with its meaning and the bridge's own words."""
        _, meaning = CODES.get(self.code, UNKNOWN)
        return f"ERR-{self.code} ({meaning}): {self.text[:LONGEST_WORDS]}"


def parse(line: str) -> Reply:
    """Return a reply; raises `T2saError`."""
    found = re.fullmatch(r"(ACK|ERR)-(\d{3}):?(?:\s+(.*))?", line.strip())
    if found is None:
        raise T2saError(f"no reply of T2SA: {clean(line[:LONGEST_WORDS])!r}")
    return Reply(found[1] == "ACK", int(found[2]), clean(found[3] or ""))


def position_of(reply: Reply, point: str) -> Array:
    """Return the position (3,) in a reply; values that are no numbers or out of reach are NaN.

    Raises `T2saError` where it has none, or is of another point.
    """
    axes = r"\bresult:?\s+X:([^;]*);\s*Y:([^;]*);\s*Z:([^;]*)(?:;|$)"
    commas = r"\bresult:?\s+([^,;\s]+),([^,;\s]+),([^,;\s]+)(?:\s|$)"
    found = re.search(axes, reply.text) or re.search(commas, reply.text)
    if found is None:
        raise T2saError(f"no position x,y,z with decimal points: {reply.text[:LONGEST_WORDS]!r}")
    if point not in re.split(r"[\s;]+", reply.text[: found.start()]):
        raise T2saError(f"the answer is not of point {point}: {reply.text[:LONGEST_WORDS]!r}")
    return np.array([_number(each.strip()) for each in found.groups()])


def _number(text: str) -> float:
    form = r"[-+]?\d{1,9}(?:\.\d{0,30})?(?:[eE][-+]?\d{1,3})?"
    value = float(text) if re.fullmatch(form, text) else math.nan
    return value if abs(value) < FARTHEST else math.nan


def other_form(xyz_mm: Array, named_mm: Array, near_mm: Array, limit_mm: float) -> str:
    """Return the form in which a result is right, "" where it is wrong in each.

    ``named_mm`` (3,) is the named point through which it was measured, ``near_mm`` the place.
    """
    forms = {
        "in inches": 25.4 * xyz_mm,
        "in metres": 1000.0 * xyz_mm,
        "as a deviation from the named point": named_mm + xyz_mm,
    }
    for form, at_mm in forms.items():
        if float(np.linalg.norm(at_mm - near_mm)) <= limit_mm:
            return form
    return ""
