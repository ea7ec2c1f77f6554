"""Keep-out volumes as a person gives them."""

from pathlib import Path

import numpy as np
import pytest

from hilcell.cell.settings import SettingsError
from hilcell.compensation.volumes import HEADER, MARGIN_MM, read_volumes, taught
from hilcell.geometry.frames import apply, from_zyx, inverse
from hilcell.geometry.kinematics import Array

HEAD = ",".join(HEADER)
FLOOR = "floor,0,-9000,-9000,-1000,9000,9000,0"
PLATE = "plate,1,450,-450,0,-450,450,-100"


@pytest.mark.parametrize(
    ("rows", "why"),
    [
        (["plate,1,-450,-450,-100"], "5 fields, expected 8"),
        (["plate,1,-450,-450,-100,450,450,nan"], "line 2: to_z_mm is 'nan'"),
        (["plate,2,-450,-450,-100,450,450,0"], "plate: on_slide is 2, expected 0 or 1"),
        ([FLOOR, "floor,0,0,0,0,100,100,1000"], "line 3: name 'floor' was used before"),
        (["floor,0,-9,-9,-1,9,9,0"], "in metres or inches"),
        ([FLOOR, "plate,1,-0.45,-0.45,-0.1,0.45,0.45,0"], "plate: .*expected >= 5 mm, got 0.1"),
        (["floor,0,-9e6,-9e6,-1e6,9e6,9e6,0"], r"expected within \+-1e\+06"),
        (["[floor,0,-9000,-9000,-1000,9000,9000,0"], r"\[floor: .*a letter or digit"),
        ([], "no volumes"),
    ],
)
def test_a_list_of_volumes_is_refused_with_its_faults(
    rows: list[str], why: str, tmp_path: Path
) -> None:
    file = tmp_path / "volumes.csv"
    file.write_text("\n".join([HEAD, *rows, ""]))
    with pytest.raises(SettingsError, match=why):
        read_volumes(file)


def test_two_opposite_corners_are_a_box_whatever_their_order(tmp_path: Path) -> None:
    file = tmp_path / "volumes.csv"
    file.write_text("\n".join([HEAD, FLOOR, PLATE, ""]))
    floor, plate = read_volumes(file)
    assert (floor.frame, plate.frame) == ("world", "slide")
    assert floor.centre.z_mm == -500.0
    assert floor.size_mm == (18000.0, 18000.0, 1000.0)
    assert plate.centre.z_mm == -50.0
    assert plate.size_mm == (900.0, 900.0, 100.0)


CORNERS_MM = np.array([[0, 0, 1000], [500, 0, 1000], [500, 900, 1000], [0, 900, 0]], dtype=float)


@pytest.mark.parametrize("turn_deg", [0.0, 17.0, 95.0])
@pytest.mark.parametrize("seen", [[0, 1, 2, 3], [1, 3, 0], [2, 0, 1, 3, 1]])
def test_a_taught_box_contains_its_corners_with_the_margin_and_is_turned_with_them(
    turn_deg: float, seen: list[int]
) -> None:
    corners_mm: Array = CORNERS_MM[seen] @ from_zyx((turn_deg, 0.0, 0.0)).T + [2000.0, -500.0, 10.0]
    box = taught("cabinet", corners_mm)
    within_mm = np.array(box.size_mm) / 2 - np.abs(apply(inverse(box.centre.matrix()), corners_mm))
    assert within_mm.min() == pytest.approx(MARGIN_MM, abs=0.01)
    assert sorted(box.size_mm) == pytest.approx([560.0, 960.0, 1060.0], abs=0.01)


def test_two_corners_are_opposite_ones_along_the_axes_of_the_world() -> None:
    box = taught("fence", np.array([[0.0, 0.0, 0.0], [3000.0, 100.0, 2000.0]]))
    assert box.size_mm == (3060.0, 160.0, 2060.0)
    assert box.centre.a_deg == 0.0
