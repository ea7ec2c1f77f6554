from __future__ import annotations

import threading
from pathlib import Path

import pytest

from drivers.canopen import bus_scan, requirements
from drivers.canopen.rail import CanopenRail
from fakes.canopen.rail_device import RailDevice
from hilcell.clock import WallClock
from tests.fakes.rail_bench import served

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize(("drive", "strip"), [(5, 6), (6, 5), (17, 126)])
def test_drive_and_strip_are_found_by_their_profiles(drive: int, strip: int) -> None:
    with served(device=RailDevice(drive_node=drive, strip_node=strip)) as bench:
        channel = f"socket://127.0.0.1:{bench.server.port}"
        (found,) = CanopenRail.discover({"channel": channel})
        assert found.options["drive_node"] == drive
        assert found.options["strip_node"] == strip
        assert found.options["bitrate"] == bus_scan.USUAL
        assert [each.simulated for each in found.identities] == [True, True]
        assert bench.server._drive.nmt.name == "PRE_OPERATIONAL"


def test_inspecting_reads_and_names_objects_that_are_missing() -> None:
    with served() as bench:
        drive = bench.server._drive.dictionary
        for index, sub in ((0x607C, 0), (0x6007, 0)):
            drive._entries.pop((index, sub))
        before = {key: entry.value for key, entry in drive._entries.items()}
        options = CanopenRail.Options(
            channel=f"socket://127.0.0.1:{bench.server.port}",
            travel_min_mm=0.0,
            travel_max_mm=3000.0,
            speed_mm_s=250.0,
            acceleration_mm_s2=200.0,
        )
        found = CanopenRail(options, WallClock(threading.Event())).inspect()
        missing = {each.feature[:5] for each in found if each.state == "has not"}
        lacks = {each.feature[:5] for each in found if each.needed == "mandatory"} & missing
        assert lacks == {"6007h"}
        assert "607Ch" in missing
        assert {each.device for each in found} == {"Drive", "Strip"}
        assert before == {key: entry.value for key, entry in drive._entries.items()}


def test_the_page_shows_the_table() -> None:
    assert requirements.table() in (ROOT / "docs" / "hardware.md").read_text("utf-8")
