"""Devices as they are sold: without some objects, or with objects that nobody may change."""

from __future__ import annotations

import struct

import pytest

from drivers.canopen.rail import CanopenRail
from drivers.canopen.sdo import Unsupported
from hilcell.ports import DeviceError, StripLost
from tests.drivers.canopen.can_peer import DRIVE, FAULT, NO_RTR, STRIP, CanPeer, u8, u16, u32
from tests.drivers.canopen.rail_bed import RailTime, connected, peer, rail_for, time
from tests.drivers.peers import refusal, soon

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


@pytest.mark.parametrize(
    ("held", "option", "left"),
    [(5_000, 2, 200_000), (200_000, 2, 200_000), (2_000_000, 2, 2_000_000), (None, 1, None)],
)
def test_a_quick_stop_is_at_least_as_steep_as_a_motion(
    peer: CanPeer, time: RailTime, held: int | None, option: int, left: int | None
) -> None:
    objects = peer.objects[DRIVE]
    del objects[0x6085, 0]
    if held is not None:
        objects[0x6085, 0] = u32(held)
    with connected(peer, time):
        assert (objects[0x605A, 0], objects[0x605E, 0]) == (u16(option), u16(option))
        assert objects.get((0x6085, 0)) == (left and u32(left))


def test_a_drive_that_knows_one_quick_stop_alone_is_taken(peer: CanPeer, time: RailTime) -> None:
    del peer.objects[DRIVE][0x6085, 0]
    peer.only[0x605A, 0] = u16(2)
    with connected(peer, time) as rail:
        assert peer.objects[DRIVE][0x605A, 0] == u16(2)
        works(rail)


def test_a_drive_that_will_not_brake_in_a_fault_is_taken(peer: CanPeer, time: RailTime) -> None:
    peer.read_only.add((0x605E, 0))
    with connected(peer, time) as rail:
        works(rail)


def test_a_quick_stop_that_stays_slow_is_named(peer: CanPeer, time: RailTime) -> None:
    peer.objects[DRIVE][0x6085, 0] = u32(5_000)
    peer.read_only.add((0x6085, 0))
    found = refusal(rail_for(peer, time).connect)
    assert str(found.fields["what"]).startswith("6085h:00 = 200000")


@pytest.mark.parametrize("node", [DRIVE, STRIP])
@pytest.mark.parametrize(("shortest_ms", "set_ms"), [(0, 50), (100, 100), (150, 200)])
def test_a_heartbeat_is_as_fast_as_the_node_can(
    peer: CanPeer, time: RailTime, node: int, shortest_ms: int, set_ms: int
) -> None:
    peer.shortest_beat_ms[node] = shortest_ms
    with connected(peer, time) as rail:
        assert peer.objects[node][0x1017, 0] == u16(set_ms)
        works(rail)


def test_a_heartbeat_that_is_too_slow_is_named(peer: CanPeer, time: RailTime) -> None:
    peer.shortest_beat_ms[DRIVE] = 500
    found = refusal(rail_for(peer, time).connect)
    assert str(found.fields["what"]).startswith("1017h:00 = 50")


@pytest.mark.parametrize(("fixed", "taken"), [(254, True), (0, False)])
def test_a_command_that_counts_at_once_in_the_makers_way_is_as_good(
    peer: CanPeer, time: RailTime, fixed: int, taken: bool
) -> None:
    peer.objects[DRIVE][0x1400, 2] = u8(fixed)
    peer.read_only.add((0x1400, 2))
    if taken:
        with connected(peer, time) as rail:
            works(rail)
    else:
        found = refusal(rail_for(peer, time).connect)
        assert str(found.fields["what"]).startswith("1400h:02 = 255")


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


@pytest.mark.parametrize("code", [0x08000022, None])
def test_an_error_that_cannot_be_asked_hides_no_fault(
    peer: CanPeer, time: RailTime, code: int | None
) -> None:
    if code is None:
        peer.ignore.add((0x603F, 0))
    else:
        peer.abort[0x603F, 0] = code
    with connected(peer, time) as rail:
        peer.axis.state = FAULT
        time.silence()
        found = refusal(lambda: rail.move_to(700.0))
        assert (found.code, found.fields["state"]) == ("HC-R27", "fault")
        assert "603Fh" in found.found


def test_a_drive_in_no_state_is_stopped_before_it_is_asked_why(
    peer: CanPeer, time: RailTime
) -> None:
    with connected(peer, time) as rail:
        asked: list[bool] = []

        def note(index: int) -> None:
            if index == 0x603F:
                asked.append(peer.quick_stopped.is_set())

        peer.on_read = note
        peer.axis.state = 0x6F  # none of CiA 402
        refusal(lambda: rail.move_to(700.0))
        assert asked[0]


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
        assert soon(lambda: rail._nodes[-1].sensor_fails)
        found = refusal(rail.settle)
        assert (type(found), found.fields["alarms"]) == (StripLost, 1)
        rail.move_to(800.0)  # no motion asks the strip
        emergency(peer, ERRORS_GONE, 0x21)  # another one is gone
        emergency(peer, ERRORS_GONE)
        assert soon(lambda: not rail._nodes[-1].sensor_fails)
        assert rail.settle().strip_mm == 800.0


@pytest.mark.parametrize("register", [0x21, 0x81, 0x01, 0x08])
@pytest.mark.parametrize("silent", [False, True])
def test_an_alarm_of_before_is_in_the_error_register(
    peer: CanPeer, time: RailTime, register: int, silent: bool
) -> None:
    """The makers choose its bits; a sensor may have 6503h and never tell a position error there."""
    if silent:
        peer.objects[STRIP][0x6504, 0] = u16(0x8000)
    else:
        peer.unmappable.add(0x6503)
    peer.objects[STRIP][0x1001, 0] = u8(register)
    with connected(peer, time) as rail:
        assert isinstance(refusal(rail.settle), StripLost)


@pytest.mark.parametrize("register", [0x00, 0x10, 0x11])
def test_a_heartbeat_that_was_missed_is_no_doubt_of_the_sensor(
    peer: CanPeer, time: RailTime, register: int
) -> None:
    peer.unmappable.add(0x6503)
    peer.objects[STRIP][0x1001, 0] = u8(register)
    with connected(peer, time) as rail:
        works(rail)


def test_one_of_several_errors_that_is_gone_leaves_the_sensor_in_doubt(
    peer: CanPeer, time: RailTime
) -> None:
    peer.unmappable.add(0x6503)
    with connected(peer, time) as rail:
        emergency(peer, SENSOR_FAULT, 0x81)
        assert soon(lambda: rail._nodes[-1].sensor_fails)
        emergency(peer, ERRORS_GONE, 0x81)
        peer.settle()
        assert isinstance(refusal(rail.settle), StripLost)


# -- homing -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("zero", "code"), [(62, ""), (-170, ""), (200, "HC-R35")])
def test_a_drive_may_stand_where_its_ramp_has_ended_behind_the_edge(
    peer: CanPeer, time: RailTime, zero: int, code: str
) -> None:
    """5 mm/s and 200 mm/s^2: 0.0625 mm; twice that and the window are allowed."""
    peer.axis.zero = zero
    with connected(peer, time) as rail:
        if code:
            assert refusal(rail.home).code == code
        else:
            rail.home()


@pytest.mark.parametrize(("looks", "code"), [(3, ""), (10**6, "HC-R35")])
def test_an_error_of_the_last_homing_counts_once_the_drive_has_had_its_time(
    peer: CanPeer, time: RailTime, looks: int, code: str
) -> None:
    with connected(peer, time) as rail:
        left = iter(range(looks))
        axis = peer.axis
        if code:
            axis.frozen = True

        def show() -> None:
            failed = axis.mode == 6 and next(left, None) is not None
            axis.bits = axis.bits & ~0x2000 | 0x2000 * failed

        peer.on_sync = show
        axis.mode, axis.bits = 6, 0x2000
        if code:
            assert refusal(rail.home).code == code
        else:
            rail.home()


# -- what keeps a drive from its power ----------------------------------------------------------


@pytest.mark.parametrize(
    ("supply", "word"), [(0x0200, "no voltage"), (0x0010, "obey the bus"), (0x0210, "lost frames")]
)
def test_a_drive_that_stays_without_power_says_why(
    peer: CanPeer, time: RailTime, supply: int, word: str
) -> None:
    with connected(peer, time) as rail:
        peer.axis.deaf, peer.axis.supply = True, supply
        time.silence()
        found = refusal(lambda: rail.move_to(700.0))
        assert found.code == "HC-R31"
        assert word in str(found)


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


@pytest.mark.parametrize(("inputs", "code"), [(0, ""), (2, "HC-R32"), (None, "HC-R32")])
def test_a_limit_of_current_in_mid_travel_is_no_switch(
    peer: CanPeer, time: RailTime, inputs: int | None, code: str
) -> None:
    if inputs is not None:
        peer.objects[DRIVE][0x60FD, 0] = u32(inputs)
    limited(peer, 1200.0, 1300.0)
    rail = stands(peer, time, 1000.0)
    if code:
        assert refusal(lambda: rail.move_to(1600.0)).code == code
    else:
        rail.move_to(1600.0)
    rail.close()


def test_after_a_stop_nothing_is_set_and_the_next_motion_says_so(
    peer: CanPeer, time: RailTime
) -> None:
    with connected(peer, time) as rail:
        rail.stop()
        assert refusal(lambda: rail.move_to(700.0)).code == "HC-R38"
        assert peer.written(0x6060) == []


@pytest.mark.parametrize(("lost", "ends"), [(1, False), (10**6, True)])
def test_a_mode_that_is_not_told_once_ends_no_motion(
    peer: CanPeer, time: RailTime, lost: int, ends: bool
) -> None:
    peer.unmappable.add(0x6061)
    with connected(peer, time) as rail:
        works(rail)
        left = iter(range(lost))

        def tamper(line: bytes) -> list[bytes]:
            about_mode = line.startswith(b"t5858") and line[7:11] == b"6160"
            return [] if about_mode and next(left, None) is not None else [line]

        peer.tamper = tamper
        time.silence(0.02)
        if ends:
            assert refusal(lambda: works(rail)).code in ("HC-R06", "HC-R39")
        else:
            works(rail)
            assert next(left, None) is None
