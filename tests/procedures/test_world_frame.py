"""Nests that are swapped, units that are wrong, a tracker that was bumped: all are refused."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from hilcell.cell.file import load_cell
from hilcell.ports import Array, DeviceError
from hilcell.run.cell_session import CellSession
from procedures.world_frame import CONTROL_LIMIT_MM, check_control_points, check_distances

CELL = load_cell("paper")
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


def session(moved_mm: float) -> CellSession:
    """Return a session in which every floor nest is found ``moved_mm`` from where it was."""
    log = SimpleNamespace(
        session=1,
        matrix=lambda _: np.eye(4),
        points={f"world/{nest.name}": point(nest.xyz_mm) for nest in CELL.layout.floor},
    )
    again = {
        nest.name: point(nest.xyz_mm + np.array([moved_mm, 0, 0])) for nest in CELL.layout.floor
    }
    found = SimpleNamespace(
        cell=CELL, log=log, floor_point=lambda _key, _group, nest: again[nest.name]
    )
    return cast("CellSession", found)


def point(xyz_mm: Any) -> SimpleNamespace:
    return SimpleNamespace(xyz_mm=tuple(np.asarray(xyz_mm, dtype=float)))


def test_a_tracker_that_stands_goes_on() -> None:
    check_control_points(session(0.5 * CONTROL_LIMIT_MM))


@pytest.mark.parametrize("moved_mm", [1.5 * CONTROL_LIMIT_MM, -1.5 * CONTROL_LIMIT_MM, np.nan])
def test_a_tracker_that_was_bumped_ends_the_run(moved_mm: float) -> None:
    with pytest.raises(DeviceError) as raised:
        check_control_points(session(moved_mm))
    assert raised.value.code == "HC-T33"
