"""Requests, settings and refusals of the rail's driver before anything may move."""

from __future__ import annotations

import struct

import pytest

from drivers.canopen.rail import CanopenRail
from drivers.strips.strip import StripOptions
from hilcell.ports import DeviceError, DeviceRefused, StripLost
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
from tests.drivers.rail_bed import BEAT, START, peer, rail, rail_for, short_deadlines, soon
from tests.drivers.strip_peer import StripPeer

__all__ = ["peer", "rail", "short_deadlines"]


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


def test_a_missing_node_on_a_line_full_of_garbage_is_reported_with_the_losses(
    peer: CanPeer,
) -> None:
    peer.ignore.add((0x1000, 0))
    peer.tamper = lambda line: [line[:-2] + b"?\r"]
    with pytest.raises(
        DeviceError,
        match=r"node 5 \(drive\) does not answer; \d+ bad lines, 0 refused on this link",
    ):
        rail_for(peer).connect()


def test_an_abort_is_reported_in_the_standards_words(peer: CanPeer) -> None:
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
    assert soon(lambda: rail._watches[0].state == 0x7F)
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


def test_a_fault_that_stays_is_reported(peer: CanPeer, monkeypatch: pytest.MonkeyPatch) -> None:
    peer.axis.state = FAULT
    monkeypatch.setattr(peer.axis, "control", lambda word, target: None)
    peer.objects[DRIVE][0x603F, 0] = u16(0x8611)
    with pytest.raises(DeviceError, match=r"stays in fault, error 0x8611 \(following error\)"):
        rail_for(peer).connect()


def test_a_strip_on_a_line_of_its_own_is_read_and_the_bus_has_none(peer: CanPeer) -> None:
    with StripPeer() as strip:
        strip.counts = lambda: peer.axis.position // 10
        line = StripOptions(driver="serial", channel=strip.channel)
        rail = rail_for(peer, strip=line, strip_counts_per_mm=3.0)
        drive, sensor = rail.connect()
        assert (drive.kind, sensor.serial) == ("drive", "1234567")
        rail.home()
        rail.move_to(700.0)
        assert rail.settle().strip_mm == 700.0
        rail.hold()
        strip.silent = True
        with pytest.raises(StripLost, match="did not answer"):
            rail.read()
        rail.move_to(800.0)  # no motion asks the strip
        strip.silent = False
        rail.hold()
        assert rail.settle().strip_mm == 800.0
        strip.register = 1
        with pytest.raises(StripLost, match="too far from the strip"):
            rail.read()
        rail.close()


def test_a_slide_that_a_dead_engine_left_moving_is_braked_and_can_be_moved(
    peer: CanPeer,
) -> None:
    peer.axis.state, peer.axis.steps, peer.axis.target = ENABLED, 1000, 900_000
    rail = rail_for(peer)
    rail.connect()
    assert peer.quick_stopped.is_set()
    rail.move_to(700.0)
    assert peer.axis.position == 700_000
    rail.close()
