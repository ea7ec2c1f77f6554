"""A room that leaves its range suspends a run; it goes on by itself when the room is back."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from hilcell.calibration.diagnosis import temperature_change
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.model.point import PointId
from hilcell.ports import Air
from hilcell.run.cell_session import CellSession
from tests.hilcell.run.bed import CELL, PLAN, Bed, Live, until
from tests.hilcell.run.rig import Points, procedure
from tests.hilcell.verdicts import base_at

S1100 = CELL.station_named("S1100")
HOME_RAD = np.radians(CELL.robot.home_deg)
QUICK = {"settle.robot_s": "0.0", "settle.rail_s": "0.0", "room.steady_s": "0.0"}
START_C = 22.0


def grid(session: CellSession, count: int, warmer_k: dict[int, float], bed: Bed) -> None:
    """Measure points of a grid at temperatures that are the start's where none is given."""
    session.reach("reference")
    session.frame("base", base_at(session.cell.layout.nominal_base(S1100.rail_mm)))
    for n in range(count):
        bed.tracker.air = Air(START_C + warmer_k.get(n, 0.0), 1013.0, 45.0)
        session.flange_point(PointId("grid", vertex=(n, 0, 0)), S1100, HOME_RAD)


@pytest.fixture
def bed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bed:
    cell = load_cell("paper", QUICK)
    monkeypatch.setitem(PLAN, "cell", msgspec.to_builtins(cell))
    monkeypatch.setattr("hilcell.run.worker.POLL_S", 0.01)
    return Bed(tmp_path, unattended=False, cell=cell)


@pytest.mark.parametrize("off_k", [2.9, -2.9])
def test_a_room_within_its_range_suspends_nothing(bed: Bed, off_k: float) -> None:
    act = Points(1, lambda session, number: grid(session, 3, {1: off_k}, bed))
    assert bed.run(procedure(act)) == 0, bed.log().fault
    assert bed.asked() == []
    assert temperature_change(bed.log()) is None


@pytest.mark.parametrize("off_k", [3.1, -8.0])
def test_it_goes_on_by_itself_and_measures_the_point_again(bed: Bed, off_k: float) -> None:
    act = Points(1, lambda session, number: grid(session, 3, {1: off_k, 2: off_k}, bed))
    with Live(bed, procedure(act)) as live:
        live.until("state", "suspended")
        warm_now = bed.tracker.air
        until(lambda: live.status("prompt")["age_s"] is not None)  # it has looked, in the warm
        assert live.status("prompt")["ready"] is False
        live.runner.post("proceed")  # the room is still as it was: refused
        assert bed.tracker.air is warm_now
        bed.tracker.air = Air(START_C + 1.9, 1013.0, 45.0)
    assert live.code == 0, bed.log().fault
    (asked,) = bed.asked()
    assert asked["error"]["code"] == "HC-V14"
    assert f"{off_k:+.1f} K" in asked["reason"]
    assert len(bed.events("room back")) == 1
    log = bed.log()
    assert log.points["grid/1-0-0"].temperature_c == START_C + 1.9
    assert [record.key for record in bed.records("point")].count("grid/1-0-0") == 2
    assert temperature_change(log) is None


def test_what_was_measured_in_the_warm_and_counts_is_suspected(bed: Bed) -> None:
    act = Points(1, lambda session, number: grid(session, 3, {1: 2.0}, bed))
    bed.run(procedure(act))
    log = bed.log()
    late = msgspec.structs.replace(log.points["grid/1-0-0"], temperature_c=START_C - 4.0)
    log.points["grid/1-0-0"] = late
    found = temperature_change(log)
    assert found is not None
    assert (found.cause, found.size, found.unit) == ("temperature", -4.0, "K")


def test_the_band_to_go_on_is_the_smaller() -> None:
    with pytest.raises(SettingsError, match="back_k"):
        load_cell("paper", {"room.back_k": "3.0"})
