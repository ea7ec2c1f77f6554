"""The one decision rule, at its edges."""

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from hilcell.calibration.decision_rule import (
    Guard,
    check_limits,
    decide,
    guard_band,
    least_mean_mm,
    mean_warning,
)  # fmt: skip
from hilcell.calibration.frames import nest_leverage
from hilcell.calibration.measurement_budget import NOISE, common_motion_mm, measurement_budget
from hilcell.calibration.position_errors import judged_places, places
from hilcell.cell.file import load_cell
from hilcell.geometry.statistics import chi2_quantile, lengths_mm
from hilcell.model.outcome import Outcome
from hilcell.model.results import Decided
from hilcell.model.verdicts import Judged, Limits, OrientationError
from hilcell.ports import Array, HilcellError
from procedures.validate import Validate
from tests.hilcell.report.journals import Writer

LIMITS, GUARD = Limits(0.15, 0.4), Guard(0.05, 0.1)


@pytest.mark.parametrize(
    ("mean_mm", "max_mm", "outcome"),
    [
        (0.0, 0.0, "accepted"),
        (0.0999, 0.2999, "accepted"),
        (0.1001, 0.2, "undecided"),
        (0.05, 0.3001, "undecided"),
        (0.1999, 0.4999, "undecided"),
        (0.2001, 0.2, "rejected"),
        (0.05, 0.5001, "rejected"),
        (math.nan, 0.2, "rejected"),
        (0.05, math.nan, "rejected"),
        (math.inf, math.inf, "rejected"),
    ],
)
def test_the_guard_band(mean_mm: float, max_mm: float, outcome: Outcome) -> None:
    found = decide(mean_mm, max_mm, LIMITS, GUARD)
    assert (found.outcome, found.holds) == (outcome, outcome == "accepted")


def test_an_uncertainty_that_is_no_number_accepts_nothing() -> None:
    assert not decide(0.0, 0.0, LIMITS, Guard(math.nan, 0.0)).holds


@pytest.mark.parametrize("outcome", ["undecided", "rejected"])
def test_the_sequential_test_must_accept_as_well(outcome: Outcome) -> None:
    decided = Decided(
        outcome=Outcome(outcome), targets=[8], text="too few targets", rule="",
        accept_risk=0.05, reject_risk=0.05, share_above_max=0.05,
    )  # fmt: skip
    found = decide(0.01, 0.02, LIMITS, GUARD, sequential=decided)
    assert (found.holds, found.outcome, found.decision) == (False, outcome, "too few targets")


@pytest.mark.parametrize(("count", "shown"), [(1, []), (2, []), (3, ["others"])])
def test_other_stations_are_judged_together_and_shown_so_where_they_are_several(
    count: int, shown: list[str]
) -> None:
    cell = load_cell("paper")
    stations = [cell.reference, *(each for each in cell.station if each != cell.reference)]
    cell = msgspec.structs.replace(cell, station=stations[:count])
    reference, *others = (each.name for each in cell.station)
    assert list(judged_places(cell)) == [reference, *(["others"] if others else []), *others]
    assert list(places(cell)) == [reference, *shown, *others]


ORIENTED = LIMITS._replace(max_deg=0.05)


@pytest.mark.parametrize(
    ("turn", "outcome"),
    [
        (OrientationError(0.039, 0.01), "accepted"),
        (OrientationError(0.041, 0.01), "undecided"),
        (OrientationError(0.061, 0.01), "rejected"),
        (OrientationError(math.nan, 0.01), "rejected"),
        (OrientationError(0.01, math.nan), "rejected"),
    ],
)
def test_orientation_keeps_its_limit_by_the_same_rule(
    turn: OrientationError, outcome: Outcome
) -> None:
    found = decide(0.01, 0.02, ORIENTED, GUARD, orientation=turn)
    assert (found.outcome, found.holds) == (outcome, outcome == "accepted")
    read = msgspec.json.decode(msgspec.json.encode(found), type=Judged)  # NaN is null there
    assert read.orientation is not None
    assert [*map(str, read.orientation)] == [*map(str, turn)]


def test_orientation_is_judged_only_where_it_is_limited_and_measured() -> None:
    far = OrientationError(9.0, 0.01)
    for found in (
        decide(0.01, 0.02, LIMITS, GUARD, orientation=far),
        decide(0.01, 0.02, ORIENTED, GUARD),
    ):
        assert found.holds
        assert found.orientation is None
        assert "max_deg" not in msgspec.to_builtins(found)


def test_what_is_left_of_a_tolerance() -> None:
    assert GUARD.within(LIMITS)[:2] == pytest.approx((0.1, 0.3))


@pytest.mark.parametrize("name", ["mean", "max"])
def test_a_limit_that_nothing_could_keep_is_refused_before_anything_moves(name: str) -> None:
    """U of 0.015 and 0.0127 mm, rectangular, is 0.0227 mm."""
    check_limits(load_cell("paper", {f"validation.{name}_tolerance_mm": "0.023"}))
    cell = load_cell("paper", {f"validation.{name}_tolerance_mm": "0.0226"})
    with pytest.raises(HilcellError, match=rf"validation\.{name}_tolerance_mm .*0\.023 mm"):
        Validate().plan(cell, 1)


def test_the_noise_of_readings_averages_and_nothing_else(tmp_path: Path) -> None:
    log = Writer(tmp_path / "few").began().nests_read().facts().log
    budget = measurement_budget(log)
    assert budget is not None
    noise_mm = next(line.u_mm for line in budget.lines if line.name == NOISE)
    parallel_mm = np.tile([0.0, 5.0, 0.0], (100, 1))  # so all of a common motion is in the mean
    one, many = guard_band(log, parallel_mm[:1]), guard_band(log, parallel_mm)
    assert one.max_mm == many.max_mm == budget.U_mm
    assert one.mean_mm == pytest.approx(budget.U_mm, rel=0.02)
    assert one.mean_mm**2 - many.mean_mm**2 == pytest.approx(4 * 0.99 * noise_mm**2)
    assert "World frame" in [line.name for line in budget.lines]


ALL_WAYS = np.concatenate([np.eye(3), -np.eye(3)])


@pytest.mark.parametrize(
    ("errors_mm", "sigmas"),
    [
        # along one direction: normal; of no length: its own length, chi of 3 degrees of freedom
        (np.tile([9.0, 0.0, 0.0], (5, 1)), 2.0),
        (np.zeros((5, 3)), math.sqrt(chi2_quantile(1 - 0.02275, 3))),
        # in all directions: of second order, |d|^2 / 3 by 1 / length
        (9.0 * ALL_WAYS, chi2_quantile(1 - 0.02275, 3) * 0.02 / 3 / 9.0),
        (np.full((5, 3), np.nan), math.nan),
    ],
)
def test_a_motion_of_all_targets_acts_by_the_directions_of_their_errors(
    errors_mm: Array, sigmas: float
) -> None:
    found_mm = common_motion_mm(errors_mm, 0.02)
    assert found_mm == pytest.approx(0.02 * sigmas, rel=0.04, nan_ok=True)


def test_u_of_a_mean_covers_the_true_mean() -> None:
    rng, u_mm = np.random.default_rng(36), 0.02
    for size_mm in (0.005, 0.02, 0.08):
        beyond = 0
        for _ in range(400):
            measured_mm = size_mm * rng.standard_normal((32, 3))
            true_mm = measured_mm + u_mm * rng.standard_normal(3)
            off_mm = lengths_mm(true_mm).mean() - lengths_mm(measured_mm).mean()
            beyond += abs(off_mm) > common_motion_mm(measured_mm, u_mm)
        assert 1 <= beyond <= 21  # 9.1 are expected on the worse side


def test_the_least_mean_tolerance_is_accepted_where_only_stated_errors_are_left() -> None:
    """At the first floor nest {W} has that nest's centring alone, two coordinates of it by x, y."""
    nests_mm = np.array([[0.0, 0.0, 0.0], [2000.0, 0.0, 0.0], [0.0, 1500.0, 0.0]])
    assert nest_leverage(nests_mm, np.zeros(3)) == pytest.approx(1.0, rel=1e-5)
    beside = nest_leverage(nests_mm, np.array([0.0, 0.0, 1500.0]))
    turned = 2 * (1500 / 2000) ** 2 + 2 * (1500 / 1500) ** 2  # y by two nests, x by two
    assert beside == pytest.approx(1.0 + turned / 3, rel=1e-5)
    cell = load_cell("paper")
    least_mm = least_mean_mm(cell)
    for factor, warned in ((0.99, True), (1.01, False)):
        changed = load_cell("paper", {"validation.mean_tolerance_mm": str(factor * least_mm)})
        assert bool(mean_warning(changed)) is warned


def test_nothing_is_judged_without_a_world(tmp_path: Path) -> None:
    with pytest.raises(HilcellError) as caught:
        guard_band(Writer(tmp_path / "none").began().facts().log, np.ones((3, 3)))
    assert caught.value.code == "HC-C21"
