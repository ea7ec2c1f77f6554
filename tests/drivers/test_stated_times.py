"""The drivers set what the cell file states and a plan counts on."""

import struct

import pytest

from drivers.canopen.rail_setup import drive_settings
from tests.drivers.emscon_peer import EmsconPeer
from tests.drivers.test_tracker_leica_emscon import tracker_at


def test_a_tracker_measures_as_long_as_stated() -> None:
    with EmsconPeer() as peer:
        tracker = tracker_at(peer.server.port, reading_s=0.2)
        tracker.connect()
        tracker.close()
        assert peer.settings[29] == struct.pack("<ii", 200, 1)


@pytest.mark.parametrize(("homing_mm_s", "counts_s"), [(80.0, 80_000), (400.0, 250_000)])
def test_a_drive_homes_as_fast_as_stated_and_never_above_its_speed(
    homing_mm_s: float, counts_s: int
) -> None:
    settings = drive_settings(
        pc_node=127,
        counts_per_mm=1000.0,
        speed_mm_s=250.0,
        acceleration_mm_s2=200.0,
        homing_mm_s=homing_mm_s,
    )
    assert settings[0x6099, 1] == counts_s
