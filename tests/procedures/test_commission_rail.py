"""Jogs of a rail whose speeds are not those that were ordered."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from hilcell.cell.devices import Devices
from hilcell.model.events import SlideJogged
from hilcell.model.verdicts import Proved
from hilcell.ports import Clock, RailTrace
from procedures.commission_rail import RETURN, STOP, RailJogs
from procedures.proved import PREFIX
from tests.hilcell.run.bed import CELL, Bed
from tests.hilcell.run.rig import DeskRail, procedure


class FastRail(DeskRail):
    """A rail that moves ``faster`` times the ordered speed, and states the ordered one."""

    def __init__(self, clock: Clock, faster: float) -> None:
        super().__init__(CELL, clock)
        self.faster = faster

    def jog(
        self,
        distance_mm: float,
        *,
        bound_mm: float,
        speed_mm_s: float,
        stop_after_mm: float | None = None,
    ) -> RailTrace:
        gone_mm = distance_mm if stop_after_mm is None else np.copysign(stop_after_mm, distance_mm)
        trace = super().jog(float(gone_mm), bound_mm=bound_mm, speed_mm_s=speed_mm_s)
        shares = np.minimum(np.linspace(0.0, 1.2, 61), 1.0)
        at_mm = trace.drive_mm[0] + shares * gone_mm
        taken_s = np.linspace(0.0, 1.2, 61) * abs(gone_mm) / (self.faster * speed_mm_s)
        stated_mm_s = np.where(shares < 1.0, np.copysign(speed_mm_s, gone_mm), 0.0)
        stopped: Literal["", "stop"] = "" if stop_after_mm is None else "stop"
        return RailTrace(taken_s, at_mm, at_mm, stated_mm_s, stopped)

    def rescaled(self, drive: float, strip: float, speed: float) -> dict[str, object]:
        return {"counts_per_turn": round(speed, 2)}


@pytest.mark.parametrize(
    ("faster", "differs", "longest_mm"),
    [
        (1.0, "", 500.0),
        (1.02, "", 500.0),
        (1.2, "speed unit", 500.0),
        (2.0, "speed in 5 mm", 5.0),
        (0.2, "speed in 5 mm", 5.0),
        (4.0, "speed in 0.5 mm more", 0.5),
        (166.7, "speed in 0.5 mm more", 0.5),
    ],
)
def test_a_wrong_unit_of_speed_ends_the_jogs(
    faster: float, differs: str, longest_mm: float, tmp_path: Path
) -> None:
    bed = Bed(tmp_path, unattended=False)
    bed.devices = Devices(FastRail(bed.clock, faster), bed.devices.robot, bed.devices.tracker)
    bed.run(procedure(RailJogs()))
    log = bed.log()
    failed = [key for key, verdict in log.verdicts.items() if not verdict.holds]
    assert failed == ([PREFIX + differs] if differs else [])
    for key in failed:
        verdict = log.verdicts[key]
        assert isinstance(verdict, Proved)
        values = verdict.values
        assert values["rail.options.counts_per_turn"] == pytest.approx(faster, rel=0.1)
    jogs = log.happened(SlideJogged)
    assert max(abs(each.distance_mm) for each in jogs if each.key != RETURN) == longest_mm


def test_the_slide_returns_at_the_speed_that_is_proved(tmp_path: Path) -> None:
    bed = Bed(tmp_path, unattended=False)
    bed.devices = Devices(FastRail(bed.clock, 1.0), bed.devices.robot, bed.devices.tracker)
    began_mm = bed.devices.rail.read().position_mm
    bed.run(procedure(RailJogs()))
    (back,) = [each for each in bed.log().happened(SlideJogged) if each.key == RETURN]
    assert back.speed_mm_s == STOP.speed_mm_s
    assert bed.devices.rail.read().position_mm == pytest.approx(began_mm)
