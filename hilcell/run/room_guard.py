"""A room that has become too warm or too cold suspends a run, and lets it go on when it is back.

Level, not edge: each point's own temperature is judged before the next is measured, on resume too.
While the run is suspended the tracker looks at a floor nest for its weather station alone.
"""

from __future__ import annotations

import numpy as np

from hilcell.calibration.causes import Cause, Suspicion
from hilcell.calibration.diagnosis import NOTICED_BY, reference_c
from hilcell.journal.log import Point
from hilcell.ports import Array, DeviceError, NoReading
from hilcell.run.measuring import Ask
from hilcell.run.prompts import Look, Prompt
from hilcell.run.remeasure import retake_refusal
from hilcell.run.run_context import RunContext

ROOM_BACK = "room back"  # event
PLACE = "the room"


class RoomGuard:
    """Used before each point; ``ask`` suspends the run until a look is good."""

    def __init__(self, run: RunContext, ask: Ask) -> None:
        self._run, self._ask = run, ask
        self._judged: Point | None = None
        self._within_s: float | None = None  # since when, cell time

    def check(self) -> None:
        """Suspend the run where its newest point was measured beyond the room's range.

        That point waits to be re-measured, where it may be. Where the reflector is carried by hand
        there is none to look at, and somebody who feels the room.
        """
        point, table = self._run.last, self._run.cell.room
        if point is None or point is self._judged or self._run.cell.layout.by_hand:
            return
        then_c, self._judged = reference_c(self._run.log), point
        if then_c is None or point.temperature_c is None:
            return
        if abs(point.temperature_c - then_c) <= table.range_k:
            return
        self._suspend(point, then_c)

    def _suspend(self, point: Point, then_c: float) -> None:
        cause, nest = self._cause(point, then_c), self._run.cell.layout.floor[0]
        x, y, z = self._run.frames.tracker_from_world(nest.xyz_mm)[0].tolist()
        prompt = Prompt(
            title="Wait for the room's temperature",
            text=f"{cause.found}. The run goes on by itself when the air is {cause.wanted}; close "
            "doors and gates, look at the heating.",
            place=PLACE,
            expected_mm=(x, y, z),
            limit_mm=self._run.cell.tracker.find_radius_mm,
            reason=f"room temperature: {cause.found}, wanted {cause.wanted}",
            by_itself=True,
        )
        self._within_s = None
        if not retake_refusal(self._run.log, point.key):
            self._run.event("retake asked", key=point.key)  # done also by a run that is resumed
        self._ask(prompt, lambda: self._look(np.array(prompt.expected_mm), then_c), cause)
        self._run.event(ROOM_BACK)

    def _cause(self, point: Point, then_c: float) -> NoReading:
        table, now_c = self._run.cell.room, point.temperature_c or 0.0
        return NoReading(
            "HC-V14",
            "Tracker",
            f"weather station at {point.key}",
            f"air {now_c:.1f} C, {now_c - then_c:+.1f} K from the grid's first point",
            wanted=f"within {table.back_k:g} K of {then_c:.1f} C for {table.steady_s:g} s",
            act="wait until the room is as it was, then resume",
            fields=Suspicion(Cause.TEMPERATURE, now_c - then_c, "K", NOTICED_BY).facts
            | {"air_c": now_c, "then_c": then_c, "limit_k": table.range_k},
        )

    def _look(self, near_mm: Array, then_c: float) -> Look:
        """Look at the weather station; good once the air has been within the band long enough."""
        table, reflector = self._run.cell.room, self._run.cell.tracker.reflector
        try:
            reading = self._run.devices.tracker.measure(near_mm, reflector, 1)
        except DeviceError as error:
            at_s, silent = self._run.clock.pc_s(), not isinstance(error, NoReading)
            return Look(None, error.summary, at_s, lost=silent)
        now_s = self._run.clock.now_s()
        off_k = np.nan if reading.air is None else reading.air.temperature_c - then_c
        if not abs(off_k) <= table.back_k:
            self._within_s = None
            return Look(None, f"the air is {off_k:+.1f} K from {then_c:.1f} C", reading.taken_s)
        self._within_s = now_s if self._within_s is None else self._within_s
        steady_s = now_s - self._within_s
        if not steady_s >= table.steady_s:
            why = f"the air has been within {table.back_k:g} K for {steady_s:.0f} s"
            return Look(None, f"{why}, wanted {table.steady_s:g} s", reading.taken_s)
        return Look(float(np.linalg.norm(reading.xyz_mm - near_mm)), "", reading.taken_s)
