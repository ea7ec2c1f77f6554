"""Volumes of which the arm is clear at the poses of a calibration."""

import msgspec
import pytest

from hilcell.cell.file import VolumesTable, load_cell
from hilcell.cell.surroundings import KeepOut
from hilcell.cell.tables import Pose
from hilcell.commission.sequence import STEPS
from procedures.commission_volumes import floor_and_tracker, least_clearances, listed, to_teach

PAPER = load_cell("paper")
WITHOUT = msgspec.structs.replace(
    PAPER, keep_out=[], robot=msgspec.structs.replace(PAPER.robot, envelope=None)
)
COMING = msgspec.structs.replace(PAPER, keep_out=[], volumes=VolumesTable(file="volumes.csv"))


def box(frame: str, x_mm: float, z_mm: float, y_mm: float = 0.0) -> KeepOut:
    centre = Pose(x_mm=x_mm, y_mm=y_mm, z_mm=z_mm)
    return KeepOut(name="box", centre=centre, size_mm=(200.0,) * 3, frame=frame)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("volume", "where", "inside"),
    [
        (box("slide", 1850.0, 950.0), "the grid's cube", True),
        (box("world", -1720.0, 2080.0, 1800.0), "the safe pose", True),  # beyond all stations
        (box("slide", 1000.0, 100.0), "the ", False),
        (box("world", 5000.0, 500.0), "the grid's cube", False),
    ],
)
def test_the_arm_s_least_clearance_is_that_of_all_poses(
    volume: KeepOut, where: str, inside: bool
) -> None:
    least = least_clearances(PAPER, [volume])["box"]
    assert least.where.startswith(where)
    assert (least.clearance_mm < 0.0) == inside


def test_names_of_the_file_are_not_taught_again() -> None:
    volumes = VolumesTable(teach=["fence", "floor"])
    assert to_teach(msgspec.structs.replace(PAPER, volumes=volumes)) == ["fence"]
    assert to_teach(msgspec.structs.replace(WITHOUT, volumes=volumes)) == ["fence", "floor"]


def test_the_floor_reaches_up_to_the_nests_and_the_tracker_stands_on_it() -> None:
    cell = load_cell("fixed")
    floor, tracker = floor_and_tracker(cell)
    assert floor.centre.z_mm + floor.size_mm[2] / 2.0 == max(n.z_mm for n in cell.layout.floor)
    low_mm = tracker.centre.z_mm - tracker.size_mm[2] / 2.0
    high_mm = tracker.centre.z_mm + tracker.size_mm[2] / 2.0
    assert low_mm == 0.0
    assert low_mm < cell.tracker.pose.z_mm < high_mm
    stated = msgspec.structs.replace(cell, keep_out=[], volumes=VolumesTable(floor=True))
    assert [each.name for each in listed(stated)] == ["floor", "tracker"]
    stated = msgspec.structs.replace(stated, keep_out=[floor])
    assert [each.name for each in listed(stated)] == ["tracker"]


def test_who_gives_no_volumes_is_asked_whether_that_is_meant() -> None:
    (step,) = (each for each in STEPS if each.name == "volumes")
    assert "no axis is swept" in step.confirms(WITHOUT)
    assert step.confirms(PAPER) == ""
    assert step.confirms(COMING) == ""


def test_a_cell_whose_volumes_are_still_to_come_has_none() -> None:
    assert COMING.surroundings is None
    assert PAPER.surroundings is not None
