"""A nest that rose out of the plane of three is known by the robot's base, and nothing else is."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from hilcell.calibration.changes import risen_nest
from hilcell.calibration.diagnosis import suspected_causes
from hilcell.calibration.frames import world_motion
from hilcell.geometry.frames import from_rotvec
from hilcell.journal.journal import read_journal
from hilcell.journal.log import Log
from hilcell.journal.previous_reference import floor_before
from hilcell.journal.runs import JOURNAL
from hilcell.model.frame import Frame
from hilcell.model.plan import PreviousReference
from hilcell.ports import Array
from tests.whole.golden import GoldenRuns


@pytest.fixture
def log(golden: GoldenRuns) -> Log:
    return Log(read_journal(golden["small"].folder / JOURNAL))


def since(log: Log, moved: Array) -> Log:
    """Let the base have moved by (6,) since the run before."""
    frame, then = log.frames["base"], log.matrix("base")
    then[:3, 3] -= moved[:3]
    then[:3, :3] = from_rotvec(-moved[3:]) @ then[:3, :3]
    base = Frame(matrix=then.tolist(), covariance=frame.covariance)
    log.plan = msgspec.structs.replace(
        log.inputs, floor_before=PreviousReference("c1", {}, None, base, alike=True)
    )
    return log


def risen(log: Log, nest: int, by_mm: float) -> Array:
    up = log.matrix("world")[:3, :3].T[:, 2]
    return world_motion(log, log.matrix("base")[:3, 3], nest, by_mm * up)


@pytest.mark.parametrize(("nest", "by_mm"), [(0, -1.0), (1, 4.0), (2, -1.0)])
def test_the_nest_that_rose_is_named(log: Log, nest: int, by_mm: float) -> None:
    (found,) = suspected_causes(since(log, risen(log, nest, by_mm)))
    name = log.cell.layout.floor[nest].name
    assert (found.cause, found.unit) == ("nest moved", f"mm of {name}")
    assert found.size == pytest.approx(by_mm, abs=0.01)
    assert found.noticed_by == "base frame of run c1"


@pytest.mark.parametrize("by_mm", [0.0, 0.05])
def test_noise_is_no_risen_nest(log: Log, by_mm: float) -> None:
    assert risen_nest(since(log, risen(log, 2, by_mm))) is None


def test_a_base_that_was_moved_is_no_risen_nest(log: Log) -> None:
    for shift in (np.array([4.0, -3.0, 0, 0, 0, 0]), np.array([0, 0, 0, 0, 0, 2e-3])):
        assert risen_nest(since(log, shift)) is None


def test_without_a_base_measured_before_nothing_can_tell(log: Log) -> None:
    assert log.inputs.floor_before is None
    assert risen_nest(log) is None


def test_the_base_before_is_that_of_the_current_calibration(golden: GoldenRuns, log: Log) -> None:
    found = floor_before(golden["small"].runs, log.cell, 1)
    assert found is not None
    base = log.frames["base"]
    assert found.base == Frame(matrix=base.matrix, covariance=base.covariance)
    joints = msgspec.structs.replace(log.cell.base_frame, axis_1_sweep_deg=(-40.0, 40.0))
    other = floor_before(
        golden["small"].runs, msgspec.structs.replace(log.cell, base_frame=joints), 1
    )
    assert other is not None
    assert found.alike
    assert not other.alike
