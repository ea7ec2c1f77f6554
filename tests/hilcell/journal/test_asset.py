"""Assets are known by kind and serial number."""

from hilcell.journal.asset import asset_of, differing

ENTRIES = [
    {"device": "Rail", "model": "drive", "serial": "2014001", "kind": "drive"},
    {"device": "Rail", "model": "strip", "serial": "2014002", "kind": "strip"},
    {"device": "Robot", "model": "#KR210R2700_2 C4 FLR SIMULATED", "serial": "860112"},
]


def test_a_device_without_a_kind_is_of_its_name() -> None:
    assert [asset_of(entry).kind for entry in ENTRIES] == ["drive", "strip", "robot"]


def test_assets_differ_by_serial_number() -> None:
    first = [asset_of(entry) for entry in ENTRIES]
    other = [asset_of(entry | {"address": "elsewhere"}) for entry in ENTRIES]
    assert differing(first, other) == []
    other[1] = asset_of(ENTRIES[1] | {"serial": "7"})
    assert differing(first, other) == [(first[1], other[1])]
    assert differing(first[:1], other[2:]) == []
