"""T2SA, the bridge by which SpatialAnalyzer is commanded over TCP: its lines, and a connection.

Requests are ``!COMMAND:values`` or ``?QUESTION:values``; values are separated by semicolons. Every
request has one reply, ``ACK-300 text`` or ``ERR-305 text``; older versions write ``ERR-305: text``.
A position stands in the text as ``result x,y,z`` or ``result: X:x;Y:y;Z:z``, after the point's
name and before a date in the PC's own format.

The trap: replies have no number, so that a late one looks like the next one's. After a measurement
without a reply the bridge must confirm a halt, and then answer a question of another kind; after
any other silence, and after a stop, the connection is not used any more.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.supervision import Patience
from drivers.tracker_readings import DEVICE, no_reading
from drivers.wires.link import Link
from drivers.wires.text_lines import TextLines
from hilcell.clean import clean
from hilcell.ports import Array, Clock, DeviceError, NoReading

PORT = 50_000
# Deadlines on the wire, in real time.
REPLY_S = 5.0
MEASURE_S = 30.0
BUSY_PAUSE_S = 0.2
HALT, STATUS, LASER, LASER_ON = "!HALT", "?STAT", "?LSTA", "!LST:1"
MEASURE, POSITION = "!MEAS_SINGLE_POINT:", "?POINT_POS:"
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
AGAIN = {"HC-T11", "HC-T13", "HC-T21"}  # of one measurement, which may be tried again
ACT = "look at SpatialAnalyzer and the tracker, then resume"
ACTS = {
    "HC-T11": "clear the view or seat the reflector, then resume",
    "HC-T70": "start the instrument's interface in SpatialAnalyzer, then resume",
    "HC-T72": "import the list of points into the group of tracker.options, then resume",
}


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


class T2saBridge:
    """An open connection. One thread asks; ``stop`` may come from any thread."""

    def __init__(self, link: Link, clock: Clock) -> None:
        self._clock = clock
        # A date in the PC's own format may hold letters of any alphabet.
        self._lines: TextLines | None = TextLines(link, letters=True)
        self._link, self.address = link, link.address
        self._stopped = False
        self.arrived_s = 0.0

    def stop(self) -> None:
        """Halt the measurement under way, without waiting for an answer."""
        lines, self._stopped = self._lines, True
        if lines is not None:
            lines.send(HALT, "stop")

    def close(self) -> None:
        """Close the connection; a second close does nothing."""
        self._lines = None
        self._link.close()

    def ask(self, command: str) -> Reply:
        """Request, again while the bridge is busy; raises the error of a refusal."""
        limit_s = _limit_s(command)
        patience = Patience(limit_s, limit_s)
        while (reply := self.exchange(command)).code == BUSY:
            if patience.over():
                break
            self._clock.wait(BUSY_PAUSE_S)
        if not reply.accepted:
            alarm, _ = CODES.get(reply.code, UNKNOWN)
            kind = NoReading if command.startswith(MEASURE) and alarm in AGAIN else DeviceError
            act, fields = ACTS.get(alarm, ACT), {"status": reply.code}
            raise kind(alarm, DEVICE, _spoken(command), reply.found, act=act, fields=fields)
        return reply

    def position(self, command: str, path: str) -> Array:
        """Return the position (3,) that a command brings for a point, given by its path.

        Values that are no numbers are NaN.
        """
        reply = self.ask(f"{command}{path}")
        try:
            return position_of(reply, path.rpartition(";")[2])
        except T2saError as error:
            raise self.lost(str(error), "decode") from error

    def exchange(self, command: str) -> Reply:
        """Request once and return the reply; results that nobody asked for are dropped."""
        limit_s = _limit_s(command)
        self._wire().send(command, _spoken(command))
        patience = Patience(limit_s)
        while (reply := self._reply(patience)) is not None:
            if command.startswith((MEASURE, POSITION)) or not reply.is_result:
                return reply
        if not command.startswith(MEASURE):
            raise self.lost("no answer in time", _spoken(command))
        self._give_up()
        found = f"no answer to {_spoken(command)} in {limit_s:.1f} s"
        raise no_reading("HC-T13", found, act=ACT, waited_s=limit_s)

    def lost(self, found: str, operation: str) -> DeviceError:
        """Return the error after which the replies cannot be trusted; the connection is closed."""
        self.close()
        return self._link.broken(operation, found)

    def _give_up(self) -> None:
        """Halt a measurement that brought no reply, and make sure that none is to come."""
        self._after(HALT, lambda reply: reply.accepted and not reply.is_result)
        self._after(LASER, lambda reply: reply.is_laser)

    def _after(self, command: str, answers: Callable[[Reply], bool]) -> None:
        """Request, and drop all replies up to the one that answers."""
        self._wire().send(command, _spoken(command))
        patience = Patience(REPLY_S)
        while (reply := self._reply(patience)) is not None:
            if answers(reply):
                return
        raise self.lost("no answer in time", _spoken(command))

    def _reply(self, patience: Patience) -> Reply | None:
        """Return the next reply, None when ``patience`` is over; a line that failed is closed."""
        try:
            line = self._wire().receive(patience)
        except DeviceError:
            self.close()
            raise
        self._clock.check()  # the answer to a stop is none to a request
        if line is None:
            return None
        self.arrived_s = self._clock.pc_s()
        try:
            return parse(line)
        except T2saError as error:
            raise self.lost(str(error), "receive") from error

    def _wire(self) -> TextLines:
        if self._lines is None or self._stopped:
            self._clock.check()
            found = "not connected" if self._lines is None else "stopped"
            raise DeviceError("HC-T34", DEVICE, "use", found, act="connect first")
        return self._lines


def _limit_s(command: str) -> float:
    return MEASURE_S if command.startswith(MEASURE) else REPLY_S


def _spoken(command: str) -> str:
    """Return a command's name for messages."""
    return command.partition(":")[0].strip("!?").lower().replace("_", " ")
