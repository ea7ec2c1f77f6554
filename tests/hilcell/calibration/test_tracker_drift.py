"""A tracker that turns slowly is known by its floor nests, and a bump is no drift."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hilcell.calibration.diagnosis import tracker_drift
from hilcell.cell.file import Cell, load_cell
from hilcell.geometry.frames import apply, inverse
from hilcell.journal.log import Log
from hilcell.model.point import Point, PointId
from hilcell.ports import Array

CELL = load_cell("paper")
PROOFS = 14  # of a full plan
SIGMA_MM, SAMPLES = 0.01, 10
NESTS_MM = apply(
    inverse(CELL.tracker.pose.matrix()), np.array([nest.xyz_mm for nest in CELL.layout.floor])
)


class Proven(Log):
    """Floor nests at each proof, seen elsewhere by ``moved`` (share of the run, places (N, 3));
    framed again ``set_ups`` times, evenly.
    """

    def __init__(self, moved: Callable[[float, Array], Array], seed: int, set_ups: int = 0) -> None:
        super().__init__()
        self._cell = CELL
        rng = np.random.default_rng(seed)
        for proof in range(PROOFS):
            number = proof * (set_ups + 1) // PROOFS
            began = not proof or number != (proof - 1) * (set_ups + 1) // PROOFS
            share = proof / (PROOFS - 1)
            at_mm = NESTS_MM + moved(share, NESTS_MM)
            at_mm = at_mm + SIGMA_MM / np.sqrt(SAMPLES) * rng.standard_normal(at_mm.shape)
            for nest, xyz_mm in zip(CELL.layout.floor, at_mm.tolist(), strict=True):
                id = PointId("control", session=1, pass_number=proof, nest=nest.name)
                if began:
                    id = PointId("world", number=number or None, nest=nest.name)
                self._take_point(_point(id, xyz_mm, number), 100 * proof + 1)

    @property
    def cell(self) -> Cell:
        return CELL


def _point(id: PointId, xyz_mm: list[float], set_up: int) -> Point:
    x, y, z = xyz_mm
    return Point(
        id=id, key=id.key, group=id.group, station="", reflector="", xyz_mm=(x, y, z),
        std_mm=(SIGMA_MM, SIGMA_MM, SIGMA_MM), samples=SAMPLES, session=1, frame="tracker",
        set_up=set_up,
    )  # fmt: skip


def turning(urad: float) -> Callable[[float, Array], Array]:
    return lambda share, at_mm: share * urad * 1e-6 * np.cross([0.0, 0.0, 1.0], at_mm)


@pytest.mark.parametrize("set_ups", [0, 4])
def test_a_tracker_that_turns_is_named_with_its_size(set_ups: int) -> None:
    """Also where the proofs, each within its limit at first, have framed {W} again."""
    for seed in range(10):
        found = tracker_drift(Proven(turning(100.0), seed, set_ups))
        assert found is not None
        assert (found.cause, found.unit) == ("drift", "urad of the tracker over the run")
        assert found.size == pytest.approx(100.0, rel=0.2)


def test_a_tracker_that_shifts_is_named() -> None:
    found = tracker_drift(Proven(lambda share, _: share * np.array([0.1, 0.0, 0.0]), 1))
    assert found is not None
    assert found.unit == "mm of the tracker over the run"
    assert found.size == pytest.approx(0.1, rel=0.2)


def test_one_that_stands_or_drifts_within_its_limit_is_not() -> None:
    for seed in range(50):
        assert tracker_drift(Proven(lambda _, at_mm: np.zeros_like(at_mm), seed)) is None
    assert tracker_drift(Proven(turning(5.0), 1)) is None


def test_a_bump_between_two_proofs_is_no_drift() -> None:
    def bumped(share: float, at_mm: Array) -> Array:
        return np.full_like(at_mm, 0.06 if share > 0.5 else 0.0)

    assert tracker_drift(Proven(bumped, 1)) is None
    assert tracker_drift(Proven(lambda s, at: 60.0 * bumped(s, at), 1, set_ups=1)) is None
