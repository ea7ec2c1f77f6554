"""Assets are known by kind and serial number."""

from msgspec.structs import replace

from hilcell.identity import Identity
from hilcell.journal.log import different_assets

ASSETS = [
    Identity(device="Rail", model="drive", serial="2014001", kind="drive"),
    Identity(device="Rail", model="strip", serial="2014002", kind="strip"),
    Identity(device="Robot", model="#KR210R2700_2 C4 FLR SIMULATED", serial="860112"),
]


def test_a_device_without_a_kind_is_of_its_name() -> None:
    assert [asset.kind for asset in ASSETS] == ["drive", "strip", "robot"]


def test_assets_differ_by_serial_number() -> None:
    first = ASSETS
    other = [replace(asset, address="elsewhere") for asset in ASSETS]
    assert different_assets(first, other) == []
    other[1] = replace(ASSETS[1], serial="7")
    assert different_assets(first, other) == [(first[1], other[1])]
    assert different_assets(first[:1], other[2:]) == []
