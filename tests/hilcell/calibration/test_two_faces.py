"""Both faces show what a tracker's own axes are off, which one, and by how much."""

from __future__ import annotations

import numpy as np
import pytest

from fakes.faults import Faults
from fakes.truth.tracker_truth import TrackerTruth
from hilcell.calibration.instrument import AXES, BothFaces, judged_faces
from hilcell.cell.file import load_cell

CELL = load_cell("paper")
NESTS = {nest.name: nest.xyz_mm for nest in CELL.layout.fixed_nests}
LIMIT_MM = 0.015 + 0.012
FAULTS = ("tracker.collimation", "tracker.transit", "tracker.index")


def found(seed: int, fault: str = "", urad: float = 0.0) -> BothFaces:
    faults = Faults()
    tracker = TrackerTruth(CELL, seed, faults, lambda: NESTS)
    if fault:
        faults.set(fault, urad)
    front, back = (
        np.array(
            [
                tracker.measurements(name, count, back=back).xyz_mm.mean(axis=0)  # type: ignore[union-attr] # they are in range
                for name in NESTS
            ]
        )
        for back, count in ((False, 10), (True, 5))
    )
    return judged_faces(list(NESTS), front, back, np.full(len(NESTS), LIMIT_MM))


@pytest.mark.parametrize(("fault", "unit"), list(zip(FAULTS, AXES, strict=True)))
@pytest.mark.parametrize("urad", [50.0, -100.0])
def test_the_axis_that_is_off_is_named_with_its_size(fault: str, unit: str, urad: float) -> None:
    for seed in range(5):
        seen = found(seed, fault, urad)
        assert seen.suspicion is not None
        assert (seen.suspicion.cause, seen.suspicion.unit) == ("instrument", unit)
        assert seen.suspicion.size == pytest.approx(urad, abs=8.0)


def test_a_tracker_as_it_left_its_last_check_holds() -> None:
    assert all(found(seed).holds for seed in range(50))


def test_a_figure_that_is_none_holds_nothing() -> None:
    front = np.array([[4000.0, 100.0, -1500.0]])
    assert not judged_faces(["F1"], front, front * np.nan, np.array([LIMIT_MM])).holds
