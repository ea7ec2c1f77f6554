"""Devices as they are sold: without some objects, or with objects that nobody may change."""

from __future__ import annotations

import struct

import pytest

from drivers.canopen.rail import CanopenRail
from drivers.canopen.sdo import Unsupported
from hilcell.ports import DeviceError, StripLost
from tests.drivers.can_peer import DRIVE, FAULT, NO_RTR, STRIP, CanPeer, u8, u16, u32
from tests.drivers.rail_bed import RailTime, connected, peer, rail_for, refusal, soon, time

pytestmark = pytest.mark.waits

__all__ = ["peer", "time"]

Key = tuple[int, int]
SENSOR_FAULT, ERRORS_GONE = 0x7305, 0x0000


def works(rail: CanopenRail) -> None:
    rail.home()
    rail.move_to(700.0)
    assert rail.settle().position_mm == 700.0
    rail.hold()


@pytest.mark.parametrize("code", [0x06020000, 0x06090011, 0x08000024])
@pytest.mark.parametrize("key", [(0x607C, 0), (0x6084, 0), (0x609A, 0), (0x6067, 0), (0x606F, 0)])
def test_what_no_guard_needs_may_be_absent(
    peer: CanPeer, time: RailTime, key: Key, code: int
) -> None:
    peer.abort[key] = code
    with connected(peer, time) as rail:
        works(rail)


def test_a_node_without_product_revision_and_serial_number_is_one_all_the_same(
    peer: CanPeer, time: RailTime
) -> None:
    peer.abort |= dict.fromkeys(((0x1018, 2), (0x1018, 3), (0x1018, 4)), 0x06090011)
    plain = {"drive_product": 0, "strip_product": 0}
    rail = rail_for(peer, time, **plain)
    assert [each.serial for each in rail.connect()] == ["0", "0"]
    rail.close()
    found = refusal(rail_for(peer, time, **plain, drive_serial=7).connect)
    assert (found.code, found.fields["found_value"]) == ("HC-R08", 0)


@pytest.mark.parametrize(
    ("key", "what"),
    [
        ((0x1016, 1), "1016h:01"),
        ((0x1017, 0), "1017h:00"),
        ((0x6007, 0), "6007h:00 = 3"),
        ((0x605A, 0), "605Ah:00 = 2"),
        ((0x6081, 0), "6081h:00"),
        ((0x6083, 0), "6083h:00"),
        ((0x6098, 0), "6098h:00 = 17"),
        ((0x6099, 1), "6099h:01"),
        ((0x6099, 2), "6099h:02"),
        ((0x1400, 1), "1400h"),
        ((0x1801, 1), "1801h"),
        ((0x1800, 2), "1800h:02"),
    ],
)
@pytest.mark.parametrize("code", [0x06020000, 0x06010002, 0x06090030])
def test_what_is_needed_is_named_with_its_purpose(
    peer: CanPeer, time: RailTime, key: Key, what: str, code: int
) -> None:
    peer.abort[key] = code
    found = refusal(rail_for(peer, time).connect)
    assert isinstance(found, Unsupported)
    assert (found.code, found.fields["abort_code"]) == ("HC-R09", code)
    named = str(found.fields["what"])
    assert named.startswith(what)
    assert named.endswith(")")


@pytest.mark.parametrize("unmappable", [0x6041, 0x6064, 0x606C, 0x6040, 0x607A, 0x6004])
def test_what_cannot_be_mapped_is_named(peer: CanPeer, time: RailTime, unmappable: int) -> None:
    peer.unmappable.add(unmappable)
    found = refusal(rail_for(peer, time).connect)
    assert isinstance(found, Unsupported)
    assert f"{unmappable:04X}h" in str(found.fields["what"])


@pytest.mark.parametrize(("held", "taken"), [(2, True), (1, False)])
def test_a_setting_that_is_read_only_counts_where_it_is_right(
    peer: CanPeer, time: RailTime, held: int, taken: bool
) -> None:
    peer.objects[DRIVE][0x605A, 0] = u16(held)
    peer.read_only.add((0x605A, 0))
    if taken:
        with connected(peer, time) as rail:
            works(rail)
    else:
        assert isinstance(refusal(rail_for(peer, time).connect), Unsupported)


FIXED = {
    (0x1800, 1): u32(NO_RTR | 0x185),
    (0x1800, 2): u8(1),
    (0x1A00, 0): u8(2),
    (0x1A00, 1): u32(0x60410010),
    (0x1A00, 2): u32(0x60640020),
}


@pytest.mark.parametrize("keys", [[(0x1800, 1)], [(0x1A00, 0)], list(FIXED)])
def test_a_pdo_that_is_fixed_counts_where_it_is_right(
    peer: CanPeer, time: RailTime, keys: list[Key]
) -> None:
    peer.objects[DRIVE] |= FIXED
    peer.read_only.update(keys)
    with connected(peer, time) as rail:
        works(rail)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ((0x1800, 1), u32(NO_RTR | 0x186)),
        ((0x1800, 1), u32(NO_RTR | 1 << 31 | 0x185)),
        ((0x1A00, 0), u8(1)),
        ((0x1A00, 2), u32(0x606C0020)),
    ],
)
def test_a_pdo_that_is_fixed_and_another_is_named(
    peer: CanPeer, time: RailTime, key: Key, value: bytes
) -> None:
    peer.objects[DRIVE] |= FIXED | {key: value}
    peer.read_only.update(FIXED)
    found = refusal(rail_for(peer, time).connect)
    assert isinstance(found, Unsupported)
    assert str(found.fields["what"]).startswith(("1800h", "1A00h"))


# -- the mode ---------------------------------------------------------------------------------


def test_a_mode_that_cannot_be_read_back_is_proven_by_what_is_shown(
    peer: CanPeer, time: RailTime
) -> None:
    peer.write_only.add((0x6060, 0))
    with connected(peer, time) as rail:
        works(rail)
        assert peer.axis.mode == 1


def test_a_mode_that_no_pdo_shows_is_asked_for(peer: CanPeer, time: RailTime) -> None:
    peer.unmappable.add(0x6061)
    with connected(peer, time) as rail:
        works(rail)
        asked = struct.pack("<BHB4x", 0x40, 0x6061, 0)
        before = peer.frames(0x605).count(asked)
        rail.read()
        assert peer.frames(0x605).count(asked) > before


def test_a_mode_that_a_drive_lacks_is_named(peer: CanPeer, time: RailTime) -> None:
    with connected(peer, time) as rail:
        peer.abort[0x6060, 0] = 0x06090030
        found = refusal(rail.home)
        assert isinstance(found, Unsupported)
        assert str(found.fields["what"]).startswith("6060h = 6")


def test_a_fault_is_named_without_the_object_of_its_code(peer: CanPeer, time: RailTime) -> None:
    del peer.objects[DRIVE][0x603F, 0]
    with connected(peer, time) as rail:
        peer.axis.state = FAULT
        found = refusal(lambda: rail.move_to(700.0))
        assert (found.code, found.fields["error_code"]) == ("HC-R27", 0)


# -- a strip without an object for its alarms -------------------------------------------------


def emergency(peer: CanPeer, code: int, register: int = 0) -> None:
    peer.send(0x080 + STRIP, struct.pack("<HB5x", code, register))


def test_a_strip_without_alarms_in_its_pdo_has_them_in_its_emergencies(
    peer: CanPeer, time: RailTime
) -> None:
    peer.unmappable.add(0x6503)
    with connected(peer, time) as rail:
        works(rail)
        emergency(peer, SENSOR_FAULT, 0x21)
        assert soon(lambda: rail._watches[-1].sensor_fails)
        found = refusal(rail.settle)
        assert (type(found), found.fields["alarms"]) == (StripLost, 1)
        rail.move_to(800.0)  # no motion asks the strip
        emergency(peer, ERRORS_GONE, 0x21)  # another one is gone
        emergency(peer, ERRORS_GONE)
        assert soon(lambda: not rail._watches[-1].sensor_fails)
        assert rail.settle().strip_mm == 800.0


def test_an_alarm_of_before_is_in_the_error_register(peer: CanPeer, time: RailTime) -> None:
    peer.unmappable.add(0x6503)
    peer.objects[STRIP][0x1001, 0] = u8(0x21)
    with connected(peer, time) as rail:
        assert isinstance(refusal(rail.settle), StripLost)


# -- limits -----------------------------------------------------------------------------------


def limited(peer: CanPeer, lowest_mm: float, highest_mm: float) -> None:
    """Let status bit 11 be set while the slide stands between these places."""

    axis, original = peer.axis, peer.axis.step

    def step() -> None:
        original()
        inside = lowest_mm <= axis.position / 1000.0 <= highest_mm
        axis.bits = axis.bits | 0x800 if inside else axis.bits & ~0x800

    vars(axis).update(step=step)


def starts(peer: CanPeer) -> int:
    """Return how many motions were started."""
    return sum(struct.unpack("<Hi", data)[0] == 0x1F for data in peer.frames(0x205))


def stands(peer: CanPeer, time: RailTime, at_mm: float) -> CanopenRail:
    peer.axis.position = round(1000.0 * at_mm)
    rail = rail_for(peer, time)
    rail.connect()
    return rail


def test_homing_ends_on_the_switch_and_the_next_motion_leaves_it(
    peer: CanPeer, time: RailTime
) -> None:
    limited(peer, -1.0, 3.0)
    with connected(peer, time) as rail:
        works(rail)


@pytest.mark.parametrize(
    ("inputs", "at_mm", "target_mm", "allowed"),
    [
        (None, 2.0, 600.0, True),
        (None, 2.0, 0.0, False),
        (None, 2.0, 2.0, True),
        (None, 2995.0, 2500.0, True),
        (None, 2995.0, 3000.0, False),
        (None, 1500.0, 1400.0, False),  # nothing says which one it is
        (2, 1500.0, 1400.0, True),
        (2, 1500.0, 1600.0, False),
        (1, 1500.0, 1600.0, True),
        (3, 1500.0, 1600.0, False),
        (0, 2.0, 600.0, True),
    ],
)
def test_a_motion_away_from_a_switch_is_allowed_and_one_towards_it_never_starts(
    peer: CanPeer,
    time: RailTime,
    inputs: int | None,
    at_mm: float,
    target_mm: float,
    allowed: bool,
) -> None:
    if inputs is not None:
        peer.objects[DRIVE][0x60FD, 0] = u32(inputs)
    limited(peer, at_mm - 3.0, at_mm + 3.0)
    rail = stands(peer, time, at_mm)
    if allowed:
        rail.move_to(target_mm)
        assert peer.axis.position == round(1000.0 * target_mm)
    else:
        found = refusal(lambda: rail.move_to(target_mm))
        assert (found.code, found.fields["position_mm"]) == ("HC-R32", at_mm)
        assert starts(peer) == 0
    rail.close()


def test_a_limit_that_stays_when_the_switch_is_left_is_another_one(
    peer: CanPeer, time: RailTime
) -> None:
    limited(peer, 0.0, 3000.0)
    rail = stands(peer, time, 0.0)
    found = refusal(lambda: rail.move_to(600.0))
    assert found.code == "HC-R32"
    assert 20.0 < float(str(found.fields["position_mm"])) < 600.0
    with pytest.raises(DeviceError):
        rail.move_to(600.0)
    rail.close()
