"""Bounds of corrected targets from a calibration file, figures worked out by hand."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from hilcell.calibration.budget import (
    TEMPERATURE,
    Coverage,
    ValidatedTargets,
    coverages,
    cube_bounds,
    target_bounds,
    temperature,
)
from hilcell.calibration.file import Calibration
from hilcell.calibration.influence import ASSUMED, MEASURED, MODEL, Influence, motion
from hilcell.calibration.measurement_budget import (
    Contribution,
    Distribution,
    combined_mm,
    expanded_mm,
    thermal_limit_mm,
)
from hilcell.geometry.frames import apply, pose_from_zyx
from hilcell.geometry.statistics import bounds95_mm
from hilcell.model.point import PointId
from tests.hilcell.calibration.calibrations import LOW_MM, REPEATABILITY_MM, T_W_B, calibration
from tests.hilcell.report.journals import Writer

TARGETS = np.array([pose_from_zyx(0, 0, 1200, 0, 75, 0), pose_from_zyx(50, 60, 1250, 0, 75, 0)])


def changed(**values: Any) -> Calibration:
    made = calibration()
    assert made.uncertainty is not None
    uncertainty = msgspec.structs.replace(made.uncertainty, **values)
    return msgspec.structs.replace(made, uncertainty=uncertainty)


def test_the_bound_has_all_parts_of_a_target_in_use() -> None:
    found = target_bounds(calibration(), "S1100", TARGETS)
    names = [part.name for part in found.parts]
    assert names == [MODEL, "Robot repeatability", "SMR centring", TEMPERATURE]
    assert found.parts[1].u_mm == pytest.approx(REPEATABILITY_MM)
    whole = np.sum([part.covariance_mm2 for part in found.parts], axis=0)
    np.testing.assert_allclose(found.covariance_mm2, whole)
    assert (found.radii_mm >= bounds95_mm(whole)).all()  # repeatability comes from few visits
    np.testing.assert_allclose(found.radii_mm, bounds95_mm(whole), rtol=0.03)


def test_what_shows_in_the_validation_alone_is_not_in_use() -> None:
    reading = Influence("r", ASSUMED, "", "", "world", motion(9.0), applies="in validation")
    assert changed().uncertainty is not None
    found = target_bounds(changed(lines=[reading]), "S1100", TARGETS)
    assert [part.name for part in found.parts] == [MODEL, TEMPERATURE]


def test_temperature_is_what_the_check_of_validity_allows() -> None:
    """22 .. 23 C measured, 2 K more allowed: 2.5 K about the middle; the arm takes a share."""
    lever_mm = np.linalg.norm(TARGETS[0, :3, 3] - T_W_B[:3, 3])
    found = target_bounds(calibration(), "S1100", TARGETS[:1]).parts[-1]
    whole_mm2 = np.trace(found.covariance_mm2[0])
    assert whole_mm2 == pytest.approx((10e-6 * 2.5 * lever_mm) ** 2 / 3 / 3)
    along = (TARGETS[0, :3, 3] - T_W_B[:3, 3]) / lever_mm
    assert along @ found.covariance_mm2[0] @ along == pytest.approx(whole_mm2)


@pytest.mark.parametrize(
    ("range_c", "now_c", "std_k"),
    [
        ((22.0, 23.0), None, 2.5 / np.sqrt(3)),
        ((22.0, 23.0), 24.0, 1.5),
        ((22.0, 23.0), 22.5, 0.0),
        (None, None, 2.0 / np.sqrt(3)),
    ],
)
def test_the_arm_s_growth(range_c: Any, now_c: Any, std_k: float) -> None:
    line = temperature(10e-6, range_c, 4.0, now_c)
    assert line.covariance[6][6] == pytest.approx((10e-6 * std_k) ** 2 / 3)  # a share of 0 .. 1


def test_through_the_cube() -> None:
    found = cube_bounds(calibration(), "S1100")
    assert len(found.radii_mm) == 4**3  # two places along each axis of 2 x 2 x 2 cells
    assert found.radii_mm.min() > 0
    model_mm2 = found.parts[0].covariance_mm2
    assert np.trace(model_mm2, axis1=1, axis2=2).min() > 0


def test_coverage_counts_errors_inside_their_own_bounds() -> None:
    found = Coverage(np.array([0.1, 0.2, 0.3, np.nan]), np.array([0.1, 0.3, 0.2, 1.0]))
    assert (len(found), found.inside, found.share) == (4, 2, 0.5)
    bounds = found.figures
    assert (bounds.coverage, bounds.max_mm) == (0.5, 1.0)
    assert bounds.mean_mm == pytest.approx(0.4)


ERRORS_MM = (0.01, 0.5)


def validation_run(folder: Path) -> Writer:
    """Return a run whose two corrected targets at S1100 missed by `ERRORS_MM`."""
    writer = Writer(folder).began()
    writer.point(PointId("grid", vertex=(0, 0, 0)), (0, 0, 0))
    places_mm = apply(T_W_B, LOW_MM + np.array([[100.0, 200, 300], [400, 300, 200]]))
    for number, (at_mm, error_mm) in enumerate(zip(places_mm, ERRORS_MM, strict=True)):
        id = PointId("validate", station="S1100", how="chosen", number=number)
        writer.point(id, at_mm + (0, 0, error_mm), "S1100", nominal_mm=tuple(at_mm))
    return writer


def test_validated_errors_against_their_bounds(tmp_path: Path) -> None:
    log = validation_run(tmp_path / "run").facts().log
    found = ValidatedTargets(calibration(), log, "S1100").coverage
    assert found is not None
    np.testing.assert_allclose(found.errors_mm, ERRORS_MM)
    assert found.inside == 1
    both = coverages(calibration(), log, {"S1100": ["S1100"], "all": ["S300", "S1100"]})
    assert {place: each.inside for place, each in both.items()} == {"S1100": 1, "all": 1}
    assert ValidatedTargets(calibration(), log, "S300").coverage is None


def test_limits_that_are_common_to_the_grid_do_not_widen_the_validation(tmp_path: Path) -> None:
    log = validation_run(tmp_path / "run").facts().log
    made = changed()
    assert made.uncertainty is not None
    limits = [
        msgspec.structs.replace(each, covariance=motion(9.0))
        for each in made.uncertainty.lines
        if each.applies == "in use"
    ]
    found = ValidatedTargets(changed(lines=limits), log, "S1100").coverage
    assert found is not None
    assert found.inside == 1


def test_touch_poses_take_the_place_of_station_frame_and_strip(tmp_path: Path) -> None:
    strip = Influence("Strip", MEASURED, "", "", "world", motion(9.0))
    untouched, touched = (validation_run(tmp_path / name) for name in ("one", "two"))
    covariance = np.diag([1e-6] * 3 + [1e-14] * 3)
    touched.frame("touch.S1100", covariance=covariance, poses=8, visit=1)
    found = [
        ValidatedTargets(changed(stations={"S1100": [strip]}), writer.facts().log, "S1100").coverage
        for writer in (untouched, touched)
    ]
    assert [None if each is None else each.inside for each in found] == [2, 1]


def line(estimate_mm: float, distribution: Distribution) -> Contribution:
    return Contribution("it", estimate_mm, distribution, "somewhere", "somehow", "4.2", "more")


@pytest.mark.parametrize(
    ("estimate_mm", "distribution", "u_mm"),
    [
        (0.010, "normal", 0.010),
        (0.015, "rectangular", 0.0086603),  # 0.015 / sqrt(3)
        (0.0, "rectangular", 0.0),
    ],
)
def test_standard_uncertainty_of_one_coordinate(
    estimate_mm: float, distribution: Distribution, u_mm: float
) -> None:
    found_mm = line(estimate_mm, distribution).u_mm
    assert found_mm == pytest.approx(u_mm, abs=5e-8)


def test_a_whole_budget_by_hand() -> None:
    lines = [
        line(0.010, "normal"),  # 100e-6
        line(0.015, "rectangular"),  # 75e-6
        line(0.0127, "rectangular"),  # 53.7633e-6
        line(0.010, "rectangular"),  # 33.3333e-6
    ]
    assert combined_mm(lines) == pytest.approx(math.sqrt(262.0966e-6), rel=1e-6)
    assert expanded_mm(combined_mm(lines)) == pytest.approx(0.0323788, abs=1e-6)


def test_thermal_limit() -> None:
    assert thermal_limit_mm(2000.0, 11.5e-6, 2.0) == pytest.approx(0.023)
