"""`hilcell run conformance` on a cell file that names no simulator: as on real devices."""

from __future__ import annotations

from pathlib import Path

import pytest

from hilcell.conformance import promises
from tests.whole.bench import command, end_of, events, sets, simulation

PAPER = Path(__file__).parents[2] / "hilcell/cells/paper.toml"
SLOW = {"robot.speed_percent": "10", "rail.speed_mm_s": "25"}


@pytest.mark.wall
@pytest.mark.usefixtures("faster_than_a_drive")
def test_a_real_device_is_moved_slowly_and_by_a_persons_word_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        promises, "STREAM_S", 0.2
    )  # of this PC: the tracker's are 200 times as long
    cell = tmp_path / "shop.toml"
    cell.write_text(PAPER.read_text("utf-8").split("[simulation]")[0])
    with simulation(200.0) as simulated:
        where = simulated.addresses
        words = {
            "name": "shop",
            "serial": "HC-7",
            "rail.options.channel": where["rail"]["channel"],
            "robot.options.port": str(where["robot"]["port"]),
            "tracker.options.port": str(where["tracker"]["port"]),
            "settle.rail_s": "0.0",
            "rail.standstill_dwell_s": "0.05",
        }
        run = ("run", "conformance", "--cell", cell, "--unattended", "--runs", tmp_path)
        fast = command(*run, *sets(words))
        done = command(*run, "--json", *sets(words | SLOW))
    assert fast.returncode == 2
    assert "--set robot.speed_percent=10 --set rail.speed_mm_s=25" in fast.stderr
    end = end_of(done)
    assert end["exit"] == 0, end["result"]
    found = {
        (port, each["promise"]): each["verdict"]
        for port, outcomes in end["result"]["conformance"].items()
        for each in outcomes
    }
    assert found["rail", "units"] == found["robot", "handedness"] == "needs a person"
    assert found["tracker", "units"] == found["tracker", "stream-ends"] == "held"
    assert {found[port, "silent"] for port in ("rail", "robot", "tracker")} == {"not applicable"}
    assert "broken" not in found.values()
    what = [each["what"] for each in events(done.stdout) if each["kind"] == "event"]
    assert "announced" not in what
    moves = [e["action"] for e in events(done.stdout) if e["kind"] == "intent"]
    assert moves == ["robot.park", "rail.home"]
