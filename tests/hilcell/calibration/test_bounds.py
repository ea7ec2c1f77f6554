"""Bounds of corrected targets from a calibration file, figures worked out by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from hilcell.calibration.bounds import Coverage, cube_bounds, target_bounds
from hilcell.calibration.budget import TEMPERATURE, temperature
from hilcell.calibration.file import read_calibration
from hilcell.calibration.form import Calibration
from hilcell.calibration.influence import ASSUMED, MODEL, Influence, NoBound, motion
from hilcell.geometry.frames import pose_from_zyx
from hilcell.geometry.statistics import bounds95_mm
from tests.hilcell.calibration.calibrations import LOW_MM, REPEATABILITY_MM, T_W_B, calibration

GOLDEN = Path(__file__).parent / "golden" / "calibration.json"
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
    reading = Influence("r", ASSUMED, "", "", "world", motion(9.0), counts="in validation")
    assert changed().uncertainty is not None
    found = target_bounds(changed(lines=[reading]), "S1100", TARGETS)
    assert [part.name for part in found.parts] == [MODEL, TEMPERATURE]


def test_temperature_is_what_the_check_of_validity_allows() -> None:
    """22 .. 23 C measured, 2 K more allowed: 2.5 K about the middle, rectangular."""
    lever_mm = np.linalg.norm(TARGETS[0, :3, 3] - T_W_B[:3, 3])
    found = target_bounds(calibration(), "S1100", TARGETS[:1]).parts[-1]
    whole_mm2 = np.trace(found.covariance_mm2[0])
    assert whole_mm2 == pytest.approx((10e-6 * 2.5 * lever_mm) ** 2 / 3)
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
    assert line.covariance[6][6] == pytest.approx((10e-6 * std_k) ** 2)


def test_a_known_temperature_narrows_the_bound() -> None:
    anywhere, here = (
        target_bounds(calibration(), "S1100", TARGETS, celsius).radii_mm for celsius in (None, 22.6)
    )
    assert (here < 0.99 * anywhere).all()


def test_through_the_cube() -> None:
    found = cube_bounds(calibration(), "S1100")
    assert len(found.radii_mm) == 4**3  # two places along each axis of 2 x 2 x 2 cells
    assert found.radii_mm.min() > 0
    model_mm2 = found.parts[0].covariance_mm2
    assert np.trace(model_mm2, axis1=1, axis2=2).min() > 0


def test_old_files_state_no_bound_and_say_why() -> None:
    old = read_calibration(GOLDEN)
    assert old.uncertainty is None
    (station, *_) = old.stations
    with pytest.raises(NoBound, match="states no uncertainty, as those of earlier versions"):
        target_bounds(old, station, TARGETS)


def test_a_missing_part_is_the_reason() -> None:
    with pytest.raises(NoBound, match="no 95 % bounds of corrected targets: nothing was visited"):
        target_bounds(changed(missing="nothing was visited"), "S1100", TARGETS)


def test_a_model_without_covariance_states_no_bound() -> None:
    bare = msgspec.structs.replace(calibration(), model=None)
    with pytest.raises(NoBound, match="its error model trilinear states no covariance"):
        target_bounds(bare, "S1100", TARGETS)


def test_coverage_counts_errors_inside_their_own_bounds() -> None:
    found = Coverage(np.array([0.1, 0.2, 0.3, np.nan]), np.array([0.1, 0.3, 0.2, 1.0]))
    assert (len(found), found.inside, found.share) == (4, 2, 0.5)
    assert found.figures == {"coverage": 0.5, "mean_mm": pytest.approx(0.4), "max_mm": 1.0}


def test_targets_outside_of_the_cube_are_refused() -> None:
    far = TARGETS[:1].copy()
    far[0, :3, 3] = LOW_MM - 5000.0
    with pytest.raises(Exception, match="outside the calibrated volume"):
        target_bounds(calibration(), "S1100", far)
