"""SpatialAnalyzer's bridge T2SA, and a tracker of API's kind behind it, as requests meet them.

Points are known by collection, group and name. For a measurement the tracker turns to a point's
nominal position, looks for the reflector nearest to that direction, locks on it and measures; the
nominal point stays what it was. The laser is off at first, and warms up before it is of use.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from enum import IntEnum

import numpy as np

from fakes.faults import Faults, Vanished
from fakes.time import PlantTime
from fakes.truth.tracker_truth import Instrument
from fakes.truth.transforms import Array

WARM_UP_S = 20.0


class Refusal(IntEnum):
    """Codes of refused requests."""

    REJECTED = 200
    BUSY = 201
    NOT_MEASURED = 305
    NO_POINT = 306
    NO_PROFILE = 307
    NO_FRAME = 314
    HALTED = 330
    NOT_SIMULATING = 337
    NOT_READY = 338


WORDS: dict[int, str] = {
    Refusal.REJECTED: "Command rejected.",
    Refusal.BUSY: "Command rejected. SA is busy.",
    Refusal.NOT_MEASURED: "Measurement of point failed.",
    Refusal.NO_POINT: "Did not find or set point group and target name.",
    Refusal.NO_PROFILE: "Requested measurement profile does not exist.",
    Refusal.NO_FRAME: "Working frame not set, not found.",
    Refusal.HALTED: "Measurement halted.",
    Refusal.NOT_SIMULATING: "Failed to set simulation mode.",
    Refusal.NOT_READY: "Instrument is not ready.",
}
SETTINGS = ("!SET_STATION_LOCK", "SET_NUM_SAMPLES", "SET_NUM_ITERATIONS", "SET_RANDOMIZE_POINTS")


@dataclass(frozen=True, slots=True)
class Answer:
    """A reply, perhaps after plant time has passed."""

    line: str = "ACK-300 READY"
    after_s: float = 0.0
    finish: Callable[[], Answer] | None = None
    measured: bool = False


def refusal(code: int) -> Answer:
    """Return an answer with an error."""
    return Answer(f"ERR-{code} {WORDS.get(code, 'Failed.')}")


class T2saDevice:
    """One bridge with one instrument; ``handle`` takes one request after another."""

    DAWN = datetime(2026, 1, 5, 8, 0, tzinfo=UTC)
    POINT_S, SEARCH_S, READ_S = 0.3, 0.8, 0.5
    SEARCH_MM, BEAM_MM = 150.0, 8.0  # beside the aim: with the camera's help, and without

    def __init__(
        self,
        instrument: Instrument,
        faults: Faults,
        time: PlantTime,
        points: Mapping[str, Array],
        group: str,
    ) -> None:
        """``group`` is COLLECTION;GROUP of the ``points`` (3,) by name."""
        self._instrument, self._faults, self._time = instrument, faults, time
        self._points, self._group = points, group
        self._warm_s: float | None = None
        self._window_mm = self.SEARCH_MM
        self._former_mm: Array | None = None
        handlers: dict[str, Callable[[str], Answer]] = {
            "!LST": self._switch,
            "!MEAS_SINGLE_POINT": self._measure,
            "!SET_SIM": self._simulate,
            "!SET_WORKING_FRAME": lambda name: (
                refusal(Refusal.NO_FRAME) if name else refusal(Refusal.REJECTED)
            ),
            "!SINGLE_POINT_MEAS_PROFILE": self._choose_profile,
            "?LSTA": lambda _: Answer(f"ACK-300 {self._laser()}"),
            "?POINT_POS": self._position,
            "?STAT": lambda _: Answer("ACK-300 Instrument is connected (simulated)"),
            "SET_POWER_LOCK": self._set_power_lock,
        }
        self._handlers = handlers | dict.fromkeys(SETTINGS, lambda _: Answer())

    def handle(self, line: str) -> Answer:
        """Return the answer to a request."""
        name, _, values = line.partition(":")
        handler = self._handlers.get(name)
        return refusal(Refusal.REJECTED) if handler is None else handler(values)

    # -- settings -------------------------------------------------------------------------------

    def _switch(self, value: str) -> Answer:
        if value not in ("0", "1"):
            return refusal(Refusal.REJECTED)
        on = value == "1"
        if not on:
            self._warm_s = None
        elif self._warm_s is None:
            self._warm_s = self._time.now_s() + WARM_UP_S
        return Answer(f"ACK-300 Tracker Interface {'Started' if on else 'Stopped'}: True")

    def _laser(self) -> str:
        if self._warm_s is None:
            return "LOFF"
        left_s = self._warm_s - self._time.now_s()
        return f"WARM, {left_s:.2f} seconds" if left_s > 0 else "LON"

    def _simulate(self, value: str) -> Answer:
        if value != "0" or self._faults.take("tracker.t2sa_simulation") is not None:
            return refusal(Refusal.NOT_SIMULATING)
        return Answer("ACK-300 Set 0")

    def _choose_profile(self, name: str) -> Answer:
        profiles = ("Single Pt. To SA", "Standard Pt. To SA")
        if name not in profiles:
            return refusal(Refusal.NO_PROFILE)
        return Answer(f"ACK-300 Single Point Measurement Profile set to {name}")

    def _set_power_lock(self, value: str) -> Answer:
        if value not in ("0", "1"):
            return refusal(Refusal.REJECTED)
        self._window_mm = self.SEARCH_MM if value == "1" else self.BEAM_MM
        return Answer()

    # -- points ---------------------------------------------------------------------------------

    def _named(self, path: str) -> Array | None:
        group, _, name = path.rpartition(";")
        if group != self._group or self._faults.take("tracker.t2sa_renamed") is not None:
            return None
        return self._points.get(name)

    def _position(self, path: str) -> Answer:
        at_mm = self._named(path)
        if at_mm is None:
            return refusal(Refusal.NO_POINT)
        return Answer(self._result(path, self._in_units(at_mm)))

    def _measure(self, path: str) -> Answer:
        take = self._faults.take
        if take("tracker.vanish") is not None:
            raise Vanished
        if take("tracker.busy") is not None:
            return refusal(Refusal.BUSY)
        code = self._faults.number("tracker.t2sa_code")
        if code is not None:
            return refusal(int(code))
        if self._laser() != "LON" or take("tracker.not_warmed_up") is not None:
            return refusal(Refusal.NOT_READY)
        aim_mm = self._named(path)
        if aim_mm is None:
            return refusal(Refusal.NO_POINT)
        off_mm, name = self._seen(aim_mm)
        search_s = self.SEARCH_S * min(off_mm, self._window_mm) / self.SEARCH_MM

        def finish() -> Answer:
            return self._measured(path, aim_mm, name)

        return Answer(after_s=self.POINT_S + search_s + self.READ_S, finish=finish)

    def _seen(self, aim_mm: Array) -> tuple[float, str | None]:
        """Return how far beside the aim a reflector is, at its own range, and its name."""
        along = aim_mm / np.linalg.norm(aim_mm)
        inside: list[tuple[float, float, Array]] = []
        for at_mm in self._instrument.reflectors().values():
            range_mm = float(np.linalg.norm(at_mm))
            angle = math.acos(min(1.0, max(-1.0, float(at_mm @ along) / range_mm)))
            if range_mm * math.sin(angle) <= self._window_mm and angle < math.pi / 2:
                inside.append((angle, range_mm * math.sin(angle), at_mm))
        if not inside:
            return self._window_mm, None
        _, off_mm, at_mm = min(inside, key=lambda each: each[0])
        return off_mm, self._instrument.find(at_mm, 1e-3)

    def _measured(self, path: str, aim_mm: Array, name: str | None) -> Answer:
        take = self._faults.take
        lost = ("tracker.no_reflector", "tracker.beam_break_before", "tracker.beam_break_after")
        if any(take(fault) is not None for fault in lost):
            return refusal(Refusal.NOT_MEASURED)
        found = None if name is None else self._instrument.measure(name)
        if found is None:
            return refusal(Refusal.NOT_MEASURED)
        xyz_mm = found.xyz_mm
        if self._former_mm is not None and take("tracker.t2sa_old_result") is not None:
            xyz_mm = self._former_mm
        self._former_mm = xyz_mm
        if take("tracker.t2sa_nominal") is not None:
            xyz_mm = aim_mm
        text = take("tracker.bad_number")
        line = self._result(path, self._in_units(xyz_mm), "" if text is None else str(text))
        return Answer(line, measured=True)

    def _in_units(self, xyz_mm: Array) -> Array:
        inches = self._faults.take("tracker.t2sa_inches") is not None
        mm_per_inch = 25.4
        return xyz_mm / mm_per_inch if inches else xyz_mm

    def _result(self, path: str, xyz: Array, x: str = "") -> str:
        """Return the line of a position; its date is in the PC's own format."""
        values = [f"{each:.6f}" for each in xyz]
        values[0] = x or values[0]
        when = self.DAWN + timedelta(seconds=self._time.now_s())
        date = when.strftime("%m/%d/%Y %I:%M:%S %p")
        return f"ACK-300 Single Point Measurement {path} result {','.join(values)} {date}"
