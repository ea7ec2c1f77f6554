"""Limits of the pose test: a figure and its uncertainty keep them, or they are not kept."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hilcell.calibration.contribution import combined_mm
from hilcell.calibration.measurement_budget import NOISE, WORLD, budget_of
from hilcell.calibration.pose_test import ISO, commanded_mm, interruptions, judgement, pose_test
from hilcell.cell.file import load_cell
from hilcell.journal.log import Log
from hilcell.journal.point_id import PointId
from hilcell.journal.runs import read_records
from tests.hilcell.report.journals import Writer


def result(ad_mm: float = -0.2, **limits: float) -> dict[str, Any]:
    return {
        "worst": {"ap_mm": 1.0, "ap_u95_mm": 0.1, "rp_mm": 0.05, "rp_u95_mm": 0.01},
        "distance": {"ad_mm": ad_mm, "ad_u95_mm": 0.05, "rd_mm": 0.06, "rd_u95_mm": 0.01},
        "limits": limits,
    }


@pytest.mark.parametrize(
    ("limits", "holds"),
    [
        ({"ap_limit_mm": 1.11}, True),
        ({"ap_limit_mm": 1.05}, False),  # AP keeps it, AP + U does not
        ({"rp_limit_mm": 0.061}, True),
        ({"rp_limit_mm": 0.059}, False),
        ({"ad_limit_mm": 0.26}, True),  # of either sign
        ({"ad_limit_mm": 0.24}, False),
        ({"rd_limit_mm": 0.071}, True),
        ({"rd_limit_mm": 0.069}, False),
        ({"ap_limit_mm": 1.05, "rp_limit_mm": 0.061}, False),
    ],
)
def test_a_limit_is_kept_with_the_uncertainty(limits: dict[str, float], holds: bool) -> None:
    judged = judgement(result(**limits))
    assert judged["holds"] is holds
    assert limits.items() <= judged.items()


ANGLES = {
    "P1": {
        "ap_deg": {"a": 0.01, "b": -0.05, "c": 0.0},
        "ap_u95_deg": {"a": 0.01, "b": 0.01, "c": 0.01},
        "rp_deg": {"a": 0.03, "b": 0.01, "c": 0.01},
        "rp_u95_deg": {"a": 0.004, "b": 0.002, "c": 0.002},
    }
}


@pytest.mark.parametrize(
    ("limits", "holds"),
    [
        ({"ap_limit_deg": 0.061}, True),  # of either sign
        ({"ap_limit_deg": 0.055}, False),  # AP_b keeps it, AP_b + U does not
        ({"rp_limit_deg": 0.035}, True),
        ({"rp_limit_deg": 0.033}, False),
    ],
)
def test_the_worst_angle_keeps_its_limit_or_not(limits: dict[str, float], holds: bool) -> None:
    judged = judgement(result(**limits) | {"orientation": ANGLES})
    assert judged["holds"] is holds
    assert limits.items() <= judged.items()
    assert judgement(result(**limits))["holds"] is False  # limited and not measured


def test_without_limits_there_is_no_verdict() -> None:
    assert judgement(result()) == {}


def test_a_figure_that_is_no_number_keeps_no_limit() -> None:
    assert judgement(result(np.nan, ad_limit_mm=1.0))["holds"] is False


def test_stops_and_pauses_between_visits_are_departures(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "r").began()
    for session in (1, 2):
        writer.state("run", "paused")  # the first is before any visit
        writer.state("run", "running")
        writer.point(PointId(ISO, pose="P1", number=session), (0.0, 0.0, 0.0), session=session)
    log = Log(read_records(writer.left()))
    assert len([*interruptions(log)]) == 2


SHIFT_MM = 0.05  # of the base, a standard deviation of each coordinate


def four_cycles(folder: Path, spread_mm: float = 0.0) -> Log:
    """Return a test of four cycles in a base that is known to `SHIFT_MM`.

    Every pose is missed by 1 mm along x; ``spread_mm`` is added and taken off in turn.
    """
    writer = Writer(folder).began()
    shift = np.diag([SHIFT_MM**2] * 3 + [0.0] * 3)
    writer.frame("base", covariance=shift.tolist())
    for nest, at_mm in zip(load_cell("paper").layout.floor, 2000.0 * np.eye(3), strict=True):
        writer.point(PointId("world", nest=nest.name), at_mm, nest=nest.name)
    for cycle in range(4):
        for name, at_mm in commanded_mm(load_cell("paper")).items():
            off_mm = 1.0 + spread_mm * (-1) ** cycle
            writer.point(
                PointId(ISO, pose=name, number=cycle), at_mm + [off_mm, 0.0, 0.0], "S1100",
                nominal_mm=tuple(at_mm), smr_mm=(0.0, 0.0, 0.0),
            )  # fmt: skip
    return Log(read_records(writer.left()))


def system_mm(log: Log, *without: str) -> float:
    budget = budget_of(log)
    assert budget is not None
    assert {NOISE, WORLD} <= {each.name for each in budget.lines}
    return combined_mm([each for each in budget.lines if each.name not in without])


def test_accuracy_is_as_uncertain_as_the_base_and_the_instruments(tmp_path: Path) -> None:
    log = four_cycles(tmp_path / "r")
    found, u_mm = pose_test(log)["poses"]["P3"], system_mm(log, NOISE, WORLD)
    assert (found["ap_mm"], found["rp_mm"]) == pytest.approx((1.0, 0.0), abs=1e-9)
    assert found["ap_u95_mm"] == pytest.approx(2.0 * np.hypot(SHIFT_MM, u_mm))


def test_accuracy_by_a_calibration_is_as_uncertain_as_the_world(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The base is the calibration's then; the tracker finds {W} again."""
    log, used = four_cycles(tmp_path / "r"), SimpleNamespace(provenance=SimpleNamespace(latest="c"))
    monkeypatch.setattr("hilcell.calibration.pose_test.calibration_in", lambda _: used)
    found = pose_test(log)["poses"]["P3"]
    assert system_mm(log, NOISE) > 1.01 * system_mm(log, NOISE, WORLD)
    assert found["ap_u95_mm"] == pytest.approx(2.0 * system_mm(log, NOISE))


def test_a_distance_has_the_instruments_uncertainty_at_both_ends(tmp_path: Path) -> None:
    log = four_cycles(tmp_path / "r")
    found = pose_test(log)["distance"]
    assert found["ad_u95_mm"] == pytest.approx(2.0 * 2.0**0.5 * system_mm(log, NOISE, WORLD))


def test_the_scatter_of_a_mean_shrinks_with_its_cycles(tmp_path: Path) -> None:
    log = four_cycles(tmp_path / "r", spread_mm=0.3)
    s_mm = 0.3 * (4.0 / 3.0) ** 0.5
    u_mm = np.sqrt(s_mm**2 / 4 + SHIFT_MM**2 + system_mm(log, NOISE, WORLD) ** 2)
    assert pose_test(log)["poses"]["P3"]["ap_u95_mm"] == pytest.approx(2.0 * u_mm)
