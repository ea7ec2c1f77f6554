"""The self-stop: what is proved where a person pulls the cable, too late, or not at all."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hilcell.cell.devices import Devices
from hilcell.model.events import SlideJogged
from hilcell.ports import AfterLoss, Clock, DeviceError, RailTrace
from hilcell.run.procedure import announced
from procedures.commission_self_stop import SELF_STOP, SPEED_MM_S, SelfStop, limit_mm
from procedures.proved import PREFIX
from tests.hilcell.run.bed import CELL, Bed
from tests.hilcell.run.rig import DeskRail, procedure

MAY_MM = limit_mm(CELL)
HELD, MOVES = AfterLoss(True, "at rest"), AfterLoss(False, "moves")


class PulledRail(DeskRail):
    """A rail whose cable is pulled after ``gone_mm``, None: not at all; it then coasts."""

    own_stop_s = 1.0

    def __init__(self, clock: Clock, gone_mm: float | None, coasts_mm: float, state: AfterLoss):
        super().__init__(CELL, clock)
        self.gone_mm, self.coasts_mm, self.state = gone_mm, coasts_mm, state
        self.silent = 2  # polls before it answers again

    def jog_until_lost(
        self, distance_mm: float, *, bound_mm: float, speed_mm_s: float
    ) -> RailTrace:
        assert speed_mm_s == SPEED_MM_S
        trace = self.jog(distance_mm, bound_mm=bound_mm, speed_mm_s=speed_mm_s)
        if self.gone_mm is None:
            return trace
        at_mm = np.array([trace.drive_mm[0], trace.drive_mm[0] + self.gone_mm])
        self.position_mm = float(at_mm[1]) + self.coasts_mm
        return replace(trace, drive_mm=at_mm, strip_mm=at_mm, stopped_by="lost")

    def regain(self) -> AfterLoss:
        self.silent -= 1
        if self.silent:
            raise DeviceError("HC-R05", "Rail", "regain", "no answer")
        return self.state


def performed(folder: Path, rail_of: dict[str, Any]) -> Bed:
    bed = Bed(folder, unattended=False)
    rail = PulledRail(bed.clock, **rail_of)
    bed.devices = Devices(rail, bed.devices.robot, bed.devices.tracker)
    bed.run(procedure(SelfStop()))
    return bed


@pytest.mark.parametrize(
    ("gone_mm", "coasts_mm", "state", "holds"),
    [
        (50.0, MAY_MM - 0.1, HELD, True),
        (50.0, MAY_MM + 0.1, HELD, False),
        (50.0, 250.0, HELD, False),
        (50.0, 1.0, MOVES, False),
        (50.0, math.nan, HELD, False),
    ],
)
def test_a_slide_must_rest_by_itself_within_its_bound(
    gone_mm: float, coasts_mm: float, state: AfterLoss, holds: bool, tmp_path: Path
) -> None:
    bed = performed(tmp_path, {"gone_mm": gone_mm, "coasts_mm": coasts_mm, "state": state})
    log = bed.log()
    assert log.verdicts[PREFIX + SELF_STOP].holds == holds
    jogs = log.happened(SlideJogged)
    assert jogs[0].stopped_by == "lost"
    assert bed.asked()[0]["prompt"]["title"] == "Plug the rail's cable in again"
    assert len(jogs) == (2 if holds else 1)  # back only by a drive that has stopped
    if holds:
        assert bed.rail.position_mm == pytest.approx(1100.0)


@pytest.mark.parametrize(
    ("gone_mm", "words"),
    [(None, "never lost"), (300.0 - MAY_MM, f"lost {MAY_MM:.0f} mm before the end")],
)
def test_a_cable_that_is_not_pulled_in_time_proves_nothing(
    gone_mm: float | None, words: str, tmp_path: Path
) -> None:
    bed = performed(tmp_path, {"gone_mm": gone_mm, "coasts_mm": 1.0, "state": HELD})
    log = bed.log()
    assert not log.verdicts
    assert log.end is not None
    assert log.end.error["code"] == "HC-R55"
    assert words in log.end.error["found"]


def test_the_announcement_has_distance_speed_and_bound() -> None:
    text = announced(SelfStop(), CELL)
    for words in ("300 mm", "20 mm/s", f"within {MAY_MM:.0f} mm", "timeout of 1 s"):
        assert words in text
