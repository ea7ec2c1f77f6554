"""What the rail's driver asks, sets and refuses before anything may move, and devices as sold:
without some objects, or with objects that are read-only.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable
from typing import Any

import pytest

from drivers.canopen.requirements import OPTIONAL_OF_DRIVE
from drivers.canopen.sdo import Unsupported
from hilcell.cell.settings import SettingsError, convert
from hilcell.ports import DeviceRefused, StripLost
from tests.drivers.canopen.can_peer import (
    DISABLED,
    DRIVE,
    ENABLED,
    FAULT,
    NO_RTR,
    STRIP,
    CanPeer,
    drive_objects,
    u8,
    u16,
    u32,
)
from tests.drivers.canopen.rail_bed import BedRail, RailBed
from tests.drivers.peers import Server, kind, refusal, soon

pytestmark = pytest.mark.waits

Key = tuple[int, int]
BEAT, START = (0x77F, b"\x05"), (0x000, b"\x01")
SENSOR_FAULT, ERRORS_GONE = 0x7305, 0x0000


class Objects(dict[Key, bytes]):
    """A node's objects, of which one does more than keep what is written."""

    def __init__(self, objects: dict[Key, bytes], key: Key) -> None:
        super().__init__(objects)
        self.key = key

    def __setitem__(self, key: Key, value: bytes) -> None:
        super().__setitem__(key, self.take(value) if key == self.key else value)

    def take(self, value: bytes) -> bytes:
        raise NotImplementedError


def works(rail: BedRail) -> None:
    rail.home()
    rail.move_to(700.0)
    assert rail.settle().position_mm == 700.0
    rail.hold()


def unsupported(connect: Callable[[], BedRail | None]) -> str:
    """Return the object, value and purpose that a refusal to connect names."""
    error = refusal(connect)
    assert kind(error) == (Unsupported, "HC-R09")
    return str(error.fields["what"])


def test_connect_writes_the_self_stop_and_the_mappings_and_moves_nothing(bed: RailBed) -> None:
    peer = bed.peer
    rail = bed.make()
    drive_identity, strip_identity = rail.connect()
    assert (drive_identity.kind, strip_identity.serial) == ("drive", "4711")
    assert peer.axis.position == 500_000
    assert peer.axis.state != ENABLED
    expected = {
        (0x1016, 1): u32(127 << 16 | 1000),
        (0x6007, 0): u16(3),
        (0x605A, 0): u16(2),
        (0x6098, 0): u8(17),
        (0x6081, 0): u32(250_000),
        (0x6083, 0): u32(200_000),
        (0x6084, 0): u32(200_000),
        (0x1A00, 1): u32(0x60410010),
        (0x1A00, 2): u32(0x60640020),
        (0x1A01, 1): u32(0x606C0020),
        (0x1A01, 2): u32(0x60610008),
        (0x1600, 1): u32(0x60400010),
        (0x1600, 2): u32(0x607A0020),
        (0x1800, 1): u32(NO_RTR | 0x185),
        (0x1400, 1): u32(NO_RTR | 0x205),
        (0x1800, 2): u8(1),
        (0x1801, 2): u8(1),
    }
    assert {key: peer.objects[DRIVE][key] for key in expected} == expected
    strip = peer.objects[STRIP]
    assert (strip[0x1A00, 1], strip[0x1A00, 2]) == (u32(0x60040020), u32(0x65030010))
    peer.beating.wait()
    assert peer.frames(0x77F)[0] == b"\x05"
    rail.close()


def test_a_pdo_is_off_while_it_is_mapped(bed: RailBed) -> None:
    """In the order of CiA 301, 7.5.2.36: strict devices refuse any other."""
    bed.peer.objects[DRIVE][0x1801, 1] = u32(NO_RTR | 0x123)
    bed.connect()
    written = [
        (
            *struct.unpack_from("<HB", data, 1),
            int.from_bytes(data[4 : 8 - (data[0] >> 2 & 3)], "little"),
        )
        for data in bed.peer.frames(0x600 + DRIVE)
        if data[0] & 0xE0 == 0x20
    ]
    assert [each for each in written if each[0] in (0x1801, 0x1A01)] == [
        (0x1801, 1, 1 << 31 | NO_RTR | 0x285),
        (0x1A01, 0, 0),
        (0x1A01, 1, 0x606C0020),
        (0x1A01, 2, 0x60610008),
        (0x1A01, 0, 2),
        (0x1801, 2, 1),
        (0x1801, 1, NO_RTR | 0x285),
    ]


@pytest.mark.parametrize(
    ("node", "key", "value", "named"),
    [
        (DRIVE, (0x1000, 0), u32(0x00020191), "0x191"),
        (DRIVE, (0x1018, 1), u32(1), "vendor"),
        (STRIP, (0x1018, 2), u32(1), "product"),
        (STRIP, (0x6005, 1), u32(5000), "6005h"),
        (STRIP, (0x6501, 0), u16(5000), "6501h"),
    ],
)
def test_another_device_is_refused(
    bed: RailBed, node: int, key: Key, value: bytes, named: str
) -> None:
    bed.peer.objects[node][key] = value
    with pytest.raises(DeviceRefused, match=named):
        bed.connect()


def test_a_plain_measuring_step_is_checked_and_may_be_absent(bed: RailBed) -> None:
    del bed.peer.objects[STRIP][0x6005, 1]
    bed.connect().close()
    bed.peer.objects[STRIP][0x6005, 0] = u32(5000)
    bed.peer.abort[0x6005, 1] = 0x06090011
    with pytest.raises(DeviceRefused, match="6005h"):
        bed.connect()


def test_a_node_may_lack_product_revision_and_serial_number(bed: RailBed) -> None:
    bed.peer.abort |= dict.fromkeys(((0x1018, 2), (0x1018, 3), (0x1018, 4)), 0x06090011)
    plain = {"drive_product": 0, "strip_product": 0}
    rail = bed.make(**plain)
    assert [each.serial for each in rail.connect()] == ["0", "0"]
    rail.close()
    error = refusal(bed.make(**plain, drive_serial=7).connect)
    assert (error.code, error.fields["found_value"]) == ("HC-R08", 0)


@pytest.mark.parametrize("garbage", [False, True])
def test_a_missing_node_is_named_with_the_losses_of_its_line(bed: RailBed, garbage: bool) -> None:
    bed.peer.ignore.add((0x1000, 0))
    if garbage:
        bed.peer.tamper = lambda line: [line[:-2] + b"?\r"]
    bed.time.silence()
    error = refusal(bed.connect)
    assert (error.code, error.fields["node"]) == ("HC-R05", DRIVE)
    assert ("bad lines" in error.found) is garbage


def test_time_stamps_of_another_form_are_named_with_their_line(bed: RailBed) -> None:
    bed.peer.tamper = lambda line: [line[:-1] + b"0123ABCD\r"]
    bed.time.silence()
    error = refusal(bed.connect)
    assert error.code == "HC-R05"
    assert "0123ABCD" in error.found
    assert "time stamps" in error.act


@pytest.mark.parametrize("frames", [0, 1, 2])
def test_a_gateway_that_hangs_up_while_connecting_is_reported(bed: RailBed, frames: int) -> None:
    def hangs_up(connection: socket.socket) -> None:
        received = 0
        while received < frames and (data := connection.recv(100)):
            received += data.count(b"t")
        connection.shutdown(socket.SHUT_RDWR)

    bed.time.silence()
    with Server(hangs_up) as server:
        error = refusal(lambda: bed.connect(channel=f"socket://127.0.0.1:{server.port}"))
    assert error.code in {"HC-R01", "HC-R04"}


def test_an_abort_is_reported_with_the_standards_text(bed: RailBed) -> None:
    bed.peer.abort[0x6007, 0] = 0x06010002
    error = refusal(bed.connect)
    assert (error.code, error.fields["abort_code"]) == ("HC-R09", 0x06010002)
    assert "Attempt to write a read" in error.found


def test_a_setting_that_reads_back_differently_is_refused(bed: RailBed) -> None:
    class Stubborn(Objects):
        def take(self, value: bytes) -> bytes:
            return u16(1)

    bed.peer.objects[DRIVE] = Stubborn(bed.peer.objects[DRIVE], (0x605A, 0))
    error = refusal(bed.connect)
    assert error.fields == {"node": DRIVE, "object": "605Ah:00", "read": 1, "written": 2}


@pytest.mark.parametrize("at", [(DRIVE, 0x1016, 1), (DRIVE, 0x1A00, 0), (STRIP, 0x1A00, 0)])
def test_a_drive_that_is_reset_while_nodes_are_set_up_is_named(
    bed: RailBed, at: tuple[int, int, int]
) -> None:
    class Resetting(Objects):
        def take(self, value: bytes) -> bytes:
            bed.peer.objects[DRIVE].update(drive_objects())  # its self-stop is gone, too
            bed.peer.send(0x705, b"\0")
            return value

    bed.peer.objects[at[0]] = Resetting(bed.peer.objects[at[0]], at[1:])
    error = refusal(bed.connect)
    assert (error.code, error.fields) == ("HC-R03", {"node": DRIVE})


# -- starting the nodes -----------------------------------------------------------------------


def misses_start(peer: CanPeer, monkeypatch: pytest.MonkeyPatch, nodes: list[int] | None) -> None:
    """Let nodes miss START: each number of ``nodes`` once, all of them always for None."""
    original, left = peer._frame, iter(nodes or [])

    def frame(cob_id: int, data: bytes) -> None:
        started = (cob_id, data[:1]) == START
        if not started or (nodes is not None and data[1] != next(left, None)):
            original(cob_id, data)

    monkeypatch.setattr(peer, "_frame", frame)


def test_a_node_that_stays_pre_operational_is_refused(
    bed: RailBed, monkeypatch: pytest.MonkeyPatch
) -> None:
    misses_start(bed.peer, monkeypatch, None)
    bed.time.silence()
    error = refusal(bed.connect)
    assert (error.code, error.fields["nodes"]) == ("HC-R10", [DRIVE, STRIP])


def test_start_is_repeated_while_a_node_is_set_up(
    bed: RailBed, monkeypatch: pytest.MonkeyPatch
) -> None:
    misses_start(bed.peer, monkeypatch, [DRIVE, STRIP, DRIVE])
    bed.time.silence()
    assert bed.connect().read().still


def test_the_first_heartbeat_goes_before_the_first_start(bed: RailBed) -> None:
    """A node that lost the last one goes back to pre-operational when START comes first."""
    bed.peer.lost_heartbeat.update((DRIVE, STRIP))
    bed.connect()
    services = [cob_id for cob_id, data in bed.peer.heard if (cob_id, data[:1]) in (BEAT, START)]
    assert services[0] == 0x77F
    assert services.count(0x000) == 2  # one START a node was enough


def test_a_node_that_leaves_operational_later_is_never_started_again(rail: BedRail) -> None:
    rail.peer.heard.clear()
    rail.peer.nmt[DRIVE] = 0x7F
    assert soon(lambda: rail._nodes[0].state == 0x7F)
    assert refusal(lambda: rail.move_to(600.0)).code == "HC-R03"
    assert rail.peer.frames(0x000) == []


def test_a_node_without_bit_30_keeps_it_cleared(bed: RailBed) -> None:
    bed.peer.demands_no_rtr = False
    bed.peer.objects[STRIP][0x1800, 1] = u32(0x80000186)
    bed.connect()
    assert bed.peer.objects[STRIP][0x1800, 1] == u32(0x186)


def test_an_old_fault_is_reset_and_nothing_enabled(bed: RailBed) -> None:
    bed.peer.axis.state = FAULT
    bed.connect()
    words = [struct.unpack("<Hi", data)[0] for data in bed.peer.frames(0x205)]
    assert 0x0080 in words
    assert 0x000F not in words
    assert bed.peer.axis.state == DISABLED


def test_a_fault_that_stays_is_reported(bed: RailBed, monkeypatch: pytest.MonkeyPatch) -> None:
    bed.peer.axis.state = FAULT
    monkeypatch.setattr(bed.peer.axis, "control", lambda word, target: None)
    bed.peer.objects[DRIVE][0x603F, 0] = u16(0x8611)
    assert refusal(bed.connect).fields == {"state": "fault", "error_code": 0x8611}


def test_a_slide_that_a_dead_engine_left_moving_is_braked_and_can_be_moved(bed: RailBed) -> None:
    peer = bed.peer
    peer.axis.state, peer.axis.steps, peer.axis.target = ENABLED, 1000, 900_000
    rail = bed.connect()
    assert peer.quick_stopped.is_set()
    rail.move_to(700.0)
    assert peer.axis.position == 700_000


@pytest.mark.parametrize(("homing_mm_s", "counts_s"), [(80.0, 80_000), (400.0, 250_000)])
def test_a_drive_homes_at_its_option_and_never_above_its_speed(
    bed: RailBed, homing_mm_s: float, counts_s: int
) -> None:
    bed.connect(homing_mm_s=homing_mm_s)
    assert bed.peer.objects[DRIVE][0x6099, 1] == u32(counts_s)


@pytest.mark.parametrize(
    ("changed", "key"),
    [
        ({"drive_node": 6}, "drive_node"),
        ({"travel_max_mm": -1.0}, "travel_min_mm"),
        ({"counts_per_mm": 1e9}, "32 bits"),
        ({"interface": "virtual"}, "interface"),
        ({"strip_counts": 1}, "strip_counts_per_mm"),
        ({"standstill_window_mm": 1000.0}, "standstill_window_mm"),
        ({"standstill_window_mm": 1e-9}, "standstill_window_mm"),
        ({"standstill_speed_mm_s": 1e9}, "standstill_speed_mm_s"),
        ({"standstill_dwell_s": 0.0001}, "standstill_dwell_s"),
    ],
)
def test_options_are_strict(changed: dict[str, Any], key: str) -> None:
    values = {
        "channel": "can0",
        "travel_min_mm": 0.0,
        "travel_max_mm": 3000.0,
        "speed_mm_s": 250.0,
        "acceleration_mm_s2": 200.0,
    }
    with pytest.raises(SettingsError, match=key):
        convert(values | changed, BedRail.Options, "rail")


# -- objects that a device lacks, or that are read-only ---------------------------------------


@pytest.mark.parametrize("code", [0x06020000, 0x06090011, 0x08000024])
@pytest.mark.parametrize("key", [(0x607C, 0), (0x6084, 0)])
def test_an_object_that_no_guard_needs_may_be_absent(bed: RailBed, key: Key, code: int) -> None:
    bed.peer.abort[key] = code
    works(bed.connect())


def test_all_optional_objects_of_the_table_may_be_absent_at_once(bed: RailBed) -> None:
    for index in OPTIONAL_OF_DRIVE:
        bed.peer.abort |= {(index, sub): 0x06020000 for sub in range(3)}
    bed.peer.abort |= {(0x1018, sub): 0x06090011 for sub in (2, 3, 4)}
    works(bed.connect(homing="absolute", drive_product=0, strip_product=0))


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
def test_a_missing_object_is_named_with_its_purpose(
    bed: RailBed, key: Key, what: str, code: int
) -> None:
    bed.peer.abort[key] = code
    error = refusal(bed.connect)
    assert (type(error), error.fields["abort_code"]) == (Unsupported, code)
    named = str(error.fields["what"])
    assert named.startswith(what)
    assert named.endswith(")")


@pytest.mark.parametrize("index", [0x6041, 0x6064, 0x606C, 0x6040, 0x607A, 0x6004])
def test_an_object_that_cannot_be_mapped_is_named(bed: RailBed, index: int) -> None:
    bed.peer.unmappable.add(index)
    assert f"{index:04X}h" in unsupported(bed.connect)


FIXED = {
    (0x1800, 1): u32(NO_RTR | 0x185),
    (0x1800, 2): u8(1),
    (0x1A00, 0): u8(2),
    (0x1A00, 1): u32(0x60410010),
    (0x1A00, 2): u32(0x60640020),
}


@pytest.mark.parametrize(
    ("values", "read_only", "refused"),
    [
        ({(0x605A, 0): u16(2)}, [(0x605A, 0)], ""),
        ({}, [(0x605E, 0)], ""),  # it need not brake in a fault
        ({(0x1400, 2): u8(254)}, [(0x1400, 2)], ""),  # acts at once, in the maker's manner
        (FIXED, [(0x1800, 1)], ""),
        (FIXED, [(0x1A00, 0)], ""),
        (FIXED, list(FIXED), ""),
        ({(0x605A, 0): u16(1)}, [(0x605A, 0)], "605Ah:00 = 2"),
        ({(0x6085, 0): u32(5_000)}, [(0x6085, 0)], "6085h:00 = 200000"),
        ({(0x1400, 2): u8(0)}, [(0x1400, 2)], "1400h:02 = 255"),
        (FIXED | {(0x1800, 1): u32(NO_RTR | 0x186)}, FIXED, "1800h"),
        (FIXED | {(0x1800, 1): u32(NO_RTR | 1 << 31 | 0x185)}, FIXED, "1800h"),
        (FIXED | {(0x1A00, 0): u8(1)}, FIXED, "1A00h"),
        (FIXED | {(0x1A00, 2): u32(0x606C0020)}, FIXED, "1A00h"),
    ],
)
def test_a_read_only_object_is_taken_where_its_value_is_right_and_named_elsewhere(
    bed: RailBed, values: dict[Key, bytes], read_only: list[Key], refused: str
) -> None:
    bed.peer.objects[DRIVE] |= values
    bed.peer.read_only.update(read_only)
    if refused:
        assert unsupported(bed.connect).startswith(refused)
    else:
        works(bed.connect())


@pytest.mark.parametrize(
    ("ramp", "option", "left"),
    [(5_000, 2, 200_000), (200_000, 2, 200_000), (2_000_000, 2, 2_000_000), (None, 1, None)],
)
def test_a_quick_stop_is_at_least_as_steep_as_a_motion(
    bed: RailBed, ramp: int | None, option: int, left: int | None
) -> None:
    objects = bed.peer.objects[DRIVE]
    del objects[0x6085, 0]
    if ramp is not None:
        objects[0x6085, 0] = u32(ramp)
    bed.connect()
    assert (objects[0x605A, 0], objects[0x605E, 0]) == (u16(option), u16(option))
    assert objects.get((0x6085, 0)) == (left and u32(left))


def test_a_drive_that_has_one_quick_stop_only_is_taken(bed: RailBed) -> None:
    del bed.peer.objects[DRIVE][0x6085, 0]
    bed.peer.only[0x605A, 0] = u16(2)
    works(bed.connect())
    assert bed.peer.objects[DRIVE][0x605A, 0] == u16(2)


@pytest.mark.parametrize("node", [DRIVE, STRIP])
@pytest.mark.parametrize(("shortest_ms", "set_ms"), [(0, 50), (100, 100), (150, 200)])
def test_a_heartbeat_is_as_fast_as_the_node_can(
    bed: RailBed, node: int, shortest_ms: int, set_ms: int
) -> None:
    bed.peer.shortest_beat_ms[node] = shortest_ms
    works(bed.connect())
    assert bed.peer.objects[node][0x1017, 0] == u16(set_ms)


def test_a_heartbeat_that_is_too_slow_is_named(bed: RailBed) -> None:
    bed.peer.shortest_beat_ms[DRIVE] = 500
    assert unsupported(bed.connect).startswith("1017h:00 = 50")


# -- the mode, and the cause of a fault -------------------------------------------------------


def test_a_mode_that_cannot_be_read_back_is_verified_by_its_display(bed: RailBed) -> None:
    bed.peer.write_only.add((0x6060, 0))
    works(bed.connect())
    assert bed.peer.axis.mode == 1


def test_a_mode_that_no_pdo_shows_is_read_by_sdo(bed: RailBed) -> None:
    bed.peer.unmappable.add(0x6061)
    rail = bed.connect()
    works(rail)
    asked = struct.pack("<BHB4x", 0x40, 0x6061, 0)
    before = bed.peer.frames(0x605).count(asked)
    rail.read()
    assert bed.peer.frames(0x605).count(asked) > before


@pytest.mark.parametrize(("lost", "ends"), [(1, False), (10**6, True)])
def test_a_mode_that_is_not_answered_once_ends_no_motion(
    bed: RailBed, lost: int, ends: bool
) -> None:
    bed.peer.unmappable.add(0x6061)
    rail = bed.connect()
    works(rail)
    left = iter(range(lost))

    def tamper(line: bytes) -> list[bytes]:
        about_mode = line.startswith(b"t5858") and line[7:11] == b"6160"
        return [] if about_mode and next(left, None) is not None else [line]

    bed.peer.tamper = tamper
    bed.time.silence(0.02)
    if ends:
        assert refusal(lambda: works(rail)).code in ("HC-R06", "HC-R39")
    else:
        works(rail)
        assert next(left, None) is None


def test_a_mode_that_a_drive_lacks_is_named(rail: BedRail) -> None:
    rail.peer.abort[0x6060, 0] = 0x06090030
    assert unsupported(rail.home).startswith("6060h = 6")


def test_a_fault_is_named_without_the_object_of_its_code(bed: RailBed) -> None:
    del bed.peer.objects[DRIVE][0x603F, 0]
    rail = bed.connect()
    bed.peer.axis.state = FAULT
    error = refusal(lambda: rail.move_to(700.0))
    assert (error.code, error.fields["error_code"]) == ("HC-R27", 0)


@pytest.mark.parametrize("code", [0x08000022, None])
def test_an_error_code_that_cannot_be_read_hides_no_fault(bed: RailBed, code: int | None) -> None:
    if code is None:
        bed.peer.ignore.add((0x603F, 0))
    else:
        bed.peer.abort[0x603F, 0] = code
    rail = bed.connect()
    bed.peer.axis.state = FAULT
    bed.time.silence()
    error = refusal(lambda: rail.move_to(700.0))
    assert (error.code, error.fields["state"]) == ("HC-R27", "fault")
    assert "603Fh" in error.found


def test_a_drive_in_no_state_is_stopped_before_it_is_asked_why(rail: BedRail) -> None:
    stopped: list[bool] = []

    def note(index: int) -> None:
        if index == 0x603F:
            stopped.append(rail.peer.quick_stopped.is_set())

    rail.peer.on_read = note
    rail.peer.axis.state = 0x6F  # none of CiA 402
    refusal(lambda: rail.move_to(700.0))
    assert stopped[0]


# -- a strip without an object for its alarms -------------------------------------------------


def emergency(peer: CanPeer, code: int, register: int = 0) -> None:
    peer.send(0x080 + STRIP, struct.pack("<HB5x", code, register))


def test_a_strip_without_alarms_in_its_pdo_has_them_in_its_emergencies(bed: RailBed) -> None:
    peer = bed.peer
    peer.unmappable.add(0x6503)
    rail = bed.connect()
    works(rail)
    emergency(peer, SENSOR_FAULT, 0x21)
    assert soon(lambda: rail._nodes[-1].sensor_fails)
    error = refusal(rail.settle)
    assert (type(error), error.fields["alarms"]) == (StripLost, 1)
    rail.move_to(800.0)  # no motion asks the strip
    emergency(peer, ERRORS_GONE, 0x21)  # another one is gone
    peer.settle()
    assert isinstance(refusal(rail.settle), StripLost)
    emergency(peer, ERRORS_GONE)
    assert soon(lambda: not rail._nodes[-1].sensor_fails)
    assert rail.settle().strip_mm == 800.0


@pytest.mark.parametrize("register", [0x21, 0x81, 0x01, 0x08])
@pytest.mark.parametrize("silent", [False, True])
def test_an_earlier_alarm_is_in_the_error_register(
    bed: RailBed, register: int, silent: bool
) -> None:
    """The makers choose its bits; a sensor may have 6503h and never set a position error there."""
    if silent:
        bed.peer.objects[STRIP][0x6504, 0] = u16(0x8000)
    else:
        bed.peer.unmappable.add(0x6503)
    bed.peer.objects[STRIP][0x1001, 0] = u8(register)
    assert isinstance(refusal(bed.connect().settle), StripLost)


@pytest.mark.parametrize("register", [0x00, 0x10, 0x11])
def test_a_missed_heartbeat_is_no_error_of_the_sensor(bed: RailBed, register: int) -> None:
    bed.peer.unmappable.add(0x6503)
    bed.peer.objects[STRIP][0x1001, 0] = u8(register)
    works(bed.connect())


# -- homing, and limit switches ---------------------------------------------------------------


@pytest.mark.parametrize(("zero", "allowed"), [(62, True), (-170, True), (200, False)])
def test_a_homed_drive_may_be_off_by_its_ramp_behind_the_edge(
    rail: BedRail, zero: int, allowed: bool
) -> None:
    """5 mm/s and 200 mm/s^2: 0.0625 mm; twice that and the window are allowed."""
    rail.peer.axis.zero = zero
    if allowed:
        rail.home()
    else:
        assert refusal(rail.home).code == "HC-R35"


@pytest.mark.parametrize(("polls", "stays"), [(3, False), (10**6, True)])
def test_an_error_of_the_last_homing_counts_once_the_drive_has_had_its_time(
    rail: BedRail, polls: int, stays: bool
) -> None:
    left, axis = iter(range(polls)), rail.peer.axis
    axis.frozen = stays

    def show() -> None:
        failed = axis.mode == 6 and next(left, None) is not None
        axis.bits = axis.bits & ~0x2000 | 0x2000 * failed

    rail.peer.on_sync = show
    axis.mode, axis.bits = 6, 0x2000
    if stays:
        assert refusal(rail.home).code == "HC-R35"
    else:
        rail.home()


def limited(peer: CanPeer, lowest_mm: float, highest_mm: float) -> None:
    """Let status bit 11 be set while the slide is between these places."""
    axis, original = peer.axis, peer.axis.step

    def step() -> None:
        original()
        inside = lowest_mm <= axis.position / 1000.0 <= highest_mm
        axis.bits = axis.bits | 0x800 if inside else axis.bits & ~0x800

    vars(axis).update(step=step)


def test_homing_ends_on_the_switch_and_the_next_motion_leaves_it(bed: RailBed) -> None:
    limited(bed.peer, -1.0, 3.0)
    works(bed.connect())


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
    bed: RailBed, inputs: int | None, at_mm: float, target_mm: float, allowed: bool
) -> None:  # fmt: skip
    peer = bed.peer
    if inputs is not None:
        peer.objects[DRIVE][0x60FD, 0] = u32(inputs)
    limited(peer, at_mm - 3.0, at_mm + 3.0)
    peer.axis.position = round(1000.0 * at_mm)
    rail = bed.connect()
    if allowed:
        rail.move_to(target_mm)
        assert peer.axis.position == round(1000.0 * target_mm)
    else:
        error = refusal(lambda: rail.move_to(target_mm))
        assert (error.code, error.fields["position_mm"]) == ("HC-R32", at_mm)
        assert 0x1F not in [struct.unpack("<Hi", data)[0] for data in peer.frames(0x205)]


def test_a_limit_that_stays_when_the_switch_is_left_is_another_one(bed: RailBed) -> None:
    limited(bed.peer, 0.0, 3000.0)
    bed.peer.axis.position = 0
    rail = bed.connect()
    error = refusal(lambda: rail.move_to(600.0))
    assert error.code == "HC-R32"
    assert 20.0 < float(str(error.fields["position_mm"])) < 600.0
    refusal(lambda: rail.move_to(600.0))


@pytest.mark.parametrize(("inputs", "allowed"), [(0, True), (2, False), (None, False)])
def test_a_limit_of_current_in_mid_travel_is_no_switch(
    bed: RailBed, inputs: int | None, allowed: bool
) -> None:
    if inputs is not None:
        bed.peer.objects[DRIVE][0x60FD, 0] = u32(inputs)
    limited(bed.peer, 1200.0, 1300.0)
    bed.peer.axis.position = 1_000_000
    rail = bed.connect()
    if allowed:
        rail.move_to(1600.0)
    else:
        assert refusal(lambda: rail.move_to(1600.0)).code == "HC-R32"
