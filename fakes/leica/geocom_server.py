"""A robotic total station behind GeoCOM, on TCP or a pseudo terminal.

As in the original, lengths are metres and angles radians, Hz is clockwise and V zero at the zenith;
few decimals are sent by default; a measured distance remains until it is cleared, so a new angle
may come with an old distance. Empty lines end half a request and are not answered; ``c`` ends a
motion and is answered by ``?``. Requests are executed in sequence. A serial line has no connection:
the next program receives an answer for which the previous one did not wait.
"""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Callable
from enum import IntEnum
from functools import partial
from itertools import count
from typing import NamedTuple

import numpy as np

from fakes.faults import Vanished
from fakes.site import Site
from fakes.truth.transforms import Array
from fakes.wires import Connection, LineSession, Listener, SerialLine, Server, Wire


class Code(IntEnum):
    """Return codes."""

    OK = 0
    INVALID = 2
    NOT_IMPLEMENTED = 5
    ABORTED = 8
    BUSY = 13
    INACCURATE = 1284
    ANGLES_ONLY = 1285
    DISTANCE_ERROR = 1292
    NO_TARGET = 8710
    SEVERAL = 8711
    ATR_OFF = 8714


class Answer(NamedTuple):
    """A return code with its values."""

    code: int = Code.OK
    values: tuple[str, ...] = ()


class Aborted(Exception):
    """The client aborted the request in progress."""


class GeocomDevice:
    """One instrument; ``handle`` executes one request after another.

    Time passes in ``wait``, which raises `Aborted` if the client aborts.
    """

    SERIAL = 884321
    TURN_S, AIM_S, DISTANCE_S, ANGLE_S = 0.6, 0.4, 1.5, 0.1
    LOOK_S = 1.0  # for a target, by a telescope that a person turns

    def __init__(self, site: Site) -> None:
        """The true prism constant is the cell file's."""
        self._instrument, self._faults = site.truth.tracker, site.faults
        self._truth, self._loose = site.truth, False  # loose: a person may turn the telescope
        self._true_prism_m = float(site.cell.tracker.options.get("prism_constant_mm", 0.0)) / 1000.0
        self._places_cache, self._prism_m = 4, 0.0
        self._atmosphere: tuple[float, ...] = (658e-9, 1013.25, 12.0, 12.0)
        self._corrections: tuple[float, ...] = (1, 1, 1, 1)  # the instrument has no such errors
        self._edm_mode, self._tilt, self._atr, self._face = 3, 1, 0, 0
        self._pointing = (0.0, math.pi / 2)  # Hz, V in face 1
        self._measured: tuple[float, float, float] | None = None  # Hz, V, distance
        self._started = False
        self._target: str | None = None
        self._time_ms = count(100, 100).__next__
        self._wait: Callable[[float], None] = lambda _duration_s: None
        strikes = site.faults.strikes
        self._handlers: dict[int, tuple[int, Callable[..., Answer]]] = {
            0: (0, Answer),
            107: (1, self._setter("_places_cache", lambda places: 0 <= places <= 15)),
            108: (0, lambda: Answer(values=(str(self._places_cache),))),
            110: (0, lambda: _whole(3, 0, 0)),
            2003: (1, lambda mode: self._angles()),
            2006: (1, self._setter("_tilt", lambda on: on in (0, 1))),
            2007: (0, lambda: _whole(self._tilt)),
            2008: (2, self._start),
            2014: (0, lambda: _whole(*map(int, self._corrections))),
            2016: (4, self._set_corrections),
            2020: (1, self._setter("_edm_mode", lambda mode: 0 <= mode <= 14)),
            2021: (0, lambda: _whole(self._edm_mode)),
            2023: (0, lambda: self._reals(self._prism_m)),
            2024: (1, partial(self._set, "_prism_m")),
            2026: (0, lambda: _whole(self._face)),
            2028: (4, self._set_atmosphere),
            2029: (0, lambda: self._reals(*self._atmosphere)),
            2082: (2, lambda wait_ms, mode: self._measurement(wait_ms, self._coordinates)),
            2108: (2, lambda wait_ms, mode: self._measurement(wait_ms, self._polar)),
            5003: (0, lambda: _whole(self.SERIAL + strikes("tracker.wrong_identity"))),
            5004: (0, lambda: Answer(values=('"TS60 (simulated)"',))),
            5034: (0, lambda: _whole(8, 50, 0)),
            5035: (0, lambda: _whole(300, 0x04 | 0x08 | 0x10)),  # 0.5", motors, ATR, guide light
            6002: (1, lambda mode: self._release()),
            9027: (5, lambda hz, v, exact, aim, dummy: self._point(hz, v, aim)),
            9028: (3, lambda exact, aim, dummy: self._change_face()),
            9029: (3, lambda hz, v, dummy: self._aim(hz, v)),
            9037: (3, lambda hz, v, dummy: self._aim(hz, v)),
            18005: (1, self._setter("_atr", lambda on: on in (0, 1))),
            18006: (0, lambda: _whole(self._atr)),
        }

    def knows(self, rpc: int) -> bool:
        return rpc in self._handlers

    def handle(self, rpc: int, parameters: list[float], wait: Callable[[float], None]) -> Answer:
        if not self.knows(rpc):
            return Answer(Code.NOT_IMPLEMENTED)
        expected, handler = self._handlers[rpc]
        if len(parameters) != expected or not all(map(math.isfinite, parameters)):
            return Answer(Code.INVALID)
        self._wait = wait
        return handler(*parameters)

    def abort(self) -> None:
        self._started = False

    # -- settings -------------------------------------------------------------------------------

    def _setter(self, name: str, allowed: Callable[[float], bool]) -> Callable[[float], Answer]:
        def handler(value: float) -> Answer:
            if value != int(value) or not allowed(value):
                return Answer(Code.INVALID)
            return self._set(name, int(value))

        return handler

    def _set(self, name: str, value: object) -> Answer:
        setattr(self, name, value)
        return Answer()

    def _set_corrections(self, *on: float) -> Answer:
        return self._set("_corrections", on) if set(on) <= {0, 1} else Answer(Code.INVALID)

    def _set_atmosphere(self, *values: float) -> Answer:
        sound = 500 <= values[1] <= 1200
        return self._set("_atmosphere", values) if sound else Answer(Code.INVALID)

    # -- turning and aiming -----------------------------------------------------------------------

    def _point(self, hz: float, v: float, aim: float) -> Answer:
        if not 0 <= v <= math.tau:
            return Answer(Code.INVALID)
        self._loose = False
        self._truth.keep_beam()
        self._face = int(v > math.pi)
        self._pointing = (hz % math.tau, v) if not self._face else self._other_face(hz, v)
        self._target = None

        self._wait(self.TURN_S)
        sight_rad = 1e-3  # off the line of sight, within which the distance meter hits a prism
        return self._aim(2 * sight_rad, 2 * sight_rad) if aim else Answer()

    def _release(self) -> Answer:
        self._loose, self._target = True, None
        self._truth.release_beam()
        return Answer()

    def _catch(self) -> None:
        """Look where a person has turned the telescope meanwhile."""
        nest = self._truth.aimed_at() if self._loose else None
        at_mm = None if nest is None else self._instrument.reflector(nest)
        if at_mm is not None:
            self._loose, self._pointing = False, _direction(at_mm)

    def _change_face(self) -> Answer:
        self._face = 1 - self._face
        self._wait(2 * self.TURN_S)
        return Answer()

    def _aim(self, width: float, height: float) -> Answer:
        if not self._atr:
            return Answer(Code.ATR_OFF)
        self._wait(self.LOOK_S if self._loose else self.AIM_S)
        self._catch()
        self._target = None
        if self._loose:  # on its way between two targets
            return Answer(Code.NO_TARGET)
        hz, v = self._pointing
        inside = []
        for at_mm in self._instrument.reflectors().values():
            at_hz, at_v = _direction(at_mm)
            off_hz = abs(((at_hz - hz) + math.pi) % math.tau - math.pi) * math.sin(v)
            off_v = abs(at_v - v)
            if off_hz <= width / 2 and off_v <= height / 2:
                inside.append((math.hypot(off_hz, off_v), at_mm))
        inside.sort(key=lambda each: each[0])
        strikes = self._faults.strikes
        if not inside or strikes("tracker.no_reflector"):
            return Answer(Code.NO_TARGET)
        apart_rad = 1e-3  # closer targets are not separated
        if len(inside) > 1:
            (_, one_mm), (_, other_mm) = inside[:2]
            cosine = one_mm @ other_mm / (np.linalg.norm(one_mm) * np.linalg.norm(other_mm))
            if math.acos(min(1.0, float(cosine))) < apart_rad:
                return Answer(Code.SEVERAL)
        name = self._instrument.find(inside[0][1], 1e-3)
        if name is None:
            return Answer(Code.NO_TARGET)
        self._target = name
        self._pointing = _direction(self._instrument.reflectors()[name])
        return Answer()

    # -- measuring ------------------------------------------------------------------------------

    def _start(self, command: float, mode: float) -> Answer:
        stop, distance, clear = 0, 1, 3
        if command == clear:
            self._measured, self._started = None, False
            return Answer()
        if command == stop:
            self._started = False
            return Answer()
        if command != distance:
            return Answer(Code.NOT_IMPLEMENTED)
        if self._faults.strikes("tracker.vanish"):
            raise Vanished
        if self._faults.strikes("tracker.busy"):
            return Answer(Code.BUSY)
        self._started = True
        return Answer()

    def _measurement(self, wait_ms: float, form: Callable[..., Answer]) -> Answer:
        """Return the started or last distance, or angles alone, after up to ``wait_ms``."""
        strikes = self._faults.strikes
        if not self._started and self._measured is not None:
            return form(*self._measured)
        if not self._started or wait_ms / 1000 < self.DISTANCE_S:
            self._wait(wait_ms / 1000)
            return form(*self._pointing, 0.0)
        self._wait(self.DISTANCE_S)
        self._started = False
        if strikes("tracker.no_distance"):
            return form(*self._pointing, 0.0)
        broken = ("tracker.beam_break_before", "tracker.beam_break_after")
        if any(strikes(fault) for fault in broken):
            return Answer(Code.DISTANCE_ERROR)
        found = None if self._target is None else self._instrument.measure(self._target)
        if found is None:
            return form(*self._pointing, 0.0)
        hz, v = _direction(found.xyz_mm)
        mm = 1000.0
        distance_m = float(np.linalg.norm(found.xyz_mm)) / mm
        distance_m += self._prism_m - self._true_prism_m
        (_, pressure_mbar, dry_c, _), air = self._atmosphere, self._instrument.air()
        true_ppm = self._ppm(air.pressure_mbar, air.temperature_c)
        distance_m *= 1.0 + 1e-6 * (self._ppm(pressure_mbar, dry_c) - true_ppm)
        self._measured = (hz, v, distance_m)
        code = self._faults.number("tracker.geocom_code")
        answer = form(*self._measured)
        if code is None:
            return answer
        return Answer(int(code), answer.values if code in (1283, Code.INACCURATE) else ())

    def _polar(self, hz: float, v: float, distance_m: float) -> Answer:
        if self._face:
            hz, v = self._other_face(hz, v)
        values = self._reals(hz, v, distance_m).values
        bad = self._faults.take("tracker.bad_number")
        if bad is not None:
            values = (str(bad), *values[1:])
        return Answer(Code.OK if distance_m else Code.ANGLES_ONLY, values)

    def _coordinates(self, hz: float, v: float, distance_m: float) -> Answer:
        """East, north, height and time, twice: of the last and of the present reading."""
        across_m = distance_m * math.sin(v)
        east, north = across_m * math.sin(hz), across_m * math.cos(hz)
        each = (*self._reals(east, north, distance_m * math.cos(v)).values, str(self._time_ms()))
        return Answer(Code.OK if distance_m else Code.ANGLES_ONLY, (*each, *each))

    def _angles(self) -> Answer:
        self._catch()
        hz, v = self._pointing
        if self._face:
            hz, v = self._other_face(hz, v)
        time = str(self._time_ms())
        tilt = self._reals(0.0, 0.0, 0.0).values
        values = (*self._reals(hz, v, 0.0).values, time, *tilt, time, str(self._face))
        self._wait(self.ANGLE_S)
        return Answer(values=values)

    def _reals(self, *values: float) -> Answer:
        return Answer(values=tuple(f"{value:.{self._places_cache}f}" for value in values))

    @staticmethod
    def _other_face(hz: float, v: float) -> tuple[float, float]:
        return (hz + math.pi) % math.tau, math.tau - v

    @staticmethod
    def _ppm(pressure_mbar: float, dry_c: float) -> float:
        """Return the atmospheric correction of dry air, about 0 at 12 C and 1013.25 mbar."""
        return 281.8 - 0.29065 * pressure_mbar / (1.0 + 0.00366 * dry_c)


def _whole(*values: int) -> Answer:
    return Answer(values=tuple(map(str, values)))


def _direction(at_mm: Array) -> tuple[float, float]:
    """Return Hz and V of a position in face 1: Hz from x to -y."""
    x, y, z = at_mm
    return math.atan2(-y, x) % math.tau, math.acos(z / math.hypot(x, y, z))


class GeocomServer(Server):
    """Serves one instrument on a port (0: a free one), or on a serial line."""

    NOT_DECODED, UNAVAILABLE = 3080, 3081  # communication codes: no request, no such procedure
    REQUEST = re.compile(rb"%R1Q,(\d{1,6})(?:,(\d{1,9}))?:(.*)")

    def __init__(self, site: Site, port: int = 0) -> None:
        """On a serial line where the cell file names one."""
        self.device, self._faults, self._time = GeocomDevice(site), site.faults, site.time
        self._requests = threading.Lock()
        channel = str(site.cell.tracker.options.get("channel", ""))
        line = (
            SerialLine("geocom line", self._serve)
            if channel and "://" not in channel
            else Listener("geocom", lambda client: self._serve(Connection(client)), port=port)
        )
        super().__init__({"channel": line.channel}, line)

    def _serve(self, wire: Wire) -> None:
        session = _Session(wire)
        while True:
            line = session.line(None)
            if line is None:
                continue
            if line == b"c":
                self._abort(session)
            elif (found := self.REQUEST.fullmatch(line)) is None:
                session.say(encoded(self.NOT_DECODED, 0, Answer()))
            else:
                rpc, transaction = int(found[1]), int(found[2] or 0)
                with self._requests:
                    answer = self._answer(session, rpc, found[3])
                self._reply(session, rpc, transaction, answer)

    def _answer(self, session: _Session, rpc: int, text: bytes) -> Answer:
        try:
            parameters = [float(each) for each in text.split(b",")] if text else []
        except ValueError:
            return Answer(Code.INVALID)
        try:
            return self.device.handle(rpc, parameters, partial(self._let_pass, session))
        except Aborted:
            self._abort(session)
            return Answer(Code.ABORTED)

    def _let_pass(self, session: _Session, duration_s: float) -> None:
        """Let cell time pass; raises `Aborted`."""
        for left_s in self._time.passing(duration_s):
            if session.aborted(left_s):
                raise Aborted

    def _abort(self, session: _Session) -> None:
        self.device.abort()
        session.say(b"?")

    def _reply(self, session: _Session, rpc: int, transaction: int, answer: Answer) -> None:
        results = (2082, 2108)
        if rpc not in results:
            known = self.device.knows(rpc)
            session.say(encoded(0 if known else self.UNAVAILABLE, transaction, answer))
            return
        strikes = self._faults.strikes
        if strikes("tracker.eof"):
            raise ConnectionAbortedError
        if strikes("tracker.no_result"):
            return
        if strikes("tracker.geocom_noise"):
            session.say(b"\xfe\x80\xf8\x06")
        transaction += strikes("tracker.geocom_number")
        session.answer(encoded(0, transaction, answer), self._faults)


def encoded(communication: int, transaction: int, answer: Answer) -> bytes:
    """Return a reply without its line's end."""
    values = "".join(f",{value}" for value in answer.values)
    return f"%R1P,{communication},{transaction}:{answer.code}{values}".encode("ascii")


class _Session(LineSession):
    """A client that may abort the request in progress."""

    def aborted(self, timeout_s: float) -> bool:
        """Whether the client aborts the request in progress; other requests are queued."""
        if b"c" not in self.lines:
            self.receive(timeout_s)
        if b"c" not in self.lines:
            return False
        self.lines.clear()
        return True


serve = GeocomServer
