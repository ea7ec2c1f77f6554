"""A run whose tracker is behind SpatialAnalyzer: faults by name, and a calibration to its end."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from drivers.spatialanalyzer import t2sa_bridge
from drivers.spatialanalyzer.t2sa_points import main as write_points
from hilcell.alarms import alarms_of
from hilcell.commands.cli import main
from hilcell.journal.runs import read_log
from tests.whole.bench import SMALL, Simulation, command, end_of, sets, simulation, sweep

T2SA = {"tracker.driver": "t2sa"}
# A laser tracker's noise, but no sweeps: the ripple of the gears stays.
CALIBRATION = SMALL | T2SA | {"sweeps.enabled": "true"}
ENDS: dict[str, tuple[str, object]] = {
    "tracker.t2sa_simulation": ("HC-T71", True),
    "tracker.t2sa_inches": ("HC-T73", True),
    "tracker.t2sa_renamed": ("HC-T72", True),
    "tracker.t2sa_old_result": ("HC-T76", True),
    "tracker.t2sa_nominal": ("HC-T71", True),
    "tracker.t2sa_code": ("HC-T70", 338),
    "tracker.not_warmed_up": ("HC-T70", True),
    "tracker.no_reflector": ("HC-T11", True),
    "tracker.beam_break_after": ("HC-T11", True),
    "tracker.wrong_target": ("HC-T16", True),
    "tracker.no_result": ("HC-T13", True),
    "tracker.late_result": ("HC-T13", True),
    "tracker.noisy": ("HC-T15", 1.0),
    "tracker.bad_number": ("HC-T14", "nan"),
    "tracker.busy": ("HC-T21", True),
    "tracker.eof": ("HC-T02", True),
}


@pytest.fixture(scope="module")
def standing() -> Iterator[Simulation]:
    with simulation(values=T2SA) as cell:
        yield cell


@pytest.fixture(autouse=True)
def short_deadlines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(t2sa_bridge, "REPLY_S", 0.5)
    monkeypatch.setattr(t2sa_bridge, "MEASURE_S", 0.5)


def run(cell: Simulation, runs: Path, **values: str) -> tuple[int, list[str]]:
    """Run a short procedure; return its exit code and the codes of its alarms."""
    words = T2SA | values | {"simulation.address": cell.control, "plan.unattended_wait_s": "0"}
    shown = ["run", "world-frame", "--unattended", "--runs", str(runs), "--name", "x"]
    code = main([*shown, *sets(words)])
    return code, [each.code for each in alarms_of(read_log(runs / "x"), "x", live=False)]


@pytest.mark.parametrize(("fault", "code", "value"), [(n, c, v) for n, (c, v) in ENDS.items()])
def test_faults_end_a_run_by_their_alarm(
    standing: Simulation, tmp_path: Path, fault: str, code: str, value: object
) -> None:
    ends_by_its_alarm(standing, tmp_path, fault, code, value)


def test_a_bridge_that_vanishes_ends_a_run_by_its_alarm(tmp_path: Path) -> None:
    with simulation(values=T2SA) as cell:  # its own: nothing is served after it
        ends_by_its_alarm(cell, tmp_path, "tracker.vanish", "HC-T02", True)


def ends_by_its_alarm(
    cell: Simulation, tmp_path: Path, fault: str, code: str, value: object
) -> None:
    assert cell.ask(do="fault", name=fault, value=value, count=0)["ok"]
    exit_code, alarms = run(cell, tmp_path)
    cell.ask(do="clear")
    assert exit_code in (2, 3)
    assert alarms[-1] == code
    found = alarms_of(read_log(tmp_path / "x"), "x", live=False)[-1]
    assert found.severity == "fault"
    assert found.do


@pytest.mark.parametrize("procedure", ["sign-check", *sweep("calibrate")])
def test_a_calibration_with_a_list_that_was_written_for_the_cell(
    tmp_path: Path, procedure: str
) -> None:
    listed = tmp_path / "points.csv"
    assert write_points(["paper", str(listed)]) == 0
    words = sets(CALIBRATION | {"tracker.options.points": str(listed)})
    to = ("--unattended", "--runs", tmp_path, "--name", "x", "--json")
    done = command("run", procedure, *to, *words)
    assert done.returncode in (0, 1), done.stderr
    result = end_of(done)["result"]
    if procedure == "calibrate":
        figures = result["validation"]["S1100"]
        assert figures["chosen"]["mean"] < figures["before"]["mean"]
        assert result["sweeps"]["left_out"].startswith("tracker driver 't2sa' does not stream")
    log = read_log(tmp_path / "x")
    assert {point.samples for point in log.points.values()} >= {2}
    stds_mm = np.array([point.std_mm for point in log.points.values()])
    assert 0.001 < np.median(np.linalg.norm(stds_mm, axis=1)) < 0.05
    assert log.assets[-1].model.endswith("by SpatialAnalyzer")


def test_a_list_that_does_not_cover_the_cell_is_refused(tmp_path: Path) -> None:
    listed = tmp_path / "points.csv"
    listed.write_text("P1,4000.0,0.0,0.0\n", "ascii")
    with simulation(values=T2SA | {"tracker.options.points": str(listed)}) as cell:
        exit_code, alarms = run(cell, tmp_path, **{"tracker.options.points": str(listed)})
    assert exit_code == 3
    assert alarms[-1] == "HC-T74"
