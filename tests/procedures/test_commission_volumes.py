"""Volumes of which the arm is clear at the poses of a calibration."""

import msgspec
import pytest

from hilcell.cell.file import VolumesTable, load_cell
from hilcell.cell.surroundings import KeepOut
from hilcell.cell.tables import Pose
from hilcell.commission.sequence import STEPS
from procedures.commission_volumes import least_clearances, to_teach

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


def test_who_gives_no_volumes_is_asked_whether_that_is_meant() -> None:
    (step,) = (each for each in STEPS if each.name == "volumes")
    assert "no axis is swept" in step.confirms(WITHOUT)
    assert step.confirms(PAPER) == ""
    assert step.confirms(COMING) == ""


def test_a_cell_whose_volumes_are_still_to_come_has_none() -> None:
    assert COMING.surroundings is None
    assert PAPER.surroundings is not None
