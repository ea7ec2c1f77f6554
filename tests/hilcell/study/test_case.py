"""One case: figures of a calibration, or the reason why there are none."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from hilcell.cell.devices import in_process_cell, load_entry
from hilcell.decoding import typed
from hilcell.model.results import Calibrated
from hilcell.ports import NoReading
from hilcell.run.procedure import Procedure, run_in_process
from hilcell.study import case
from hilcell.study.case import (
    RESULTS,
    calibrate_case,
    encode_cell,
    figures,
    true_errors_mm,
    versions,
)
from hilcell.study.study_file import Study, study_cell
from tests.hilcell.study.studies import study
from tests.whole.golden import GoldenRuns

CALIBRATE: Procedure = load_entry("procedures", "calibrate")


@pytest.fixture
def asked(tmp_path: Path) -> Study:
    return study(tmp_path)


def test_its_figures_are_those_of_a_calibration(asked: Study, tmp_path: Path) -> None:
    cell = study_cell(asked, {"layout.nest_samples": 3})
    row = calibrate_case(encode_cell(cell), 2, 1, versions())  # machine 2, targets 1
    simulated = in_process_cell(cell, 2, 1)
    log = run_in_process(
        cell, CALIBRATE, seed=1, machine_seed=2, folder=tmp_path, simulated=simulated
    )
    true_mm = true_errors_mm(log, simulated)
    assert len(true_mm) == row.figures["targets"]
    assert row.figures == figures(typed(CALIBRATE.result(log), Calibrated), true_mm)
    assert (row.state, row.reason) == ("done", "")
    assert all(math.isfinite(row.figures[name]) for name in RESULTS)
    assert (
        0.02
        < row.figures["floor_mm"]
        < row.figures["mean_mm"]
        < row.figures["p95_mm"]
        <= row.figures["max_mm"]
        < 0.4
    )
    assert row.figures["mean_mm"] == pytest.approx(
        (row.figures["grid_mm"] + row.figures["others_mm"]) / 2.0
    )  # 8 and 8
    assert 10.0 < (row.minutes or 0.0) < 20.0


def test_truth_beside_the_measurement(asked: Study) -> None:
    """They agree where the tracker has no errors; elsewhere the measurement has the tracker's."""
    perfect = {"radial_um": 1e-3, "across_um_m": 1e-4, "drift_mm": 0.0, "axes_urad": 0.0}
    sizes = {f"simulation.sizes.tracker.{name}": size for name, size in perfect.items()}
    off_mm = []
    for values in (sizes, {}):
        found = calibrate_case(encode_cell(study_cell(asked, values)), 2, 1, versions()).figures
        pairs = ("mean_mm", "true_mean_mm"), ("max_mm", "true_max_mm")
        off_mm.append(max(abs(found[measured] - found[true]) for measured, true in pairs))
    assert off_mm[0] < 1e-5
    assert off_mm[1] > 0.005


def test_only_the_judge_of_a_case_asks_for_the_truth() -> None:
    """The run that it judges, and all that learns from it, has the devices alone."""
    root = Path(case.__file__).parents[2]
    asking = {
        path.relative_to(root).as_posix()
        for room in ("hilcell", "procedures", "drivers")
        for path in (root / room).rglob("*.py")
        if "true_places" in path.read_text("utf-8")
    }
    assert asking == {"hilcell/ports.py", "hilcell/study/case.py"}


def test_a_quick_plan_has_every_figure_but_that_of_the_papers_method(asked: Study) -> None:
    """It sends no targets by it."""
    row = calibrate_case(encode_cell(study_cell(asked, {"plan.quick": True})), 2, 1, versions())
    assert (row.state, row.reason) == ("done", "")
    assert set(RESULTS) - row.figures.keys() == {"idw_mm"}
    assert 0.02 < row.figures["mean_mm"] < row.figures["max_mm"] < 0.4


def test_figures_of_a_result(golden: GoldenRuns) -> None:
    result = golden["small"].result
    calibrated = typed(result, Calibrated)
    found = figures(calibrated, np.array([0.3, 0.1, 0.2]))
    assert found["true_mean_mm"] == pytest.approx(0.2)
    assert found["true_max_mm"] == 0.3
    places = [result["validation"][name] for name in ("S1100", "others")]
    targets = [place["points"] for place in places]
    for name, what in (("before_mm", "before"), ("idw_mm", "idw"), ("mean_mm", "chosen")):
        means = [place[what]["mean"] for place in places]
        whole = sum(n * mean for n, mean in zip(targets, means, strict=True)) / sum(targets)
        assert found[name] == pytest.approx(whole)
    assert found["max_mm"] == max(place["chosen"]["max"] for place in places)
    assert found["points"] == sum(result["points"].values())


def test_a_cell_that_cannot_be_planned(asked: Study) -> None:
    row = calibrate_case(
        encode_cell(study_cell(asked, {"grid.centre.x_mm": 3850.0})), 1, 1, versions()
    )
    assert (row.state, row.figures) == ("cannot be", {})
    row = calibrate_case(
        encode_cell(study_cell(asked, {"simulation.machine": "papr"})), 1, 1, versions()
    )
    assert row.state == "cannot be"
    assert "papr" in row.reason


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (NoReading("HC-T10", "Tracker", "measure", "the beam broke"), "the beam broke"),
        (ZeroDivisionError("1 / 0"), "ZeroDivisionError: 1 / 0"),
    ],
)
def test_a_run_that_ends_early(
    asked: Study, monkeypatch: pytest.MonkeyPatch, error: Exception, words: str
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(case, "run_in_process", broken)
    row = calibrate_case(encode_cell(study_cell(asked, {})), 1, 1, versions())
    assert row.state == "failed"
    assert words in row.reason
    assert not row.figures


def test_another_version_measures_nothing(asked: Study) -> None:
    row = calibrate_case(encode_cell(study_cell(asked, {})), 1, 1, versions() | {"numpy": "1.0"})
    assert (row.versions, row.figures) == (versions(), {})
