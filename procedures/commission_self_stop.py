"""Commissioning of the self-stop: a person pulls the rail's cable while the slide moves slowly.

Without its PC the drive must brake by itself, by its own timeout. The strip shows how far the slide
went after the last reading; one that does not brake goes on to the end of the jog.
"""

from __future__ import annotations

import math

from hilcell.cell.devices import self_stop_s
from hilcell.cell.file import Cell
from hilcell.journal.log import Log
from hilcell.model.plan import PlannedStep
from hilcell.ports import DeviceError
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Procedure, Result, Step
from procedures.plan import rail_move_s
from procedures.proved import PREFIX, prove, proved_result, proved_table

SPEED_MM_S = 20.0
JOG_MM, SHARE = 300.0, 1.0 / 3.0  # of the travel at most
LATE_S, NEAR_MM = 0.25, 0.5  # of polls and frames; of two readings of a strip
SELF_STOP, RETURN = "self-stop", "return after the self-stop"


def limit_mm(cell: Cell) -> float:
    """Return how far a slide may go after its last reading: timeout, lateness and ramp."""
    coasts_mm = SPEED_MM_S * (self_stop_s(cell.rail.driver) + LATE_S)
    return coasts_mm + SPEED_MM_S**2 / (2.0 * cell.rail.acceleration_mm_s2) + NEAR_MM


def distance_mm(cell: Cell) -> float:
    return min(JOG_MM, SHARE * (cell.rail.travel_max_mm - cell.rail.travel_min_mm))


class SelfStop(Step):
    """One slow jog, whose cable a person pulls."""

    name = "self-stop"
    needs = (
        "a robot parked clear of the slide, a slide free towards the middle of its travel, "
        "somebody at the rail's CAN or network plug"
    )
    moves = (
        "the slide by at most 300 mm towards the middle of its travel at 20 mm/s: pull the rail's "
        "cable meanwhile, in the first half; then back at 20 mm/s"
    )
    measures = "drive and strip, the drive's own state"
    yields = "whether the drive stops by itself without the PC"

    def announced(self, cell: Cell) -> str:
        if not cell.has_rail:
            return self.moves
        far_mm, may_mm = distance_mm(cell), limit_mm(cell)
        timeout_s = self_stop_s(cell.rail.driver)
        return (
            f"the slide by {far_mm:.0f} mm towards the middle of its travel at "
            f"{SPEED_MM_S:g} mm/s: pull the rail's cable meanwhile, in the first half, and leave "
            "it out until the run asks for it. The slide must stop by itself within "
            f"{may_mm:.0f} mm (the drive's timeout of {timeout_s:g} s, and its ramp); one "
            f"that does not goes on to the end of the {far_mm:.0f} mm, and no command can stop it: "
            f"use the E-stop. Then back at {SPEED_MM_S:g} mm/s"
        )

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        there_s = 2.0 * JOG_MM / SPEED_MM_S
        return PlannedStep(self.name, 0, there_s + 2.0 * rail_move_s(cell, 0.0))

    def perform(self, session: CellSession) -> None:
        session.reach("connect")
        if PREFIX + SELF_STOP in session.log.verdicts:
            return
        rail, before = session.cell.rail, session.devices.rail.read()
        far_mm, may_mm = distance_mm(session.cell), limit_mm(session.cell)
        middle_mm = (rail.travel_min_mm + rail.travel_max_mm) / 2.0
        towards = math.copysign(1.0, middle_mm - before.strip_mm)
        jogged, state = session.jog_until_lost(
            SELF_STOP, towards * far_mm, bound_mm=1.2 * far_mm + 3.0, speed_mm_s=SPEED_MM_S
        )
        left_mm = far_mm - abs(jogged.driven_mm)
        if state is None or not left_mm >= 2.0 * may_mm:
            found = "the link was never lost" if state is None else f"lost {left_mm:.0f} mm before"
            raise DeviceError(
                "HC-R55",
                "Rail",
                "self-stop",
                f"{found} the end of the jog",
                expected=f"the cable pulled while {2.0 * may_mm:.0f} mm or more are left",
                fields={"left_mm": left_mm, "needed_mm": 2.0 * may_mm},
            )
        after = session.devices.rail.settle()
        gone_mm = abs(after.strip_mm - jogged.strip_mm[-1])
        holds = prove(
            session,
            SELF_STOP,
            holds=state.stopped and gone_mm <= may_mm,
            found=f"{gone_mm:.1f} mm from the last reading to rest, lost {left_mm:.0f} mm before "
            f"the end of the jog; {state.text}",
            expected=f"at rest without power within {may_mm:.1f} mm: the drive's own stop",
        )
        back_mm = before.position_mm - after.position_mm
        if holds and abs(back_mm) > NEAR_MM:
            bound_mm = 1.2 * abs(back_mm) + 3.0
            session.jog_rail(RETURN, back_mm, bound_mm=bound_mm, speed_mm_s=SPEED_MM_S)

    def result(self, log: Log) -> Result:
        return proved_result(log)


COMMISSION_SELF_STOP = Procedure(
    "commission-self-stop",
    "commissioning: the slide stops by itself when its cable is pulled",
    (SelfStop(),),
    proved_table,
    by_hand="pull the rail's cable while the slide moves, and plug it in again",
    of_rail=True,
)
