"""The built-in cell is calibrated over its wires, and the figures are the paper's."""

from pathlib import Path

import numpy as np
import pytest

from fakes.truth.arm_truth import ArmTruth, Ripple
from fakes.truth.machine import cell_machine
from fakes.truth.noise import KeyedNoise
from hilcell.calibration.file import read_calibration
from hilcell.calibration.position_errors import position_errors
from hilcell.cell.file import load_cell
from hilcell.geometry.frames import apply, inverse
from hilcell.journal.runs import CALIBRATION, read_log
from procedures.plan import poses_at
from tests.whole.bench import command, events, sweep
from tests.whole.golden import GoldenRun, GoldenRuns

SPREAD = 0.42  # of the length of a normal vector, as a share of its mean
CHI2_95 = 7.815  # three degrees of freedom
SEEDS = {"paper": 2, "calibration": 3}
SWEPT = {"paper": [1, 2], "calibration": [1, 2, 3, 5]}
TARGETS = {"paper": (27, 24), "calibration": (135, 150)}  # at the grid's station, at the others
pytestmark = pytest.mark.timeout(600)


@pytest.fixture(params=["paper", *sweep("calibration")])
def whole(golden: GoldenRuns, request: pytest.FixtureRequest) -> GoldenRun:
    """Return a run with every act of a calibration in full: that of the paper has others, too."""
    return golden[request.param]


def test_the_end_event_has_the_figures(whole: GoldenRun) -> None:
    end = whole.end
    assert end["state"] == "finished", whole.done.stderr
    assert end["exit"] == 0
    result = end["result"]
    assert result["simulated"] is True
    assert result["points"]["grid"] == 64
    assert result["points"]["frames"] == 24
    assert sorted(result["stations"]) == ["S1100", "S1900", "S300"]
    at_grid, others = result["validation"]["S1100"], result["validation"]["others"]
    assert (at_grid["points"], others["points"]) == TARGETS[whole.folder.name]
    assert 1.09 <= at_grid["before"]["mean"] <= 1.33
    assert 0.09 <= at_grid["idw"]["mean"] <= 0.15
    assert 0.09 <= others["idw"]["mean"] <= 0.20
    chance = 3 * SPREAD / np.sqrt(at_grid["points"])
    assert at_grid["floor"]["mean"] * (1 - chance) < at_grid["chosen"]["mean"]
    assert at_grid["chosen"]["mean"] <= at_grid["idw"]["mean"] + 0.02
    assert set(result["fit"]["loocv"]) >= {"idw", "trilinear"}
    for station in result["stations"].values():
        assert 0.0 < station["tool_uncertainty_mm"] < 0.1
    for place in result["validation"].values():
        bounds = place["bounds"]
        assert place["chosen"]["covered"] == bounds["coverage"]
        assert place["chosen"]["bound95_mean"] == bounds["mean_mm"]
        assert 0.75 <= bounds["coverage"] <= 1.0  # 12 targets at a station
        assert place["chosen"]["mean"] < bounds["mean_mm"] <= bounds["max_mm"] < 0.5


def test_sweeps_find_the_lines_of_the_machine_s_gears(whole: GoldenRun) -> None:
    ripple = truth_of_ripple(SEEDS[whole.folder.name])
    found = {each["axis"]: each for each in whole.result["sweeps"]["axes"]}
    assert sorted(found) == SWEPT[whole.folder.name]
    for axis, each in found.items():
        assert each["used"], each["reason"]
        true = zip(ripple.cycles[axis - 1], ripple.amplitude_rad[axis - 1] * 1e6, strict=True)
        large = sorted((n, size) for n, size in true if size > 5.0)
        np.testing.assert_allclose(each["cycles"], [n for n, _ in large], atol=0.5)
        np.testing.assert_allclose(each["amplitude_urad"], [a for _, a in large], atol=3.0)
        assert abs(each["lag_ms"]) < 20.0


def truth_of_ripple(seed: int) -> Ripple:
    cell = load_cell("paper")
    rng = KeyedNoise(seed).generator("arm")
    return ArmTruth(cell_machine(cell), cell.robot.smr_mm, rng).ripple


def test_events_are_the_journal(whole: GoldenRun) -> None:
    folder, printed = whole.runs, whole.events
    assert [event["seq"] for event in printed] == list(range(1, len(printed) + 1))
    watched = command("watch", "last", "--runs", folder, "--json")
    assert events(watched.stdout) == printed
    assert printed[0]["kind"] == "plan"


def test_show_computes_the_result_again(whole: GoldenRun) -> None:
    folder = whole.runs
    shown = command("show", "last", "--runs", folder, "--json")
    assert events(shown.stdout)[0]["result"] == whole.result
    listed = events(command("runs", "--runs", folder, "--json").stdout)[0]["runs"]
    assert [(each["state"], each["exit"]) for each in listed] == [("finished", 0)]


def test_the_models_covariance_covers_the_errors(whole: GoldenRun) -> None:
    """Of targets that it corrected: a 95 % ellipsoid is good to about 30 % of the variance."""
    folder = whole.folder
    log, made = read_log(folder), read_calibration(folder / CALIBRATION)
    found = position_errors(log, log.select("validate", log.cell.grid.station, how="chosen"))
    T_B_W = inverse(log.matrix("base"))
    errors_mm = found.error_mm @ T_B_W[:3, :3].T
    poses = poses_at(log.cell, apply(T_B_W, found.nominal_mm))
    covariances = made.error_model().predict(poses).covariance_mm2
    squares = np.einsum("nx,nxy,ny->n", errors_mm, np.linalg.inv(covariances), errors_mm)
    assert 0.80 <= np.mean(squares <= CHI2_95) <= 0.99


def test_the_calibration_corrects_targets(whole: GoldenRun, tmp_path: Path) -> None:
    folder = whole.runs
    targets, out = tmp_path / "targets.csv", tmp_path / "out.csv"
    head = "name,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg\n"
    # The cube's centre lies near {W}'s origin at 1100, 1250 mm above the floor.
    targets.write_text(head + "H1,10,20,1250,0,75,0\nH2,-200,100,1000,0,75,0\n")
    words = ("compensate", "last", targets, "--station", "S1100", "-o", out, "--runs", folder)
    done = command(*words)
    assert done.returncode == 0, done.stderr
    moved = [
        (float(b) - float(a))
        for a, b in zip(
            targets.read_text().splitlines()[1].split(",")[1:4],
            out.read_text().splitlines()[1].split(",")[1:4],
            strict=True,
        )
    ]
    assert 0.1 < sum(each**2 for each in moved) ** 0.5 < 4.0
    targets.write_text(head + "FAR,2000,0,1250,0,75,0\n")
    done = command(*words)
    assert done.returncode == 2
    assert "FAR by" in done.stderr
    targets.write_text(head + "TURNED,0,0,1250,0,85,0\n")
    done = command(*words)
    assert done.returncode == 2
    assert "TURNED by" in done.stderr
