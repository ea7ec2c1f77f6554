"""Assets are known by kind and serial number, also those of journals without kinds."""

import pytest

from hilcell.journal.asset import asset_of, differing

# Devices of an old journal's event `connected`, as they are.
OLD = [
    ("drive", {
        "device": "Rail", "model": "drive vendor 0x484 product 0x402", "serial": "2014001",
        "address": "socket://127.0.0.1:46439 node 5", "simulated": True,
    }),
    ("strip", {
        "device": "Rail", "model": "strip vendor 0x484 product 0x406", "serial": "2014002",
        "address": "socket://127.0.0.1:46439 node 6", "simulated": True,
    }),
    ("robot", {
        "device": "Robot", "model": "#KR210R2700_2 C4 FLR SIMULATED", "serial": "860112",
        "address": "127.0.0.1:34249", "simulated": True,
    }),
    ("tracker", {
        "device": "Tracker", "model": "Leica AT401 (simulated), emScon 3.8.0",
        "serial": "402871", "address": "127.0.0.1:34251", "simulated": True,
    }),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "entry"), OLD)
def test_an_old_journals_devices_have_kinds(kind: str, entry: dict[str, object]) -> None:
    asset = asset_of(entry)
    assert (asset.kind, asset.model, asset.serial) == (kind, entry["model"], entry["serial"])
    assert (asset.maker, asset.firmware) == ("", "")


def test_a_kind_that_is_stated_counts() -> None:
    found = asset_of({"device": "Rail", "model": "drive", "kind": "strip", "maker": "M"})
    assert (found.kind, found.maker) == ("strip", "M")


def test_assets_differ_by_serial_number() -> None:
    first = [asset_of(entry) for _, entry in OLD]
    other = [asset_of(entry | {"address": "elsewhere"}) for _, entry in OLD]
    assert differing(first, other) == []
    other[1] = asset_of(OLD[1][1] | {"serial": "7"})
    assert differing(first, other) == [(first[1], other[1])]
    assert differing(first[:1], other[2:]) == []
