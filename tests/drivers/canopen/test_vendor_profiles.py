from __future__ import annotations

import pytest

from drivers.canopen.vendor_profiles import vendor_profiles
from tests.drivers.canopen.can_peer import DRIVE, CanPeer, u32
from tests.drivers.canopen.rail_bed import RailBed
from tests.drivers.peers import refusal


@pytest.mark.parametrize(
    ("vendor", "stated", "options", "speed", "ramp"),
    [
        (0x484, {}, {}, 250_000, 200_000),
        (0xAB, {}, {}, 2_500_000, 20_000),  # 0.1 counts/s, 10 counts/s^2
        (0xAB, {}, {"speed_unit": "counts/s"}, 250_000, 200_000),
        (0xAB, {0x60A9: 0x00B50300}, {}, 250_000, 200_000),
        (0x484, {0x60A9: 0x00B44700}, {"counts_per_turn": 6000.0}, 2500, 2000),
        (0x484, {0x60A9: 0xFDB44700}, {"counts_per_turn": 6000.0}, 2_500_000, 2_000_000),
        (
            0x484,
            {0x60A9: 0xFDB44700, 0x60AA: 0x00C00300},
            {"counts_per_turn": 6e3},
            2_500_000,
            2000,
        ),
        (0x484, {0x60A9: 0xFDB40300, 0x60AA: 0xFDB45700}, {"counts_per_turn": 1e4}, 25000, 20000),
        (0x484, {}, {"speed_unit": "mm/s"}, 250, 200),
    ],
)
def test_units_are_the_options_else_the_drives_else_the_makes(
    bed: RailBed,
    peer: CanPeer,
    vendor: int,
    stated: dict[int, int],
    options: dict[str, object],
    speed: int,
    ramp: int,
) -> None:
    peer.objects[DRIVE][0x1018, 1] = u32(vendor)
    peer.objects[DRIVE] |= {(index, 0): u32(value) for index, value in stated.items()}
    bed.connect(drive_vendor=vendor, **options)
    assert peer.written(0x6081) == [u32(speed)]
    assert peer.written(0x6083) == [u32(ramp)]


@pytest.mark.parametrize(
    ("stated", "options"),
    [
        ({0x60A9: 0x00B44700}, {"speed_unit": "counts/s"}),
        ({0x60A9: 0x00B44700}, {}),  # rpm, and nobody knows the counts of a turn
        ({0x60A9: 0x00000100}, {}),  # no unit of speed
        ({0x60A9: 0x00B50300, 0x60AA: 0x00B55700}, {"acceleration_unit": "10 counts/s^2"}),
        ({0x60A9: 0x00B50300, 0x60AA: 0x00000100}, {}),  # no unit of acceleration
        ({0x60A8: 0xFA010000}, {"counts_per_mm": 900.0}),  # micrometres
    ],
)
def test_units_that_contradict_the_options_are_refused(
    bed: RailBed, peer: CanPeer, stated: dict[int, int], options: dict[str, object]
) -> None:
    peer.objects[DRIVE] |= {(index, 0): u32(value) for index, value in stated.items()}
    assert refusal(lambda: bed.connect(**options)).code == "HC-R54"


def test_each_make_has_one_profile() -> None:
    vendors = [each.vendor for each in vendor_profiles()]
    assert len(vendors) == len(set(vendors)) > 0
