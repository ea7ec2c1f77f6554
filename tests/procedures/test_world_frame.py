"""Nests that are swapped, units that are wrong, a tracker that was bumped: all are refused."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from hilcell.geometry.frames import apply, inverse
from hilcell.ports import Array, DeviceError, TrackerReading
from hilcell.run.cell_session import CellSession
from procedures.station_frames import StationFrames
from procedures.world_frame import CONTROL_LIMIT_MM, WorldFrame, check_distances, check_places
from tests.hilcell.run.bed import CELL, PLAN, Bed
from tests.hilcell.run.rig import Points, procedure

NESTS_MM = np.array([nest.xyz_mm for nest in CELL.layout.floor])


def test_the_nests_of_the_cell_file_are_accepted() -> None:
    check_distances(CELL, NESTS_MM + 0.3)


@pytest.mark.parametrize(
    "measured_mm",
    [NESTS_MM[[1, 0, 2]], NESTS_MM / 1000.0, NESTS_MM * 1000.0, NESTS_MM + np.diag([0, np.nan, 0])],
    ids=["swapped", "in metres", "in micrometres", "not a number"],
)
def test_other_distances_are_refused(measured_mm: Array) -> None:
    with pytest.raises(DeviceError) as raised:
        check_distances(CELL, measured_mm)
    assert raised.value.code == "HC-T32"


def test_nests_that_changed_places_are_seen_by_their_places() -> None:
    """F2 and F3 lie equally far from F1: no distance changes, but {W} would be mirrored."""
    seen_mm = apply(inverse(CELL.tracker.pose.matrix()), NESTS_MM) + 3.0
    check_places(CELL, seen_mm)
    check_distances(CELL, seen_mm[[0, 2, 1]])
    with pytest.raises(DeviceError, match=r"F2 .* where F3 is expected") as raised:
        check_places(CELL, seen_mm[[0, 2, 1]])
    assert raised.value.code == "HC-T32"
    with pytest.raises(DeviceError):
        check_places(CELL, seen_mm + np.diag([0.0, np.nan, 0.0]))


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
    assert (bed.log().end or {})["error"]["code"] == "HC-T32"
    assert not bed.log().frames


@pytest.mark.parametrize(
    ("share", "code"), [(0.0, ""), (0.9, ""), (1.1, "HC-T33"), (-1.1, "HC-T33"), (np.nan, "HC-J12")]
)
def test_a_tracker_that_was_bumped_ends_the_run(tmp_path: Path, share: float, code: str) -> None:
    """Framed once, and checked as at every step's end and after every resume."""
    bed, world = Bed(tmp_path), WorldFrame()

    def act(session: CellSession, number: int) -> None:
        session.reach("reference")
        world.perform(session)
        bed.tracker.off_mm = np.array([share * CONTROL_LIMIT_MM, 0.0, 0.0])
        world.perform(session)

    bed.run(procedure(Points(1, act)))
    end = bed.log().end
    assert end is not None
    assert end.get("error", {}).get("code", "") == code


def test_control_points_come_before_the_slide_s_nests_at_every_station(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(PLAN, "cell", msgspec.to_builtins(CELL))
    bed = Bed(tmp_path)

    def act(session: CellSession, number: int) -> None:
        session.reach("reference")
        WorldFrame().perform(session)
        reference = CELL.station_named(CELL.grid.station)
        session.frame("base", CELL.layout.nominal_base(reference.rail_mm))
        for trigger in ("hold_station", "frame_base", "measure_grid"):
            session.reach(trigger)
        StationFrames().perform(session)

    assert bed.run(procedure(Points(1, act))) == 0, bed.log().fault
    points = [*bed.log().points.values()]
    for station in CELL.station:
        at = next(n for n, point in enumerate(points) if point.station == station.name)
        assert [point.group for point in points[at - 3 : at]] == ["control"] * 3
