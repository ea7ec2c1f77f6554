"""A further model needs its own class and one registration, and no other line of the core."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest
from msgspec.structs import replace

from hilcell.calibration.file import compensate_targets, read_calibration, write_calibration
from hilcell.cell.settings import SettingsError
from hilcell.compensation.model import LearntModel, Measured, Prediction
from hilcell.compensation.model_choice import MODELS
from hilcell.fit.methods import fit_robot
from hilcell.model.verdicts import SignChecked
from hilcell.ports import Array
from procedures.fit import Fit, SignCheck
from tests.hilcell.calibration.calibrations import calibration
from tests.hilcell.fit.test_fit import IRB120, SMR_MM
from tests.hilcell.fit.test_fit import measured as measured_rows
from tests.hilcell.verdicts import FITTED, plain
from tests.procedures.results import result_of
from tests.procedures.test_sign_check import FakeBench


@dataclass(frozen=True, eq=False)
class Plane(LearntModel):
    """An error that is linear in the place."""

    name = "plane"
    text = "corrected by a plane"

    terms: Array  # (4, 3)

    @classmethod
    def learn(cls, measured: Measured) -> Self:
        poses = measured.poses
        at_mm = _with_one(poses.nominal[:, :3, 3])
        terms = np.linalg.lstsq(at_mm, poses.error_mm, rcond=None)[0]
        return cls(np.array(terms, dtype=float))

    def predict(self, poses: Array) -> Prediction:
        error_mm = _with_one(poses[:, :3, 3]) @ self.terms
        return Prediction(error_mm, np.tile(1e-4 * np.eye(3), (len(error_mm), 1, 1)))


def _with_one(points_mm: Array) -> Array:
    return np.column_stack([np.ones(len(points_mm)), points_mm])


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(MODELS, "plane", Plane)


def test_it_is_judged_chosen_and_applied_on_the_cell() -> None:
    bench: Any = FakeBench()
    found = result_of(Fit(), bench.log)
    assert set(found["fit"]["loocv"]) >= {"nominal", "idw", "trilinear", "plane"}
    assert found["method"] in ("plane", "trilinear")  # the error is linear, up to rounding
    bench.keep("verdict", "fit", plain(replace(FITTED, method="plane")))
    SignCheck().perform(bench)
    judged = bench.log.verdict(SignChecked)
    assert judged is not None
    assert judged.corrected_mm < 0.01


def test_it_is_judged_on_a_robot_that_was_measured_elsewhere() -> None:
    rows, test = (measured_rows(seed, 16, list(SMR_MM)) for seed in (1, 2))
    assert set(fit_robot(IRB120, rows, test).result["methods"]) == {"nominal", "idw", "plane"}


def test_it_is_kept_in_the_file_and_corrects_targets(tmp_path: Path) -> None:
    path, target = tmp_path / "calibration.json", np.array([[0.0, 0, 1200, 0, 75, 0]])
    by_plane, by_trilinear = (
        compensate_targets(_kept(method, path), "S1100", target, ["H1"])
        for method in ("plane", "trilinear")
    )
    assert np.abs(by_plane - target).max() > 0.3
    np.testing.assert_allclose(by_plane, by_trilinear, atol=1e-6)  # of a linear field


def _kept(method: str, path: Path) -> Any:
    write_calibration(calibration(method=method), path)
    return read_calibration(path)


def test_its_bad_parameters_are_reported_by_field(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    made = calibration(method="plane")
    assert made.model is not None
    made.model.parameters.clear()
    write_calibration(made, path)
    with pytest.raises(SettingsError, match=r"model\.parameters: "):
        read_calibration(path)
