from __future__ import annotations

import contextlib
import struct
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from drivers import drive, node_watch, pdo, rail_canopen, rail_setup, sdo
from drivers.rail_canopen import CanopenRail
from hilcell.clock import WallClock
from hilcell.ports import DeviceError, DeviceRefused, LinkStatistics, Rail, Stopped
from tests.drivers import can_peer
from tests.drivers.can_peer import (
    DRIVE,
    ENABLED,
    FAULT,
    NO_RTR,
    STRIP,
    CanPeer,
    drive_objects,
    u16,
    u32,
)
from tests.drivers.peers import wall_clock


@pytest.fixture(autouse=True)
def short_deadlines(monkeypatch: pytest.MonkeyPatch) -> None:
    for module, name, value in (
        (drive, "STALL_S", 0.3),
        (drive, "POLL_S", 0.002),
        (rail_canopen, "POLL_S", 0.002),
        (rail_canopen, "SETTLE_S", 0.3),
        (rail_setup, "OPERATIONAL_S", 0.5),
        (rail_setup, "START_PERIOD_S", 0.1),
        (rail_canopen, "RELEASE_S", 0.5),
        (rail_setup, "FIND_S", 0.5),
        (pdo, "REPLY_S", 0.1),
        (node_watch, "HEARTBEAT_AGE_S", 0.6),
        (sdo, "REPLY_S", 0.1),
        (sdo, "LATE_S", 0.15),
    ):
        monkeypatch.setattr(module, name, value)


def rail_for(peer: CanPeer, clock: WallClock | None = None, **options: Any) -> CanopenRail:
    values: dict[str, Any] = {
        "channel": peer.channel,
        "travel_min_mm": 0.0,
        "travel_max_mm": 3000.0,
        "speed_mm_s": 250.0,
        "acceleration_mm_s2": 200.0,
        "standstill_dwell_s": 0.01,
    }
    return CanopenRail(CanopenRail.Options(**(values | options)), clock or wall_clock())


BEAT, START = (0x77F, b"\x05"), (0x000, b"\x01")


@pytest.fixture
def peer() -> Iterator[CanPeer]:
    with CanPeer() as peer:
        yield peer


@pytest.fixture
def rail(peer: CanPeer) -> Iterator[CanopenRail]:
    rail = rail_for(peer)
    rail.connect()
    yield rail
    with contextlib.suppress(DeviceError):  # some tests have killed the link
        rail.close()


# -- connecting -------------------------------------------------------------------------------


def test_connect_tells_who_answered_and_moves_nothing(peer: CanPeer) -> None:
    rail = rail_for(peer)
    drive_identity, strip_identity = rail.connect()
    assert drive_identity.model == "drive vendor 0x484 product 0x402"
    assert strip_identity.serial == "4711"
    assert peer.axis.position == 500_000
    assert peer.axis.state != ENABLED
    rail.close()


def test_connect_writes_the_self_stop_and_the_mappings(rail: CanopenRail, peer: CanPeer) -> None:
    objects = peer.objects[DRIVE]
    assert objects[0x1016, 1] == u32(127 << 16 | 1000)
    assert objects[0x6007, 0] == u16(3)
    assert objects[0x605A, 0] == u16(2)
    assert objects[0x6098, 0] == bytes((17,))
    assert objects[0x6081, 0] == u32(250_000)
    assert objects[0x6083, 0] == objects[0x6084, 0] == u32(200_000)
    assert (objects[0x1A00, 1], objects[0x1A00, 2]) == (u32(0x60410010), u32(0x60640020))
    assert (objects[0x1A01, 1], objects[0x1A01, 2]) == (u32(0x606C0020), u32(0x60610008))
    assert (objects[0x1600, 1], objects[0x1600, 2]) == (u32(0x60400010), u32(0x607A0020))
    assert objects[0x1800, 1] == u32(NO_RTR | 0x185)
    assert objects[0x1400, 1] == u32(NO_RTR | 0x205)
    assert objects[0x1800, 2] == objects[0x1801, 2] == b"\x01"
    strip = peer.objects[STRIP]
    assert (strip[0x1A00, 1], strip[0x1A00, 2]) == (u32(0x60040020), u32(0x65030010))
    assert peer.beating.wait(5)
    assert peer.frames(0x77F)[0] == b"\x05"


@pytest.mark.parametrize(
    ("node", "key", "value", "message"),
    [
        (DRIVE, (0x1000, 0), u32(0x00020191), r"device profile \(1000h\) is 0x191, wanted 0x192"),
        (DRIVE, (0x1018, 1), u32(1), r"vendor \(1018h:01\) is 0x1, wanted 0x484"),
        (STRIP, (0x1018, 2), u32(1), r"node 6 \(strip\): product"),
        (STRIP, (0x6005, 1), u32(5000), r"strip step \(6005h\) is 5000 nm, wanted 10000 nm"),
        (STRIP, (0x6501, 0), u16(5000), r"strip step \(6501h\) is 5000 nm"),
    ],
)
def test_another_device_is_refused(
    peer: CanPeer, node: int, key: tuple[int, int], value: bytes, message: str
) -> None:
    peer.objects[node][key] = value
    with pytest.raises(DeviceRefused, match=message):
        rail_for(peer).connect()


def test_another_serial_is_refused(peer: CanPeer) -> None:
    with pytest.raises(DeviceRefused, match="serial"):
        rail_for(peer, drive_serial=1).connect()


def test_a_plain_measuring_step_is_understood(peer: CanPeer) -> None:
    del peer.objects[STRIP][0x6005, 1]
    peer.objects[STRIP][0x6005, 0] = u32(5000)
    peer.abort[0x6005, 1] = 0x06090011
    with pytest.raises(DeviceRefused, match=r"\(6005h\) is 5000 nm"):
        rail_for(peer).connect()


def test_an_absent_measuring_step_is_no_fault(peer: CanPeer) -> None:
    del peer.objects[STRIP][0x6005, 1]
    rail = rail_for(peer)
    rail.connect()
    rail.close()


def test_a_missing_node_is_named(peer: CanPeer) -> None:
    peer.ignore.add((0x1000, 0))
    with pytest.raises(DeviceError, match=r"node 5 \(drive\) does not answer"):
        rail_for(peer).connect()


def test_an_abort_is_told_in_the_standards_words(peer: CanPeer) -> None:
    peer.abort[0x6007, 0] = 0x06010002
    with pytest.raises(
        DeviceError, match="6007h:00: SDO abort 0x06010002, Attempt to write a read"
    ):
        rail_for(peer).connect()


def test_a_setting_that_does_not_hold_is_refused(peer: CanPeer) -> None:
    class Stubborn(dict[tuple[int, int], bytes]):
        def __setitem__(self, key: tuple[int, int], value: bytes) -> None:
            super().__setitem__(key, u16(1) if key == (0x605A, 0) else value)

    peer.objects[DRIVE] = Stubborn(peer.objects[DRIVE])
    with pytest.raises(DeviceError, match=r"write 605Ah:00: reads back as 1, wanted 2"):
        rail_for(peer).connect()


@pytest.mark.parametrize("at", [(DRIVE, 0x1016, 1), (DRIVE, 0x1A00, 0), (STRIP, 0x1A00, 0)])
def test_a_drive_that_is_reset_while_nodes_are_set_up_is_named(
    peer: CanPeer, at: tuple[int, int, int]
) -> None:
    class Watched(dict[tuple[int, int], bytes]):
        def __setitem__(self, key: tuple[int, int], value: bytes) -> None:
            super().__setitem__(key, value)
            if key == at[1:]:
                peer.objects[DRIVE].update(drive_objects())  # its self-stop is gone, too
                peer.send(0x705, b"\0")

    peer.objects[at[0]] = Watched(peer.objects[at[0]])
    with pytest.raises(DeviceError, match="node 5: unexpected boot-up: the node was reset"):
        rail_for(peer).connect()


def test_a_node_that_stays_pre_operational_is_refused(
    peer: CanPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = peer._frame

    def frame(cob_id: int, data: bytes) -> None:
        if (cob_id, data[:1]) != (0, b"\1"):
            original(cob_id, data)

    monkeypatch.setattr(peer, "_frame", frame)
    with pytest.raises(
        DeviceError, match=r"node 5 is pre-operational \(0x7F\), node 6 is .*wanted operational"
    ):
        rail_for(peer).connect()


def test_the_first_heartbeat_goes_before_the_first_start(peer: CanPeer) -> None:
    """A node that lost the last one goes back to pre-operational when START comes first."""
    peer.lost_heartbeat.update((DRIVE, STRIP))
    rail = rail_for(peer)
    rail.connect()
    services = [cob_id for cob_id, data in peer.heard if (cob_id, data[:1]) in (BEAT, START)]
    assert services[0] == 0x77F
    assert services.count(0x000) == 2  # one START a node was enough
    rail.close()


def test_start_is_repeated_while_a_node_is_set_up(
    peer: CanPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    deaf = iter((DRIVE, STRIP, DRIVE))
    original = peer._frame

    def frame(cob_id: int, data: bytes) -> None:
        if (cob_id, data[:1]) != START or data[1] != next(deaf, None):
            original(cob_id, data)

    monkeypatch.setattr(peer, "_frame", frame)
    rail = rail_for(peer)
    rail.connect()
    assert rail.read().still
    rail.close()


def test_a_node_that_leaves_operational_later_is_never_started_again(
    rail: CanopenRail, peer: CanPeer
) -> None:
    peer.heard.clear()
    peer.nmt[DRIVE] = 0x7F
    assert _soon(lambda: rail._watches[0].state == 0x7F)
    with pytest.raises(DeviceError, match=r"node 5: NMT state pre-operational \(0x7F\)"):
        rail.move_to(600.0)
    assert peer.frames(0x000) == []


def test_a_node_without_bit_30_keeps_it_cleared(peer: CanPeer) -> None:
    peer.demands_no_rtr = False
    peer.objects[STRIP][0x1800, 1] = u32(0x80000186)
    rail = rail_for(peer)
    rail.connect()
    assert peer.objects[STRIP][0x1800, 1] == u32(0x186)
    rail.close()


def test_an_old_fault_is_reset_and_nothing_enabled(peer: CanPeer) -> None:
    peer.axis.state = FAULT
    rail = rail_for(peer)
    rail.connect()
    words = [struct.unpack("<Hi", data)[0] for data in peer.frames(0x205)]
    assert 0x0080 in words
    assert 0x000F not in words
    assert peer.axis.state == can_peer.DISABLED
    rail.close()


def test_a_fault_that_stays_is_told(peer: CanPeer, monkeypatch: pytest.MonkeyPatch) -> None:
    peer.axis.state = FAULT
    monkeypatch.setattr(peer.axis, "control", lambda word, target: None)
    peer.objects[DRIVE][0x603F, 0] = u16(0x8611)
    with pytest.raises(DeviceError, match=r"stays in fault, error 0x8611 \(following error\)"):
        rail_for(peer).connect()


# -- moving -----------------------------------------------------------------------------------


def test_it_is_a_rail(rail: CanopenRail) -> None:
    port: Rail = rail
    assert port.read().still


def test_a_move_ends_at_standstill_and_holds(rail: CanopenRail, peer: CanPeer) -> None:
    rail.move_to(1100.25)
    reading = rail.read()
    assert (reading.position_mm, reading.strip_mm) == (1100.25, 1100.25)
    assert reading.still
    assert reading.powered
    rail.hold()
    assert not rail.read().powered
    assert peer.axis.state == can_peer.READY


def test_two_moves_in_a_row_do_not_take_old_bits(rail: CanopenRail, peer: CanPeer) -> None:
    rail.move_to(900.0)
    rail.move_to(901.0)
    assert rail.read().position_mm == 901.0
    rail.move_to(901.0)
    assert rail.read().position_mm == 901.0


def test_homing_ends_at_zero(rail: CanopenRail, peer: CanPeer) -> None:
    rail.home()
    assert rail.read().position_mm == 0.0
    rail.move_to(10.0)
    rail.home()
    assert rail.read().position_mm == 0.0
    assert peer.axis.mode == 6


def never_starts(peer: CanPeer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the bit that starts a motion (controlword, bit 4) from the drive."""
    control = peer.axis.control
    monkeypatch.setattr(peer.axis, "control", lambda word, target: control(word & ~0x10, target))


def test_homing_that_was_done_before_is_not_believed(
    rail: CanopenRail, peer: CanPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    rail.home()
    peer.axis.bits |= 0x1400
    never_starts(peer, monkeypatch)
    with pytest.raises(DeviceError, match="wanted homing started"):
        rail.home()


@pytest.mark.parametrize("position", [-0.1, 3000.1, float("nan")])
def test_targets_out_of_travel_never_leave(
    rail: CanopenRail, peer: CanPeer, position: float
) -> None:
    before = len(peer.frames(0x205))
    with pytest.raises(DeviceError, match=r"wanted 0\.0 \.\. 3000\.0 mm"):
        rail.move_to(position)
    assert len(peer.frames(0x205)) == before


def fault(axis: can_peer.Axis) -> None:
    axis.state = FAULT


MOTION_FAULTS: dict[str, tuple[Callable[[CanPeer], None], str]] = {
    "following error": (lambda p: setattr(p.axis, "bits", p.axis.bits | 0x2000), "following error"),
    "limit": (lambda p: setattr(p.axis, "bits", p.axis.bits | 0x0800), "limit active"),
    "runaway": (
        lambda p: setattr(p.axis, "speed", 300_001),
        r"speed 300\.001 mm/s, allowed 300\.000 mm/s",
    ),
    "outside": (
        lambda p: vars(p.axis).update(position=3_005_100, frozen=True),
        r"3005\.100 mm is beyond -5\.000 mm \.\. 3005\.000 mm",
    ),
    "fault": (lambda p: fault(p.axis), "drive in fault, error 0x0000"),
    "power lost": (lambda p: setattr(p.axis, "state", 0x40), "left operation enabled: switch on"),
    "magnet": (lambda p: setattr(p, "alarms", 1), "missing magnet"),
    "emcy": (
        lambda p: p.send(0x085, struct.pack("<HB5x", 0x7305, 1)),
        r"EMCY 0x7305 \(incremental",
    ),
    "strip emcy": (lambda p: p.send(0x086, struct.pack("<HB5x", 0x5000, 1)), "node 6: EMCY"),
    "reset": (lambda p: p.send(0x705, b"\0"), "node 5: unexpected boot-up"),
    "heartbeat": (lambda p: p.silent.update((DRIVE, STRIP)), "node [56]: no heartbeat for"),
    "nmt stop": (lambda p: p.nmt.update({DRIVE: 0x04}), r"NMT state stopped \(0x04\)"),
    "freeze": (lambda p: setattr(p.axis, "frozen", True), "no progress for"),
    "early": (lambda p: setattr(p.axis, "lies", True), "no progress for .* wanted target reached"),
    "end of stream": (lambda p: p.server.drop(), "link lost"),
}


@pytest.mark.parametrize("name", MOTION_FAULTS)
def test_a_fault_in_motion_stops_and_is_named(
    rail: CanopenRail, peer: CanPeer, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    cause, message = MOTION_FAULTS[name]
    if name in ("heartbeat", "nmt stop"):
        monkeypatch.setattr(drive, "STALL_S", 2.0)
        peer.axis.frozen = True

    def strike() -> None:
        if peer.axis.steps == 2 or peer.axis.frozen:
            cause(peer)

    peer.on_sync = strike
    if name in ("freeze", "early"):
        cause(peer)
    with pytest.raises(DeviceError, match=message):
        rail.move_to(1100.0)
    if name != "end of stream":
        assert peer.quick_stopped.wait(5)
    with pytest.raises(DeviceError):
        rail.move_to(1100.0)


def test_a_set_point_never_acknowledged_is_told(
    rail: CanopenRail, peer: CanPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    never_starts(peer, monkeypatch)
    with pytest.raises(DeviceError, match="wanted set-point acknowledged"):
        rail.move_to(1100.0)


def test_a_drive_that_does_not_enable_is_told(rail: CanopenRail, peer: CanPeer) -> None:
    peer.axis.deaf = True
    with pytest.raises(DeviceError, match="wanted drive to leave 'switch on disabled'"):
        rail.move_to(1100.0)


def test_a_refused_mode_is_told(rail: CanopenRail, peer: CanPeer) -> None:
    peer.abort[0x6060, 0] = 0x08000022
    with pytest.raises(DeviceError, match=r"0x08000022, .*present device state"):
        rail.move_to(1100.0)


# -- reading ----------------------------------------------------------------------------------


def test_settling_takes_five_readings_at_rest(rail: CanopenRail, peer: CanPeer) -> None:
    peer.jitter = 1
    reading = rail.settle()
    assert len(peer.frames(0x080)) >= 5
    assert reading.strip_mm == pytest.approx(500.0, abs=0.011)


def test_a_reading_is_newer_than_its_request(rail: CanopenRail, peer: CanPeer) -> None:
    began_s = time.monotonic()
    assert rail.read().taken_s >= began_s


def test_a_lost_tpdo_costs_one_more_sync(rail: CanopenRail, peer: CanPeer) -> None:
    lost = iter([True])
    peer.tamper = lambda line: [] if line.startswith(b"t285") and next(lost, False) else [line]
    assert rail.read().position_mm == 500.0


@pytest.mark.parametrize(
    "spoil",
    [
        lambda line: [],
        lambda line: [b"t2854" + line[5:13] + b"\r"],
        lambda line: [line[:9] + b"\r"],
        lambda line: [b"\x9f" + line],
    ],
)
def test_stale_and_truncated_tpdos_are_no_reading(
    rail: CanopenRail, peer: CanPeer, spoil: Callable[[bytes], list[bytes]]
) -> None:
    peer.tamper = lambda line: spoil(line) if line.startswith(b"t285") else [line]
    with pytest.raises(DeviceError, match="no fresh TPDO 0x285 within 3 SYNCs"):
        rail.read()


def test_garbage_and_slices_on_the_line_do_no_harm(peer: CanPeer) -> None:
    state = {"n": 0}

    def tamper(line: bytes) -> list[bytes]:
        state["n"] += 1
        garbage = [b"\xff\r", b"\a", b"t1\r"] if state["n"] % 3 == 0 else []
        return [*garbage, line[:5], line[5:]]

    peer.tamper = tamper
    rail = rail_for(peer)
    rail.connect()
    rail.move_to(700.0)
    assert rail.settle().position_mm == 700.0
    rail.close()


# -- stopping ---------------------------------------------------------------------------------


def test_a_stop_gets_through_while_a_call_hangs(rail: CanopenRail, peer: CanPeer) -> None:
    hanging = threading.Event()
    failures: list[DeviceError] = []

    def read() -> None:
        try:
            rail.read()
        except DeviceError as error:
            failures.append(error)

    def swallow(line: bytes) -> list[bytes]:
        hanging.set()
        return []

    peer.tamper = swallow
    worker = threading.Thread(target=read)
    worker.start()
    assert hanging.wait(5)
    rail.stop()
    assert peer.quick_stopped.wait(5)
    worker.join(5)
    assert len(failures) == 1
    peer.tamper = lambda line: [line]


def test_after_a_stop_only_a_new_connect_moves(rail: CanopenRail, peer: CanPeer) -> None:
    rail.stop()
    with pytest.raises(DeviceError, match="the rail was stopped; resume to connect anew"):
        rail.move_to(600.0)
    rail.connect()
    rail.move_to(600.0)
    assert rail.read().position_mm == 600.0


def test_the_runs_stop_ends_a_motion_on_the_ramp(peer: CanPeer) -> None:
    stop = threading.Event()
    rail = rail_for(peer, WallClock(stop))
    rail.connect()
    peer.axis.frozen = True
    threading.Timer(0.05, stop.set).start()
    with pytest.raises(Stopped):
        rail.move_to(1100.0)
    assert peer.quick_stopped.wait(5)
    peer.axis.frozen = False
    rail.close()
    assert peer.axis.state not in (ENABLED, can_peer.QUICK)


def test_close_takes_the_power_away_and_ends_the_supervision(peer: CanPeer) -> None:
    rail = rail_for(peer)
    rail.connect()
    rail.move_to(600.0)
    rail.close()
    assert peer.axis.state == can_peer.DISABLED
    assert peer.objects[DRIVE][0x1016, 1] == u32(0)
    with pytest.raises(DeviceError, match="not connected"):
        rail.read()


def test_close_says_when_the_power_stays(peer: CanPeer) -> None:
    rail = rail_for(peer)
    rail.connect()
    rail.move_to(600.0)
    peer.axis.deaf = True
    with pytest.raises(DeviceError, match="the drive keeps its power: operation enabled"):
        rail.close()
    assert rail._link is None


def test_a_failed_connect_leaves_no_threads(peer: CanPeer) -> None:
    before = threading.active_count()
    peer.objects[DRIVE][0x1018, 1] = u32(1)
    for _ in range(2):
        with pytest.raises(DeviceRefused):
            rail_for(peer).connect()
    peer.server.drop()
    assert _soon(lambda: threading.active_count() <= before + 2)


def _soon(holds: Callable[[], bool]) -> bool:
    deadline_s = time.monotonic() + 5
    while not holds() and time.monotonic() < deadline_s:
        threading.Event().wait(0.01)
    return holds()


def test_stop_and_close_before_connect_do_nothing(peer: CanPeer) -> None:
    rail = rail_for(peer)
    rail.stop()
    rail.close()
    assert peer.heard == []


# -- what the link has carried ----------------------------------------------------------------


def test_what_the_link_loses_is_counted_and_kept_after_the_end(peer: CanPeer) -> None:
    rail = rail_for(peer)
    assert rail.statistics() == LinkStatistics()
    rail.connect()
    clean = rail.statistics()
    assert clean.frames > 20
    assert (clean.bad_lines, clean.refused, clean.malformed) == (0, 0, 0)
    spoilt = iter((b"\xff\r", b"\a", b"t2851AA\r", b"t08510\r"))
    peer.tamper = lambda line: [line, *([piece] if (piece := next(spoilt, b"")) else [])]
    rail.read()
    rail.close()
    found = rail.statistics()
    assert (found.bad_lines, found.refused, found.malformed) == (2, 1, 1)
    assert found.frames > clean.frames
