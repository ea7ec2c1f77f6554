"""The campaign of stops can fail: a frame that comes late, or was not measured, is said."""

from __future__ import annotations

import pytest

from benchmarks.stop import report as rows
from campaigns.stops import report


@pytest.mark.parametrize(
    ("taken_s", "holds"),
    [([0.004] * 99 + [0.9], True), ([0.004] * 98 + [0.9] * 2, False), ([0.02] * 5, True)],
)
def test_late_frames_are_said(
    taken_s: list[float], holds: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    rows("all", [9.0])
    rows("frame of the rail", [0.001])
    rows("frame of the robot", taken_s)
    assert report(capsys.readouterr().out) == holds


def test_no_frame_is_no_success() -> None:
    assert not report("all  1  p99  3.0")
