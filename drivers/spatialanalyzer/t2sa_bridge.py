"""One connection to T2SA: a request and its reply, a measurement that is halted, a stop.

The trap: replies have no number, so that a late one looks like the next one's. After a measurement
without a reply the bridge must confirm a halt, and then answer a question of another kind; after
any other silence, and after a stop, the connection is not used any more.
"""

from __future__ import annotations

from collections.abc import Callable

from drivers.spatialanalyzer import t2sa
from drivers.spatialanalyzer.t2sa import Reply, T2saError
from drivers.supervision import Patience
from drivers.tracker_readings import DEVICE, no_reading
from drivers.wires.link import Link
from drivers.wires.text_lines import TextLines
from hilcell.ports import Array, Clock, DeviceError, NoReading

# Deadlines on the wire, in real time.
REPLY_S = 5.0
MEASURE_S = 30.0
BUSY_PAUSE_S = 0.2
MEASURE, POSITION = "!MEAS_SINGLE_POINT:", "?POINT_POS:"
ACT = "look at SpatialAnalyzer and the tracker, then resume"
ACTS = {
    "HC-T11": "clear the view or seat the reflector, then resume",
    "HC-T70": "start the instrument's interface in SpatialAnalyzer, then resume",
    "HC-T72": "import the list of points into the group of tracker.options, then resume",
}
AGAIN = {"HC-T11", "HC-T13", "HC-T21"}  # of one measurement, which may be tried again


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
            lines.send(t2sa.HALT, "stop")

    def close(self) -> None:
        """Close the connection; a second close does nothing."""
        self._lines = None
        self._link.close()

    def ask(self, command: str) -> Reply:
        """Request, again while the bridge is busy; raises the error of a refusal."""
        limit_s = _limit_s(command)
        patience = Patience(limit_s, limit_s)
        while (reply := self.exchange(command)).code == t2sa.BUSY:
            if patience.over():
                break
            self._clock.wait(BUSY_PAUSE_S)
        if not reply.accepted:
            raise _failed(command, reply)
        return reply

    def position(self, command: str, path: str) -> Array:
        """Return the position (3,) that a command brings for a point, given by its path.

        Values that are no numbers are NaN.
        """
        reply = self.ask(f"{command}{path}")
        try:
            return t2sa.position_of(reply, path.rpartition(";")[2])
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
        self._after(t2sa.HALT, lambda reply: reply.accepted and not reply.is_result)
        self._after(t2sa.LASER, lambda reply: reply.is_laser)

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
            return t2sa.parse(line)
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


def _failed(command: str, reply: Reply) -> DeviceError:
    """Return the error of a refused request."""
    alarm, _ = t2sa.CODES.get(reply.code, t2sa.UNKNOWN)
    kind = NoReading if command.startswith(MEASURE) and alarm in AGAIN else DeviceError
    act, fields = ACTS.get(alarm, ACT), {"status": reply.code}
    return kind(alarm, DEVICE, _spoken(command), reply.found, act=act, fields=fields)


def _spoken(command: str) -> str:
    """Return a command's name for messages."""
    return command.partition(":")[0].strip("!?").lower().replace("_", " ")
