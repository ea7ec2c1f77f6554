"""The same seed gives the same figures to the last digit, at any speed of the PC."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import pytest

from drivers.kuka import robot_c3
from drivers.universal_robots import robot_rtde
from tests.whole.bench import command, end_of, events, sets, sweep
from tests.whole.golden import RUNS, GoldenRuns

SHORT = {
    "base_frame.points": "4",
    "layout.nest_samples": "2",
    "grid.size_mm": "[200.0, 200.0, 200.0]",  # a short sweep
    "grid.pitch_mm": "200.0",
    "sweeps.axes": "[5]",
}
EKI = {"robot.driver": "kuka-eki"}
STREAMING = {"tracker.driver": "leica-emscon"}


@pytest.fixture
def busy(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Threads take turns all the time, and a sign of life is due at each look, as on a late PC."""
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    for driver in (robot_c3.C3Controller, robot_rtde.UrRtdeRobot):
        monkeypatch.setattr(driver, "HEARTBEAT_S", 0.0)
    yield
    sys.setswitchinterval(before_s)


def figures(done: CompletedProcess[str]) -> dict[str, Any]:
    """Return the result of a run, its points, and the sums of its streams."""
    end = end_of(done)
    assert end["exit"] == 0, done.stderr
    found: dict[str, Any] = {"result": end["result"]}
    for event in events(done.stdout):
        if event["kind"] in ("point", "frame"):
            found[event["key"]] = {
                name: value
                for name, value in event.items()
                if name not in ("t", "seq", "run", "readings")
            }
        elif event.get("what") == "stream":
            found[event["key"]] = event["sha256"]
    return found


@pytest.mark.parametrize(
    ("procedure", "cell", "values"),
    [
        pytest.param("axis-sweeps", "paper", SHORT, marks=pytest.mark.nightly),
        ("axis-sweeps", "paper", SHORT | EKI | {"rail.driver": "kuka-e1"}),
        ("axis-sweeps", "lab", SHORT | STREAMING),
        ("base-frame", "lab", SHORT),
    ],
    ids=["C3, swept", "EKI and E1, swept", "UR, swept", "UR and GeoCOM"],
)
def test_of_a_busy_pc(
    tmp_path: Path,
    request: pytest.FixtureRequest,
    procedure: str,
    cell: str,
    values: dict[str, str],
) -> None:
    run = ("run", procedure, "--cell", cell, "--json", "--unattended", *sets(values))
    once = command(*run, "--runs", tmp_path / "once")
    request.getfixturevalue("busy")
    again = command(*run, "--runs", tmp_path / "again")
    assert figures(again) == figures(once)


@pytest.mark.usefixtures("busy")
@pytest.mark.parametrize("name", ["sign-check", *sweep("small", "calibration", "paper")])
def test_of_a_whole_run(golden: GoldenRuns, tmp_path: Path, name: str) -> None:
    again = command("run", *RUNS[name], "--json", "--runs", tmp_path)
    assert figures(again) == figures(golden[name].done)
