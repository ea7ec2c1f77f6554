"""Targets that scatter by more than visits, readings and model explain show a brake that slips."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from hilcell.calibration.causes import LARGE_AXES, zero_columns
from hilcell.calibration.diagnosis import Deviations, worse_than_stated, worst_scatter
from hilcell.cell.file import load_cell
from hilcell.journal.journal import read_journal
from hilcell.journal.log import Log
from hilcell.journal.runs import JOURNAL
from hilcell.model.suspicion import Suspicion
from hilcell.ports import Array
from procedures.plan import joints_for
from procedures.validate import targets
from tests.whole.golden import GoldenRuns

CELL = load_cell("paper")
ARM = CELL.robot.arm()
SIGMA_MM = 0.018  # of one coordinate: robot, readings, model
VISITS = 3.0 * 27  # degrees of freedom of thirty visits of three places
COUNT = 135


def columns() -> Array:
    joints_rad = joints_for(CELL, targets(CELL, 1)["S1100"][:COUNT])
    found: Array = zero_columns(ARM, joints_rad)[:, :, :LARGE_AXES]
    return found


COLUMNS = columns()


def scatter(
    seed: int, *, axis: int = 0, slip_deg: float = 0.0, share: float = 1.0
) -> Suspicion | None:
    """Return what targets let suspect of which one axis slips; ``share`` of the stated sigma."""
    rng = np.random.default_rng(seed)
    known_mm2 = rng.chisquare(VISITS) / VISITS * SIGMA_MM**2  # as thirty visits estimate it
    off_mm = share * SIGMA_MM * rng.standard_normal((COUNT, 3))
    slips_rad = np.radians(slip_deg) * rng.standard_normal(COUNT)
    off_mm += COLUMNS[:, :, axis - 1] * slips_rad[:, None]
    covariance_mm2 = np.tile(known_mm2 * np.eye(3), (COUNT, 1, 1))
    return worst_scatter(Deviations(off_mm - off_mm.mean(axis=0), covariance_mm2, COLUMNS, VISITS))


def test_chance_is_no_scatter() -> None:
    assert not any(scatter(seed) for seed in range(200))


@pytest.mark.parametrize("axis", [1, 2, 3])
def test_the_axis_that_slips_is_named_with_its_size(axis: int) -> None:
    """.003 deg of axis 2 leave a mean of .055 mm beside a floor of .03, well within .12."""
    for seed in range(20):
        found = scatter(seed, axis=axis, slip_deg=0.003)
        assert found is not None
        assert found.unit == f"deg of axis {axis}"
        assert found.size == pytest.approx(0.003, rel=0.3)


def test_a_robot_that_scatters_in_all_directions_is_found() -> None:
    for seed in range(20):
        assert scatter(seed, share=2.0) is not None


def test_a_figure_that_is_none_holds_nothing() -> None:
    assert scatter(0, share=float("nan")) is not None


@pytest.fixture
def log(golden: GoldenRuns) -> Log:
    return Log(read_journal(golden["small"].folder / JOURNAL))


def stating(log: Log, rp_mm: float | None) -> Log:
    cell = {**log.inputs.cell, "robot": {**log.inputs.cell["robot"], "rp_mm": rp_mm}}
    log.plan = msgspec.structs.replace(log.inputs, cell=cell)
    return log


def test_visits_that_keep_the_stated_repeatability_are_no_suspicion(log: Log) -> None:
    assert worse_than_stated(stating(log, 0.06)) is None


def test_visits_are_compared_with_no_repeatability_that_nobody_states(log: Log) -> None:
    assert worse_than_stated(stating(log, None)) is None


def test_visits_that_scatter_by_more_than_the_stated_repeatability_are_one(log: Log) -> None:
    found = worse_than_stated(stating(log, 0.02))
    assert found is not None
    assert (found.cause, found.unit) == ("repeatability", "mm")
    assert found.size == pytest.approx(0.06, abs=0.02)
    assert "RP 0.02 mm stated" in found.noticed_by


def test_the_noise_of_readings_is_not_the_robots(log: Log) -> None:
    for point in log.select("repeatability"):
        log.points[point.key] = msgspec.structs.replace(point, std_mm=(0.1, 0.1, 0.1))
    assert worse_than_stated(stating(log, 0.02)) is None
