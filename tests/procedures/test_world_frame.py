"""{W} is framed by nests that stand as the cell file says, and proven after every station."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from hilcell.geometry.frames import matrix
from hilcell.journal.runs import read_log
from hilcell.ports import Array, TrackerReading
from hilcell.run.cell_session import CellSession
from procedures.station_frames import StationFrames
from procedures.world_frame import WorldFrame
from tests.hilcell.report.journals import Writer
from tests.hilcell.run.bed import CELL, PLAN, Bed
from tests.hilcell.run.rig import Points, procedure
from tests.hilcell.verdicts import base_at
from tests.procedures.results import result_of


def test_no_world_is_framed_by_nests_that_stand_otherwise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bed = Bed(tmp_path)
    measure = bed.tracker.measure

    def stretched(near_mm: Array, reflector: str, samples: int) -> TrackerReading:
        reading = measure(near_mm, reflector, samples)
        return replace(reading, xyz_mm=1.01 * reading.xyz_mm)

    def act(session: CellSession, number: int) -> None:
        session.reach("reference")
        WorldFrame().perform(session)

    monkeypatch.setattr(bed.tracker, "measure", stretched)
    bed.run(procedure(Points(1, act)))
    end = bed.log().end
    assert end is not None
    assert end.error["code"] == "HC-T32"
    assert not bed.log().frames


def test_the_tracker_in_the_result_is_that_of_the_last_set_up(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "r").began()
    first, last = np.eye(4), matrix(np.eye(3), np.array([4.0, 0.0, 0.0]))
    pose = dict.fromkeys(("x_mm", "y_mm", "z_mm", "a_deg", "b_deg", "c_deg"), 0.0)
    found = result_of(WorldFrame(), read_log(tmp_path / "r"))["tracker"]
    stated_mm, stated_deg = CELL.tracker.pose.off(first)
    assert found == {
        "T_W_L": first.tolist(), "pose": pose, "off_mm": stated_mm, "off_deg": stated_deg,
        "moved": 0, "set_ups": [first.tolist()],
    }  # fmt: skip
    event = {"what": "tracker moved", "set_up": 1, "invalid": []}
    writer.journal.append("event", "", event)
    writer.frame("world.1", matrix=last)
    found = result_of(WorldFrame(), read_log(writer.left()))["tracker"]
    assert found["pose"] == pose | {"x_mm": 4.0}
    assert (found["T_W_L"], found["moved"]) == (last.tolist(), 1)
    assert found["set_ups"] == [first.tolist(), last.tolist()]


def test_control_points_come_after_the_slide_s_nests_at_every_station(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(PLAN, "cell", msgspec.to_builtins(CELL))
    bed = Bed(tmp_path)

    def act(session: CellSession, number: int) -> None:
        session.reach("reference")
        WorldFrame().perform(session)
        reference = CELL.reference
        session.frame("base", base_at(CELL.layout.nominal_base(reference.rail_mm)))
        for trigger in ("hold_station", "frame_base", "measure_grid"):
            session.reach(trigger)
        StationFrames().perform(session)

    assert bed.run(procedure(Points(1, act))) == 0, bed.log().fault
    points = [*bed.log().points.values()]
    for station in CELL.station:
        at = max(n for n, point in enumerate(points) if point.station == station.name)
        assert [point.group for point in points[at + 1 : at + 4]] == ["control"] * 3
