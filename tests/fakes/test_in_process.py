"""Devices without wires say what those behind wires say, and no more."""

from __future__ import annotations

import numpy as np
import pytest

from fakes.in_process import InProcessCell
from hilcell.cell.file import Cell
from hilcell.ports import NoReading, Streams, Sweeps

FAR_MM = np.array([1000.0, 9000.0, 0.0])


@pytest.fixture
def simulated(cell: Cell) -> InProcessCell:
    made = InProcessCell(cell, seed=1)
    made.rail.connect()
    made.rail.home()
    made.robot.connect()
    made.tracker.connect()
    return made


def test_the_rail_counts(simulated: InProcessCell) -> None:
    """The drive in 0.001 mm, the strip in 0.01 mm; both differ by the rail's own error."""
    simulated.rail.move_to(1100.0)
    reading = simulated.rail.read()
    assert reading.position_mm == pytest.approx(1100.0, abs=0.5)
    assert reading.strip_mm == pytest.approx(1100.0, abs=2.0)
    for value, step in ((reading.position_mm, 0.001), (reading.strip_mm, 0.01)):
        assert value / step == pytest.approx(round(value / step), abs=1e-6)
    assert reading.still


def test_motions_take_the_cells_time(cell: Cell, simulated: InProcessCell) -> None:
    began_s = simulated.clock.now_s()
    simulated.rail.move_to(2000.0)
    simulated.rail.move_to(1000.0)
    assert simulated.clock.now_s() - began_s > 1000.0 / cell.rail.speed_mm_s


def test_the_robot_states_its_joints(cell: Cell, simulated: InProcessCell) -> None:
    joints_rad = np.radians(cell.robot.safe_deg) + 0.01
    reading = simulated.robot.move_to(joints_rad, 50.0)
    assert reading.joints_rad == pytest.approx(joints_rad, abs=1e-4)
    assert reading.still
    assert isinstance(simulated.robot, Sweeps)
    assert isinstance(simulated.tracker, Streams)


def test_no_reflector_is_no_reading(simulated: InProcessCell) -> None:
    with pytest.raises(NoReading):
        simulated.tracker.measure(FAR_MM, "SMR 1.5in", 1)


def test_one_machine_is_one_seed(cell: Cell) -> None:
    """What a machine is depends on its seed alone."""

    def strip_mm(seed: int) -> float:
        made = InProcessCell(cell, seed)
        made.rail.connect()
        made.rail.home()
        made.rail.move_to(1300.0)
        return made.rail.read().strip_mm

    assert strip_mm(1) == strip_mm(1)
    assert len({strip_mm(seed) for seed in range(1, 6)}) > 1
