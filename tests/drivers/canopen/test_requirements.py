"""What a device has, has not, and does not let be written, before anything is switched on."""

import pytest

from drivers.canopen import requirements
from drivers.canopen.requirements import DRIVE as OBJECTS
from hilcell.ports import Ability
from tests.drivers.canopen.can_peer import DISABLED, DRIVE, ENABLED, FAULT, READY, CanPeer, u16, u32
from tests.drivers.canopen.rail_bed import RailBed


def ability(found: list[Ability], feature: str) -> tuple[str, str]:
    (row,) = (each for each in found if each.device == "Drive" and each.feature.startswith(feature))
    return row.state, row.note


@pytest.mark.parametrize(
    ("index", "value", "state", "note"),
    [
        (0x6081, None, "read only", "0x0"),
        (0x605E, None, "read only", "0x0"),
        (0x6007, 3, "read only", "0x3"),
        (0x6007, 1, "has not", "read only at 0x1"),
        (0x605A, 1, "read only", "0x1"),
        (0x605A, 6, "has not", "read only at 0x6"),
    ],
)
def test_a_setting_that_cannot_be_written_is_named(
    bed: RailBed, peer: CanPeer, index: int, value: int | None, state: str, note: str
) -> None:
    if value is not None:
        peer.objects[DRIVE][index, 0] = u16(value)
    peer.read_only.add((index, 0))
    assert ability(bed.make().inspect(), f"{index:04X}h") == (state, note)


def test_a_value_out_of_range_is_not_read_only(bed: RailBed, peer: CanPeer) -> None:
    peer.only[0x6081, 0] = u32(7)
    assert ability(bed.make().inspect(), "6081h") == ("has", "0x0")


@pytest.mark.parametrize(
    ("state", "asked"), [(DISABLED, True), (FAULT, True), (READY, False), (ENABLED, False)]
)
def test_settings_are_written_back_only_while_nothing_has_power(
    bed: RailBed, peer: CanPeer, state: int, asked: bool
) -> None:
    peer.axis.state = state
    before = dict(peer.objects[DRIVE])
    bed.make().inspect()
    written = {each.index for each in OBJECTS if peer.written(each.index)}
    settings = {each.index for each in OBJECTS if each.setting and (each.index, 0) in before}
    assert written >= settings if asked else not written
    assert not written - {each.index for each in OBJECTS if each.setting}
    shown = {(index, 0) for index in (0x6041, 0x6061, 0x6064, 0x606C)}
    assert {k: v for k, v in peer.objects[DRIVE].items() if k not in shown} == before
    assert not peer.frames(0x205)
    assert not peer.frames(0x000)


def test_words_and_targets_are_no_settings() -> None:
    never = {0x6040, 0x607A, 0x6060, 0x1400, 0x1800, 0x1801}
    assert not never & {each.index for each in requirements.DRIVE if each.setting}
