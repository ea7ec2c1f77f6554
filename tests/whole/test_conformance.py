"""`hilcell run conformance` on a cell file that names no simulator: as on real devices."""

from __future__ import annotations

from pathlib import Path

import pytest

from hilcell.conformance import promises
from tests.whole.bench import ran, shop_cell, simulation

SLOW = {"robot.speed_percent": "10", "rail.speed_mm_s": "25"}


@pytest.mark.wall
@pytest.mark.usefixtures("faster_than_a_drive")
def test_a_real_device_is_moved_slowly_and_by_a_persons_word_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(promises, "STREAM_S", 0.2)  # of this PC: 200 times as long at the tracker
    words = ("--cell", shop_cell(tmp_path))
    with simulation(200.0) as simulated:
        fast = ran(tmp_path, "conformance", simulated.shop, *words, name="fast")
        run = ran(tmp_path, "conformance", simulated.shop | SLOW, *words)
    assert fast.done.returncode == 2
    assert "--set robot.speed_percent=10 --set rail.speed_mm_s=25" in fast.done.stderr
    assert run.end["exit"] == 0, run.result
    verdicts = {
        (port, each["promise"]): each["verdict"]
        for port, outcomes in run.result["conformance"].items()
        for each in outcomes
    }
    assert verdicts["rail", "units"] == verdicts["robot", "handedness"] == "needs a person"
    assert verdicts["tracker", "units"] == verdicts["tracker", "stream-ends"] == "held"
    assert {verdicts[port, "silent"] for port in ("rail", "robot", "tracker")} == {"not applicable"}
    assert "broken" not in verdicts.values()
    assert "announced" not in [each["what"] for each in run.events if each["kind"] == "event"]
    moves = [each["action"] for each in run.events if each["kind"] == "intent"]
    assert moves == ["robot.park", "rail.home"]
