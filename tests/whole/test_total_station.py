"""A total station in place of the laser tracker: whole runs."""

from __future__ import annotations

import html
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hilcell.journal.runs import read_log
from tests.whole.bench import SMALL, command, end_of, sets, simulation
from tests.whole.stations import TOTAL_STATION as STATION

CALIBRATION = SMALL | STATION | {"layout.nest_samples": "9"}


def test_an_unattended_run_waits_while_readings_are_not_accurate(tmp_path: Path) -> None:
    """A person may level and adjust the instrument meanwhile; a good look lets the run go on."""
    with simulation(values=STATION) as cell:
        cell.ask(do="fault", name="tracker.geocom_code", value=1284, count=6)
        words = sets(STATION | {"simulation.address": cell.control})
        to = ("--runs", tmp_path, "--name", "x")
        done = command("run", "world-frame", "--unattended", *to, *words)
    assert done.returncode == 0, done.stderr
    life = [(each.to, each.change.by or None) for each in read_log(tmp_path / "x").life]
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
    words = ("--unattended", "--runs", tmp_path, "--name", "x", "--seed", "301")
    done = command("run", *words, *sets(values), "--json")
    assert done.returncode in (0, 1), done.stderr
    result = end_of(done)["result"]
    assert end_of(done)["state"] == "finished"
    assert result["suspicions"] == []
    before, chosen = (result["validation"]["S1100"][how]["mean"] for how in ("before", "chosen"))
    assert chosen < before
    log = read_log(tmp_path / "x")
    stds_mm = np.array([point.std_mm for point in log.points.values()])
    assert 0.3 < np.median(np.linalg.norm(stds_mm, axis=1)) < 1.0
    reason = "tracker driver 'leica-geocom' does not stream; the ripple"
    assert result["sweeps"]["left_out"].startswith(reason)
    page = tmp_path / "x.html"
    assert command("report", "x", "--runs", tmp_path, "-o", page).returncode == 0
    text = html.unescape(page.read_text("utf-8"))
    assert text.count(f"Axes not swept: {reason}") == 2  # beside the model's choice, in the course


def suspected(runs: Path, *words: str) -> list[dict[str, Any]]:
    """Return what a calibration with a total station suspects."""
    end = end_of(command("run", "--unattended", "--runs", runs, *words, "--json"))
    assert end["state"] == "finished", end
    found: list[dict[str, Any]] = end["result"]["suspicions"]
    return found


@pytest.mark.nightly
@pytest.mark.parametrize("seed", ["302", "303", "304", "306"])
def test_the_noise_of_a_total_station_is_no_suspicion(
    machine: str, tmp_path: Path, seed: str
) -> None:
    words = sets(CALIBRATION | {"simulation.machine": machine})
    assert suspected(tmp_path, "--seed", seed, *words) == []


@pytest.mark.nightly
def test_a_mount_that_slipped_is_seen_by_a_total_station(machine: str, tmp_path: Path) -> None:
    values = CALIBRATION | {"touch.poses": "0"}  # the slip leads one near the sight to a nest
    with simulation(values=values | {"simulation.machine": machine}) as cell:
        assert cell.ask(do="fault", name="robot.mount_slip", value=5.0)["ok"]
        words = sets(values | {"simulation.address": cell.control})
        found = suspected(tmp_path, *words)
    assert found[0]["cause"] == "mount offset"
    assert found[0]["size"] == pytest.approx(5.0, rel=0.4)


def test_sweeps_alone_say_that_nothing_was_swept(tmp_path: Path) -> None:
    words = sets(STATION | {"base_frame.points": "6"})
    done = command("run", "axis-sweeps", "--unattended", "--runs", tmp_path, *words)
    assert "Axes not swept: tracker driver 'leica-geocom' does not stream" in done.stderr
