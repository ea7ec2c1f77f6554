"""The calibration file: sealed, and refused with all problems where it is damaged."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from hilcell.calibration.file import SCHEMA, Calibration, read_calibration, write_calibration
from hilcell.calibration.from_run import other_failed_verdicts, validation_verdicts
from hilcell.cell.settings import SettingsError
from hilcell.compensation.interpolation import Trilinear
from hilcell.journal.log import Log
from hilcell.model.verdicts import OtherVerdict
from tests.hilcell.calibration.calibrations import READINGS_MM2, calibration, measured
from tests.hilcell.compensation.models import level
from tests.hilcell.verdicts import FITTED, REJECTED, SUSPICION, VERDICTS


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "calibration.json"
    write_calibration(calibration(), path)
    return path


def spoilt(change: Callable[[Any], Any], path: Path) -> str:
    """Return what is said of a file that was written, and sealed, with this damage."""
    values = msgspec.to_builtins(calibration())
    change(values)
    write_calibration(msgspec.convert(values, Calibration), path)
    return refused(path)


def refused(path: Path) -> str:
    with pytest.raises(SettingsError) as told:
        read_calibration(path)
    return str(told.value)


def test_round_trip(file: Path) -> None:
    assert read_calibration(file) == calibration(
        written=json.loads(file.read_text())["provenance"]["written"]
    )


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("450.0", "450.1"),
        ('"trilinear"', '"idw"'),
        ('"simulated": false', '"simulated": true'),
        ('"seal": "', '"seal": "0'),
        ('"seal"', '"sael"'),
        ('"model"', '"more": 1, "model"'),
    ],
)
def test_any_change_is_told(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    assert "changed" in refused(file)


def put(path: str, value: Any) -> Callable[[Any], None]:
    def change(values: Any) -> None:
        *way, last = [int(key) if key.isdigit() else key for key in path.split(".")]
        for key in way:
            values = values[key]
        values[last] = value

    return change


@pytest.mark.parametrize(
    ("path", "value", "at"),
    [
        ("model.name", "magic", "model.name: "),
        ("model.parameters", {}, "model.parameters: "),
        ("model.parameters.vertex_covariance_mm2", [], "model.parameters: "),
        ("model.parameters.residual_covariance_mm2.1.1", -0.01, "model.parameters: "),
        ("grid_errors_mm", [], "grid_errors_mm: "),
        ("grid_errors_mm.1", [[(0.0, 0.0, 0.0)]], "grid_errors_mm: "),
        ("grid_errors_mm", [[[(0.0, 0.0, 0.0)]]], "2 vertices"),
        ("grid_errors_mm.1.1.1", (0.0, 101.0, 0.0), "grid_errors_mm: 101 mm"),
        ("pitch_mm", 400.0, "pitch_mm: "),
        ("pitch_mm", -450.0, "pitch_mm: "),
        ("validity.high_mm", (2300.0, 450.0, 1401.0), "900 x 900 x 901"),
        ("validity.low_mm", (-1e9, 0.0, 0.0), "validity.low_mm: "),
        ("validity.orientation", [[1.0]], "validity.orientation: "),
        ("validity.orientations", [[[1.0]]], "validity.orientations.0: "),
        ("validity.orientation.0.0", 5.0, "validity.orientation: "),
        ("validity.orientation_tolerance_deg", 181.0, "tolerance_deg: 181"),
        ("validity.orientation_tolerance_deg", 0.0, "tolerance_deg: 0"),
        ("validity.temperature_c", (23.0, 22.0), "23 .. 22"),
        ("validity.temperature_c", (23.0, 1e9), "temperature_c: "),
        ("stations", {}, "stations: "),
        ("stations.S1100.T_W_B.1", [1.0], "stations.S1100.T_W_B: "),
        ("stations.S1100.T_W_B.3.0", 1.0, "stations.S1100.T_W_B: "),
        ("stations.S1100.T_W_B.0.0", 1.001, "stations.S1100.T_W_B: "),
        ("stations.S1100.T_W_B.0.3", 1e7, "stations.S1100.T_W_B: 1e+07 mm"),
        ("stations.S1100.T_W_S.2.2", -1.0, "stations.S1100.T_W_S: "),
        ("stations.S1100.covariance", [[1.0]], "S1100.covariance: "),
        ("stations.S1100.tool_uncertainty_mm", -1.0, "tool_uncertainty_mm: -1"),
        ("stations.S1100.strip_mm", 1e7, "strip_mm: 1e+07 mm"),
        ("uncertainty.lines.0.covariance", [[1.0]], "Robot repeatability: "),
        ("uncertainty.lines.0.covariance.0.0", -1e-9, "Robot repeatability: "),
        ("uncertainty.lines.0.covariance.0.1", 1e-9, "Robot repeatability: "),
        ("uncertainty.lines.1.origin_mm", (0.0, 1e9, 0.0), "origin_mm: 1e+09 mm"),
        ("uncertainty.lines.0.freedom", 0.0, "Robot repeatability: freedom: 0"),
        ("uncertainty.growth_per_k", -1.0, "uncertainty.growth_per_k: -1"),
        ("uncertainty.stations", {"S7": []}, "uncertainty.stations: "),
    ],
)
def test_sealed_nonsense_is_refused(tmp_path: Path, path: str, value: Any, at: str) -> None:
    said = spoilt(put(path, value), tmp_path / "calibration.json")
    assert at in said
    assert "was changed" not in said


def test_all_problems_come_at_once(file: Path) -> None:
    values = json.loads(file.read_text())
    values["model"]["name"], values["pitch_mm"] = "magic", 1.0
    file.write_text(json.dumps(values))
    said = refused(file)
    assert "3 problems" in said
    for part in ("was changed", "model.name: ", "pitch_mm: "):
        assert part in said


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "not a calibration file"),
        ("[]", "not a calibration file"),
        ("{}", "missing required field `schema`"),
        ('{"schema": true}', "not a calibration file"),
        ('{"schema": 99}', f"schema 99, expected {SCHEMA}"),
        (f'{{"schema": {SCHEMA}}}', "missing required field"),
        (f'{{"schema": {SCHEMA}, "a": {"[" * 9999}', "not a calibration file"),
        (f'{{"schema": {SCHEMA}, "pitch_mm": 1e999}}', "not a calibration file"),
        (f'{{"schema": {SCHEMA}, "pitch_mm": NaN}}', "not a calibration file"),
        (f'{{"schema": 1{"0" * 300}}}', "schema 1e+300, expected"),
    ],
)
def test_what_is_no_calibration(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "calibration.json"
    path.write_text(text)
    said = refused(path)
    assert says in said
    assert len(said) < 500


@pytest.mark.parametrize(
    "change",
    [
        lambda values: values["verdicts"]["S1100"].update(mean_mm=3.7),
        lambda values: values["verdicts"]["S1100"].update(mean_U_mm=-1.0),
        lambda values: values["verdicts"]["S1100"].update(max_tolerance_mm=0.0),
    ],
    ids=["mean", "U", "tolerance"],
)
def test_verdicts_that_cannot_be(file: Path, change: Callable[[Any], Any]) -> None:
    assert "verdicts" in spoilt(change, file)


def test_a_run_s_verdicts_stand_in_its_file() -> None:
    log = Log()
    facts = {"shift_mm": 0.21234567, "cause": "mount slipped"}
    log.verdicts |= {
        "fit": FITTED,
        "closing": OtherVerdict(holds=False, facts=facts),
        "validation.S1100": REJECTED,
    }
    assert other_failed_verdicts(log) == {"closing": "shift 0.2123 mm, cause mount slipped"}
    assert validation_verdicts(log) == {"S1100": REJECTED}
    log.verdicts = {"revisits.closing": VERDICTS["revisits.closing"]}
    assert other_failed_verdicts(log) == {"revisits.closing": SUSPICION.text}


def test_the_model_comes_back_with_its_covariance(file: Path) -> None:
    at_mm = np.array([[1500.0, 0.0, 700.0], [1400.0, -450.0, 500.0]])
    found = read_calibration(file).error_model().predict(level(at_mm))
    wanted = Trilinear.learn(measured()).predict(level(at_mm))
    assert (found.error_mm == wanted.error_mm).all()
    assert (found.covariance_mm2 == wanted.covariance_mm2).all()
    np.testing.assert_array_equal(found.covariance_mm2[1], READINGS_MM2)
