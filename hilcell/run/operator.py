"""A reflector that is carried by hand: the operator is asked, the tracker proves where it sits."""

from __future__ import annotations

import numpy as np

from hilcell.cell.layout import Nest
from hilcell.geometry.frames import inverse
from hilcell.ports import Array
from hilcell.run.interlocks import check_held
from hilcell.run.measuring import Ask, Measuring
from hilcell.run.motion import Motion
from hilcell.run.prompts import FLANGE, borrow_prompt, seat_prompt
from hilcell.run.run_context import RunContext

FLANGE_TOLERANCE_MM = 20.0  # of a seat, by the nominal arm


class Operator:
    """The person who carries the one reflector."""

    def __init__(self, run: RunContext, motion: Motion, measuring: Measuring, ask: Ask) -> None:
        self._run, self._motion, self._measuring, self._ask = run, motion, measuring, ask

    def seat(self, place: str, nominal_mm: Array) -> None:
        """Have the one reflector carried to ``place``, nominally (3,) in {W}, unless it is there.

        Robot parked, slide held. Mounted reflectors are where they are.
        """
        if not self._run.cell.layout.by_hand or self._run.log.seated == place:
            return
        self._motion.park_robot()
        rail = self._run.devices.rail.read()
        check_held(self._run.cell, rail, self._motion.held, f"seat the reflector at {place}")
        near_mm, limit_mm = self._expected(place, nominal_mm, rail.strip_mm)
        prompt = seat_prompt(self._run.cell, place, self._run.log.seated, near_mm, limit_mm)
        seen = self._ask(prompt, lambda: self._measuring.look(f"look at {place}", near_mm), None)
        self._run.event("seated", place=place, xyz_mm=seen.xyz_mm, strip_mm=rail.strip_mm)

    def borrow(self, place: str, nest: Nest) -> None:
        """Have the reflector of ``place`` carried to ``nest``; the robot is parked."""
        self._motion.park_robot()
        near_mm = self._run.frames.tracker_from_world(nest.xyz_mm)[0]
        prompt = borrow_prompt(self._run.cell, place, nest.name, near_mm)
        self._ask(prompt, lambda: self._measuring.look(f"look at {nest.name}", near_mm), None)

    def _expected(self, place: str, nominal_mm: Array, strip_mm: float) -> tuple[Array, float]:
        """Return where a seated reflector (3,) will be, tracker's frame, and within which distance.

        Its last position, shifted by the slide's motion where it rides on the slide, is used first.
        """
        layout = self._run.cell.layout
        if place in self._run.log.sights:
            sight = self._run.log.sights[place]
            rides = place not in {nest.name for nest in layout.standing}
            T_L_W = inverse(self._run.frames.tracker_in_world())
            along = T_L_W[:3, :3] @ np.array(layout.rail_direction)
            moved_mm = (strip_mm - sight.strip_mm) * rides * along
            return np.array(sight.xyz_mm) + moved_mm, layout.nest_tolerance_mm
        near_mm = self._run.frames.tracker_from_world(nominal_mm)[0]
        if "world" not in self._run.log.frames:
            return near_mm, self._run.cell.tracker.find_radius_mm
        limit_mm = FLANGE_TOLERANCE_MM if place == FLANGE else 2 * layout.nest_tolerance_mm
        return near_mm, limit_mm
