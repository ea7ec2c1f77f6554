"""Other instruments in place of the laser tracker: whole runs with a total station, and a tracker
behind SpatialAnalyzer.
"""

from __future__ import annotations

import html
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.spatialanalyzer.t2sa_points import main as write_points
from hilcell.journal.runs import read_log
from tests.whole.bench import SMALL, TOTAL_STATION, command, ran, simulation

CALIBRATION = SMALL | TOTAL_STATION | {"layout.nest_samples": "9"}
T2SA = {"tracker.driver": "t2sa", "sweeps.enabled": "true"}


def test_an_unattended_run_waits_while_readings_are_not_accurate(tmp_path: Path) -> None:
    """A person may level and adjust the instrument meanwhile; a good poll lets the run go on."""
    with simulation(values=TOTAL_STATION) as cell:
        cell.strike("tracker.geocom_code", 1284, count=6)
        run = ran(tmp_path, "world-frame", TOTAL_STATION | {"simulation.address": cell.control})
    assert run.done.returncode == 0, run.done.stderr
    life = [(each.to, each.change.by or None) for each in run.log.life]
    assert [each for each in life if each[0] == "suspended" or each[1]] == [
        ("suspended", None),
        ("running", "look"),
    ]


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The paper's machine with a total station: 0.6 mm along the beam, 1 arcsec across."""
    here = Path(__file__).parents[2] / "fakes" / "truth" / "machines" / "paper.toml"
    file = tmp_path_factory.mktemp("machine") / "station.toml"
    sizes = "[tracker]\nradial_um = 600.0\nacross_um_m = 4.85\n"
    file.write_text(here.read_text("utf-8").replace("[tracker]\n", sizes), "utf-8")
    return str(file)


@pytest.mark.nightly  # by day, with another robot: test_cells
def test_a_whole_calibration_with_the_uncertainty_of_a_total_station(
    machine: str, tmp_path: Path
) -> None:
    values = CALIBRATION | {"sweeps.enabled": "true", "simulation.machine": machine}
    run = ran(tmp_path, "calibrate", values, "--seed", "301")
    assert run.done.returncode in (0, 1), run.done.stderr
    assert run.end["state"] == "finished"
    result = run.result
    assert result["suspicions"] == []
    before, chosen = (result["validation"]["S1100"][how]["mean"] for how in ("before", "chosen"))
    assert chosen < before
    assert 0.3 < median_std_mm(run.folder) < 1.0
    reason = "tracker driver 'leica-geocom' does not stream; the ripple"
    assert result["sweeps"]["left_out"].startswith(reason)
    page = tmp_path / "x.html"
    assert command("report", "x", "--runs", tmp_path, "-o", page).returncode == 0
    text = html.unescape(page.read_text("utf-8"))
    assert text.count(f"Axes not swept: {reason}") == 2  # beside the model, and in the timeline


def median_std_mm(folder: Path) -> float:
    stds_mm = np.array([point.std_mm for point in read_log(folder).points.values()])
    return float(np.median(np.linalg.norm(stds_mm, axis=1)))


def suspected(runs: Path, values: dict[str, str], *words: str) -> list[dict[str, Any]]:
    run = ran(runs, "calibrate", values, *words)
    assert run.end["state"] == "finished", run.end
    suspicions: list[dict[str, Any]] = run.result["suspicions"]
    return suspicions


@pytest.mark.nightly
@pytest.mark.parametrize("seed", ["302", "303", "304", "306"])
def test_the_noise_of_a_total_station_is_no_suspicion(
    machine: str, tmp_path: Path, seed: str
) -> None:
    values = CALIBRATION | {"simulation.machine": machine}
    assert suspected(tmp_path, values, "--seed", seed) == []


@pytest.mark.nightly
def test_a_mount_that_slipped_is_noticed_with_a_total_station(machine: str, tmp_path: Path) -> None:
    values = CALIBRATION | {"touch.poses": "0"}  # the slip leads one near the sight to a nest
    with simulation(values=values | {"simulation.machine": machine}) as cell:
        cell.strike("robot.mount_slip", 5.0)
        first, *_ = suspected(tmp_path, values | {"simulation.address": cell.control})
    assert first["cause"] == "mount offset"
    assert first["size"] == pytest.approx(5.0, rel=0.4)


def test_sweeps_alone_say_that_nothing_was_swept(tmp_path: Path) -> None:
    run = ran(tmp_path, "axis-sweeps", TOTAL_STATION | {"base_frame.points": "6"})
    left_out = run.result["sweeps"]["left_out"]
    assert left_out.startswith("tracker driver 'leica-geocom' does not stream")


@pytest.mark.nightly  # by day a recorded run of a shorter list repeats: test_record_wire
def test_a_calibration_with_a_list_that_was_written_for_the_cell(tmp_path: Path) -> None:
    listed = tmp_path / "points.csv"
    assert write_points(["paper", str(listed)]) == 0
    run = ran(tmp_path, "calibrate", SMALL | T2SA | {"tracker.options.points": str(listed)})
    assert run.done.returncode in (0, 1), run.done.stderr
    figures = run.result["validation"]["S1100"]
    assert figures["chosen"]["mean"] < figures["before"]["mean"]
    assert "'t2sa'" in run.result["sweeps"]["left_out"]
    log = run.log
    assert {point.samples for point in log.points.values()} >= {2}
    assert 0.001 < median_std_mm(run.folder) < 0.05
    assert log.assets[-1].model.endswith("by SpatialAnalyzer")


def test_a_list_that_does_not_cover_the_cell_is_refused(tmp_path: Path) -> None:
    listed = tmp_path / "points.csv"
    listed.write_text("P1,4000.0,0.0,0.0\n", "ascii")
    values = T2SA | {"tracker.options.points": str(listed), "plan.unattended_wait_s": "0"}
    end = ran(tmp_path, "world-frame", values).end
    assert (end["exit"], end["error"]["code"]) == (3, "HC-T74")
