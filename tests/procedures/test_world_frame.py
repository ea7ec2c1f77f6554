"""Nests that are swapped, units that are wrong, a tracker that was bumped: all are refused."""

from pathlib import Path

import numpy as np
import pytest

from hilcell.ports import Array, DeviceError
from hilcell.run.cell_session import CellSession
from procedures.world_frame import CONTROL_LIMIT_MM, WorldFrame, check_distances
from tests.hilcell.run.bed import CELL, Bed
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
