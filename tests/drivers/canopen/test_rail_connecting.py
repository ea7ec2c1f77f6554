"""Requests, settings and refusals of the rail's driver before anything may move."""

from __future__ import annotations

import socket
import struct
from typing import Any

import pytest

from drivers.canopen.rail import CanopenRail
from drivers.strips import StripOptions
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
    u16,
    u32,
)
from tests.drivers.canopen.rail_bed import (
    BEAT,
    START,
    RailTime,
    connected,
    peer,
    rail,
    rail_for,
    time,
)
from tests.drivers.peers import Server, refusal, soon
from tests.drivers.strip_peer import StripPeer

pytestmark = pytest.mark.waits

__all__ = ["peer", "rail", "time"]


def test_connect_writes_the_self_stop_and_the_mappings_and_moves_nothing(
    peer: CanPeer, time: RailTime
) -> None:
    rail = rail_for(peer, time)
    drive_identity, strip_identity = rail.connect()
    assert (drive_identity.kind, strip_identity.serial) == ("drive", "4711")
    assert peer.axis.position == 500_000
    assert peer.axis.state != ENABLED
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
    peer.beating.wait()
    assert peer.frames(0x77F)[0] == b"\x05"
    rail.close()


@pytest.mark.parametrize(
    ("node", "key", "value", "found"),
    [
        (DRIVE, (0x1000, 0), u32(0x00020191), "0x191"),
        (DRIVE, (0x1018, 1), u32(1), "vendor"),
        (STRIP, (0x1018, 2), u32(1), "product"),
        (STRIP, (0x6005, 1), u32(5000), "6005h"),
        (STRIP, (0x6501, 0), u16(5000), "6501h"),
    ],
)
def test_another_device_is_refused(
    peer: CanPeer, time: RailTime, node: int, key: tuple[int, int], value: bytes, found: str
) -> None:
    peer.objects[node][key] = value
    with pytest.raises(DeviceRefused, match=found):
        rail_for(peer, time).connect()


def test_a_plain_measuring_step_is_understood_and_an_absent_one_no_fault(
    peer: CanPeer, time: RailTime
) -> None:
    del peer.objects[STRIP][0x6005, 1]
    with connected(peer, time):
        pass
    peer.objects[STRIP][0x6005, 0] = u32(5000)
    peer.abort[0x6005, 1] = 0x06090011
    with pytest.raises(DeviceRefused, match="6005h"):
        rail_for(peer, time).connect()


@pytest.mark.parametrize("garbage", [False, True])
def test_a_missing_node_is_named_with_the_losses_of_its_line(
    peer: CanPeer, time: RailTime, garbage: bool
) -> None:
    peer.ignore.add((0x1000, 0))
    if garbage:
        peer.tamper = lambda line: [line[:-2] + b"?\r"]
    time.silence()
    found = refusal(rail_for(peer, time).connect)
    assert (found.code, found.fields["node"]) == ("HC-R05", DRIVE)
    assert ("bad lines" in found.found) is garbage


def test_time_stamps_of_another_form_are_named_with_their_line(
    peer: CanPeer, time: RailTime
) -> None:
    peer.tamper = lambda line: [line[:-1] + b"0123ABCD\r"]
    time.silence()
    found = refusal(rail_for(peer, time).connect)
    assert found.code == "HC-R05"
    assert "0123ABCD" in found.found
    assert "time stamps" in found.act


@pytest.mark.parametrize("frames", [0, 1, 2])
def test_a_gateway_that_hangs_up_while_connecting_is_reported(
    peer: CanPeer, time: RailTime, frames: int
) -> None:
    """Anywhere in the connecting, reading or writing: a lost link."""

    def hangs_up(connection: socket.socket) -> None:
        heard = 0
        while heard < frames and (data := connection.recv(100)):
            heard += data.count(b"t")
        connection.shutdown(socket.SHUT_RDWR)

    with Server(hangs_up) as server:
        rail = rail_for(peer, time, channel=f"socket://127.0.0.1:{server.port}")
        time.silence()
        assert refusal(rail.connect).code in {"HC-R01", "HC-R04"}


def test_an_abort_is_reported_in_the_standards_words(peer: CanPeer, time: RailTime) -> None:
    peer.abort[0x6007, 0] = 0x06010002
    found = refusal(rail_for(peer, time).connect)
    assert (found.code, found.fields["abort_code"]) == ("HC-R09", 0x06010002)
    assert "Attempt to write a read" in found.found


def test_a_setting_that_does_not_hold_is_refused(peer: CanPeer, time: RailTime) -> None:
    class Stubborn(dict[tuple[int, int], bytes]):
        def __setitem__(self, key: tuple[int, int], value: bytes) -> None:
            super().__setitem__(key, u16(1) if key == (0x605A, 0) else value)

    peer.objects[DRIVE] = Stubborn(peer.objects[DRIVE])
    found = refusal(rail_for(peer, time).connect)
    assert found.fields == {"node": DRIVE, "object": "605Ah:00", "read": 1, "written": 2}


@pytest.mark.parametrize("at", [(DRIVE, 0x1016, 1), (DRIVE, 0x1A00, 0), (STRIP, 0x1A00, 0)])
def test_a_drive_that_is_reset_while_nodes_are_set_up_is_named(
    peer: CanPeer, time: RailTime, at: tuple[int, int, int]
) -> None:
    class Watched(dict[tuple[int, int], bytes]):
        def __setitem__(self, key: tuple[int, int], value: bytes) -> None:
            super().__setitem__(key, value)
            if key == at[1:]:
                peer.objects[DRIVE].update(drive_objects())  # its self-stop is gone, too
                peer.send(0x705, b"\0")

    peer.objects[at[0]] = Watched(peer.objects[at[0]])
    found = refusal(rail_for(peer, time).connect)
    assert (found.code, found.fields) == ("HC-R03", {"node": DRIVE})


def hears(peer: CanPeer, monkeypatch: pytest.MonkeyPatch, deaf: list[int] | None) -> None:
    """Let nodes miss START: each number of ``deaf`` once, all of them for ever without a list."""
    original, left = peer._frame, iter(deaf or [])

    def frame(cob_id: int, data: bytes) -> None:
        started = (cob_id, data[:1]) == START
        if not started or (deaf is not None and data[1] != next(left, None)):
            original(cob_id, data)

    monkeypatch.setattr(peer, "_frame", frame)


def test_a_node_that_stays_pre_operational_is_refused(
    peer: CanPeer, time: RailTime, monkeypatch: pytest.MonkeyPatch
) -> None:
    hears(peer, monkeypatch, None)
    time.silence()
    found = refusal(rail_for(peer, time).connect)
    assert (found.code, found.fields["nodes"]) == ("HC-R10", [DRIVE, STRIP])


def test_start_is_repeated_while_a_node_is_set_up(
    peer: CanPeer, time: RailTime, monkeypatch: pytest.MonkeyPatch
) -> None:
    hears(peer, monkeypatch, [DRIVE, STRIP, DRIVE])
    time.silence()
    with connected(peer, time) as rail:
        assert rail.read().still


def test_the_first_heartbeat_goes_before_the_first_start(peer: CanPeer, time: RailTime) -> None:
    """A node that lost the last one goes back to pre-operational when START comes first."""
    peer.lost_heartbeat.update((DRIVE, STRIP))
    with connected(peer, time):
        services = [cob_id for cob_id, data in peer.heard if (cob_id, data[:1]) in (BEAT, START)]
        assert services[0] == 0x77F
        assert services.count(0x000) == 2  # one START a node was enough


def test_a_node_that_leaves_operational_later_is_never_started_again(
    rail: CanopenRail, peer: CanPeer
) -> None:
    peer.heard.clear()
    peer.nmt[DRIVE] = 0x7F
    assert soon(lambda: rail._nodes[0].state == 0x7F)
    assert refusal(lambda: rail.move_to(600.0)).code == "HC-R03"
    assert peer.frames(0x000) == []


def test_a_node_without_bit_30_keeps_it_cleared(peer: CanPeer, time: RailTime) -> None:
    peer.demands_no_rtr = False
    peer.objects[STRIP][0x1800, 1] = u32(0x80000186)
    with connected(peer, time):
        assert peer.objects[STRIP][0x1800, 1] == u32(0x186)


def test_an_old_fault_is_reset_and_nothing_enabled(peer: CanPeer, time: RailTime) -> None:
    peer.axis.state = FAULT
    with connected(peer, time):
        words = [struct.unpack("<Hi", data)[0] for data in peer.frames(0x205)]
        assert 0x0080 in words
        assert 0x000F not in words
        assert peer.axis.state == DISABLED


def test_a_fault_that_stays_is_reported(
    peer: CanPeer, time: RailTime, monkeypatch: pytest.MonkeyPatch
) -> None:
    peer.axis.state = FAULT
    monkeypatch.setattr(peer.axis, "control", lambda word, target: None)
    peer.objects[DRIVE][0x603F, 0] = u16(0x8611)
    found = refusal(rail_for(peer, time).connect)
    assert found.fields == {"state": "fault", "error_code": 0x8611}


def test_a_strip_on_a_line_of_its_own_is_read_and_the_bus_has_none(
    peer: CanPeer, time: RailTime
) -> None:
    with StripPeer() as strip:
        strip.counts = lambda: peer.axis.position // 10
        line = StripOptions(driver="serial", channel=strip.channel)
        rail = rail_for(peer, time, strip=line, strip_counts_per_mm=3.0)
        drive, sensor = rail.connect()
        assert (drive.kind, sensor.serial) == ("drive", "1234567")
        rail.home()
        rail.move_to(700.0)
        assert rail.settle().strip_mm == 700.0
        rail.hold()
        strip.silent = True
        time.silence()
        assert isinstance(refusal(rail.read), StripLost)
        time.silence(0.0)
        rail.move_to(800.0)  # no motion asks the strip
        strip.silent = False
        rail.hold()
        assert rail.settle().strip_mm == 800.0
        strip.register = 1
        found = refusal(rail.read)
        assert (type(found), found.fields["alarms"]) == (StripLost, 1)
        rail.close()


def test_after_a_stop_a_slide_is_held_that_has_a_strip_on_a_line_of_its_own(
    peer: CanPeer, time: RailTime
) -> None:
    """The wait for its answer is no wait of the run, which is over."""
    with StripPeer() as strip:
        strip.counts = lambda: peer.axis.position // 10
        rail = rail_for(peer, time, strip=StripOptions(driver="serial", channel=strip.channel))
        rail.connect()
        rail.move_to(700.0)
        time.stop.set()
        rail.close()
        assert peer.axis.state == DISABLED


def test_a_slide_that_a_dead_engine_left_moving_is_braked_and_can_be_moved(
    peer: CanPeer, time: RailTime
) -> None:
    peer.axis.state, peer.axis.steps, peer.axis.target = ENABLED, 1000, 900_000
    with connected(peer, time) as rail:
        assert peer.quick_stopped.is_set()
        rail.move_to(700.0)
        assert peer.axis.position == 700_000


@pytest.mark.parametrize(("homing_mm_s", "counts_s"), [(80.0, 80_000), (400.0, 250_000)])
def test_a_drive_homes_as_fast_as_stated_and_never_above_its_speed(
    peer: CanPeer, time: RailTime, homing_mm_s: float, counts_s: int
) -> None:
    rail_for(peer, time, homing_mm_s=homing_mm_s).connect()
    assert peer.objects[DRIVE][0x6099, 1] == u32(counts_s)


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
        convert(values | changed, CanopenRail.Options, "rail")
