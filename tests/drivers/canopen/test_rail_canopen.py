"""Motions, readings and stops of the rail's driver on the wire."""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable

import pytest

from drivers.canopen import drive, nodes
from drivers.canopen import rail as canopen_rail
from drivers.canopen.process_image import SYNCS
from drivers.canopen.rail import CanopenRail
from hilcell.ports import DeviceError, DeviceRefused, LinkStatistics, Rail, Stopped, StripLost
from tests.drivers.canopen.can_peer import (
    DISABLED,
    DRIVE,
    ENABLED,
    FAULT,
    QUICK,
    READY,
    STRIP,
    CanPeer,
    u32,
)
from tests.drivers.canopen.rail_bed import RailTime, connected, holding, peer, rail, rail_for, time
from tests.drivers.peers import in_thread, refusal, soon

pytestmark = pytest.mark.waits

__all__ = ["peer", "rail", "time"]


# -- moving -----------------------------------------------------------------------------------


def test_a_move_ends_at_standstill_and_holds(rail: CanopenRail, peer: CanPeer) -> None:
    port: Rail = rail
    assert port.read().still
    rail.move_to(1100.25)
    reading = rail.read()
    assert (reading.position_mm, reading.strip_mm) == (1100.25, 1100.25)
    assert reading.still
    assert reading.powered
    rail.hold()
    assert not rail.read().powered
    assert peer.axis.state == READY


def test_two_moves_in_a_row_do_not_take_old_bits(rail: CanopenRail) -> None:
    for target_mm in (900.0, 901.0, 901.0):
        rail.move_to(target_mm)
        assert rail.read().position_mm == target_mm


@pytest.mark.parametrize("counts", [300, -300])
def test_homing_that_ends_beside_zero_is_refused(
    rail: CanopenRail, peer: CanPeer, counts: int
) -> None:
    peer.axis.zero = counts
    found = refusal(rail.home)
    assert found.code == "HC-R35"
    assert found.fields["position_mm"] == counts / 1000


@pytest.mark.parametrize("target_mm", [490.0, 510.0])
def test_a_target_that_was_not_reached_is_not_believed(
    rail: CanopenRail, peer: CanPeer, target_mm: float
) -> None:
    peer.axis.lies = True
    assert refusal(lambda: rail.move_to(target_mm)).code == "HC-R31"


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
    found = refusal(rail.home)
    assert (found.code, found.expected) == ("HC-R31", "homing started")


@pytest.mark.parametrize("position", [-0.1, 3000.1, float("nan")])
def test_targets_out_of_travel_never_leave(
    rail: CanopenRail, peer: CanPeer, position: float
) -> None:
    before = len(peer.frames(0x205))
    assert refusal(lambda: rail.move_to(position)).code == "HC-R36"
    assert len(peer.frames(0x205)) == before


def reset(peer: CanPeer) -> None:
    """Let the drive boot, and be operational at once: its boot-up alone shows the reset."""
    peer.send(0x705, b"\0")
    peer.send(0x705, b"\5")


MOTION_FAULTS: dict[str, tuple[Callable[[CanPeer], object], str]] = {
    "following error": (lambda p: setattr(p.axis, "bits", p.axis.bits | 0x2000), "HC-R26"),
    "limit": (lambda p: setattr(p.axis, "bits", p.axis.bits | 0x0800), "HC-R32"),
    "runaway": (lambda p: setattr(p.axis, "speed", 300_001), "HC-R33"),
    "runaway back": (lambda p: setattr(p.axis, "speed", -300_001), "HC-R33"),
    "outside": (lambda p: vars(p.axis).update(position=3_005_100, frozen=True), "HC-R34"),
    "fault": (lambda p: setattr(p.axis, "state", FAULT), "HC-R27"),
    "power lost": (lambda p: setattr(p.axis, "state", DISABLED), "HC-R30"),
    "emcy": (lambda p: p.send(0x085, struct.pack("<HB5x", 0x7305, 1)), "HC-R24"),
    "strip emcy": (lambda p: p.send(0x086, struct.pack("<HB5x", 0x5000, 1)), "HC-R27"),
    "reset": (reset, "HC-R03"),
    "heartbeat": (lambda p: p.silent.update((DRIVE, STRIP)), "HC-R02"),
    "nmt stop": (lambda p: p.nmt.update({DRIVE: 0x04}), "HC-R03"),
    "freeze": (lambda p: setattr(p.axis, "frozen", True), "HC-R31"),
    "early": (lambda p: setattr(p.axis, "lies", True), "HC-R31"),
    "end of stream": (lambda p: p.server.drop(), "HC-R01"),
}


@pytest.mark.parametrize("name", MOTION_FAULTS)
def test_a_fault_in_motion_stops_and_is_named(
    rail: CanopenRail, peer: CanPeer, time: RailTime, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    cause, code = MOTION_FAULTS[name]
    if name in ("heartbeat", "nmt stop"):
        monkeypatch.setattr(drive.Drive, "STALL_S", 1e6)
        monkeypatch.setattr(nodes.NodeWatch, "HEARTBEAT_AGE_S", 0.2)
        peer.axis.frozen = True

    def strike() -> None:
        if peer.axis.steps == 2 or peer.axis.frozen:
            cause(peer)
            if name == "heartbeat":
                time.silence()

    peer.on_sync = strike
    if name in ("freeze", "early"):
        cause(peer)
    assert refusal(lambda: rail.move_to(1100.0)).code == code
    if name != "end of stream":
        peer.quick_stopped.wait()
    with pytest.raises(DeviceError):
        rail.move_to(1100.0)


def dirty(peer: CanPeer) -> None:
    """Let the strip go into alarm, as sensors do: by an emergency and in each PDO."""
    peer.send(0x086, struct.pack("<HB5x", 0x7305, 1))
    peer.alarms, peer.strip_offset = 1, 7000


def clean(peer: CanPeer) -> None:
    peer.alarms = peer.strip_offset = 0


def test_dirt_on_the_way_ends_no_motion(rail: CanopenRail, peer: CanPeer) -> None:
    peer.on_sync = lambda: dirty(peer) if peer.axis.steps == 2 else clean(peer)
    rail.move_to(1100.0)
    assert rail.settle().strip_mm == 1100.0


def test_without_the_strip_the_drive_moves_and_holds_and_nothing_is_read(
    rail: CanopenRail, peer: CanPeer
) -> None:
    dirty(peer)
    rail.move_to(1100.0)
    for read in (rail.settle, rail.read):
        found = refusal(read)
        assert isinstance(found, StripLost)
        assert (found.code, found.fields["alarms"]) == ("HC-S01", 1)
    rail.hold()
    assert peer.axis.state == READY
    clean(peer)
    reading = rail.read()
    assert (reading.strip_mm, reading.powered) == (1100.0, False)
    rail.move_to(1200.0)


def test_a_strip_that_is_back_soon_is_read_once_its_alarm_has_left_the_reading(
    rail: CanopenRail, peer: CanPeer
) -> None:
    rail.settle()
    dirty(peer)
    polls = len(peer.frames(0x080))
    peer.on_sync = lambda: clean(peer) if len(peer.frames(0x080)) > polls + 2 else None
    assert rail.read().strip_mm == 500.0
    assert len(peer.frames(0x080)) >= polls + 7, "two in alarm, five that are not"


def test_a_set_point_never_acknowledged_is_reported(
    rail: CanopenRail, peer: CanPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    never_starts(peer, monkeypatch)
    found = refusal(lambda: rail.move_to(1100.0))
    assert (found.code, found.expected) == ("HC-R31", "set-point acknowledged")


def test_a_drive_that_does_not_enable_is_reported(rail: CanopenRail, peer: CanPeer) -> None:
    peer.axis.deaf = True
    found = refusal(lambda: rail.move_to(1100.0))
    assert (found.code, found.fields["state"]) == ("HC-R31", "switch on disabled")


# -- reading ----------------------------------------------------------------------------------


def test_settling_takes_five_readings_at_rest(rail: CanopenRail, peer: CanPeer) -> None:
    peer.jitter = 1
    before = len(peer.frames(0x080))
    reading = rail.settle()
    assert len(peer.frames(0x080)) - before >= 1
    assert reading.strip_mm == pytest.approx(500.0, abs=0.011)


def test_a_reading_says_since_when_the_slide_rests(
    rail: CanopenRail, time: RailTime, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: drive.Drive, target: int) -> None:
        raise DeviceError("HC-R31", "Rail", "move", "it stands")

    time.wait(1.0)
    reading = rail.read()
    assert (reading.ended_s, reading.taken_s) == (None, time.pc_s())
    began_s = time.pc_s()
    rail.move_to(510.0)
    reading = rail.read()
    assert reading.ended_s is not None
    assert began_s < reading.ended_s <= reading.taken_s
    time.wait(1.0)
    assert rail.read().ended_s == reading.ended_s
    monkeypatch.setattr(drive.Drive, "move", fail)
    with pytest.raises(DeviceError):
        rail.move_to(1100.0)
    assert rail.read().ended_s is None


def test_a_lost_tpdo_costs_one_more_sync(rail: CanopenRail, peer: CanPeer, time: RailTime) -> None:
    lost = iter([True])
    peer.tamper = lambda line: [] if line.startswith(b"t285") and next(lost, False) else [line]
    time.silence()
    assert rail.read().position_mm == 500.0


@pytest.mark.parametrize(
    "spoil",
    [
        lambda line: [],
        lambda line: [b"t2854" + line[5:13] + b"\r"],
        lambda line: [b"\x9f" + line],
    ],
)
def test_stale_and_truncated_tpdos_are_no_reading(
    rail: CanopenRail,
    peer: CanPeer,
    time: RailTime,
    spoil: Callable[[bytes], list[bytes]],
) -> None:
    peer.tamper = lambda line: spoil(line) if line.startswith(b"t285") else [line]
    time.silence()
    found = refusal(rail.read)
    assert (found.code, found.fields["syncs"]) == ("HC-R07", 3)
    assert "0x285" in str(found.fields["cob_ids"])
    peer.tamper = lambda line: [line]


def test_garbage_and_slices_on_the_line_do_no_harm(peer: CanPeer, time: RailTime) -> None:
    state = {"n": 0}

    def tamper(line: bytes) -> list[bytes]:
        state["n"] += 1
        garbage = [b"\xff\r", b"\a", b"t1\r"] if state["n"] % 3 == 0 else []
        return [*garbage, line[:5], line[5:]]

    peer.tamper = tamper
    with connected(peer, time) as rail:
        rail.move_to(700.0)
        assert rail.settle().position_mm == 700.0


# -- stopping ---------------------------------------------------------------------------------


def test_a_stop_gets_through_while_a_call_hangs(
    rail: CanopenRail, peer: CanPeer, time: RailTime
) -> None:
    hanging = threading.Event()

    def swallow(line: bytes) -> list[bytes]:
        hanging.set()
        return []

    peer.tamper = swallow
    with in_thread(rail.read, DeviceError) as failures:
        hanging.wait()
        rail.stop()
        peer.quick_stopped.wait()
        time.silence()
    assert len(failures) == 1
    peer.tamper = lambda line: [line]


def test_after_a_stop_only_a_new_connect_moves(rail: CanopenRail) -> None:
    rail.stop()
    assert refusal(lambda: rail.move_to(600.0)).code == "HC-R38"
    rail.connect()
    rail.move_to(600.0)
    assert rail.read().position_mm == 600.0


def test_the_runs_stop_ends_a_motion_on_the_ramp(peer: CanPeer, time: RailTime) -> None:
    rail = rail_for(peer, time)
    rail.connect()
    peer.axis.frozen = True
    peer.on_sync = lambda: time.stop.set() if peer.axis.steps else None
    with pytest.raises(Stopped):
        rail.move_to(1100.0)
    peer.quick_stopped.wait()
    peer.axis.frozen = False
    rail.close()
    assert peer.axis.state not in (ENABLED, QUICK)


def test_close_takes_the_power_away_and_ends_the_supervision(peer: CanPeer, time: RailTime) -> None:
    rail = holding(peer, time)
    rail.close()
    assert peer.axis.state == DISABLED
    assert peer.objects[DRIVE][0x1016, 1] == u32(0)
    assert refusal(rail.read).code == "HC-R38"


def test_close_says_when_the_power_stays(peer: CanPeer, time: RailTime) -> None:
    rail = holding(peer, time)
    peer.axis.deaf = True
    assert refusal(rail.close).code == "HC-R37"
    assert refusal(rail.read).code == "HC-R38"


def test_close_waits_for_a_drive_that_is_silent_for_a_while(
    peer: CanPeer, time: RailTime, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(canopen_rail.Release, "RELEASE_S", 60.0)
    rail = holding(peer, time)
    peer.ignore.add((0x6041, 0))
    silent = iter(range(2 * SYNCS))  # two polls without an answer, by SDO neither
    peer.tamper = lambda line: (
        [] if line.startswith(b"t185") and next(silent, None) is not None else [line]
    )
    time.silence(0.1)
    rail.close()
    assert next(silent, None) is None
    assert peer.axis.state == DISABLED


def test_close_names_a_drive_that_stays_silent(
    rail: CanopenRail, peer: CanPeer, time: RailTime
) -> None:
    peer.ignore.add((0x6041, 0))
    peer.tamper = lambda line: [] if line.startswith(b"t185") else [line]
    time.silence(0.5)
    found = refusal(rail.close)
    assert found.code == "HC-R07"
    assert "0x185" in str(found.fields["cob_ids"])
    assert "it may move" in str(found)
    assert refusal(rail.read).code == "HC-R38"


def test_a_failed_connect_leaves_no_threads(peer: CanPeer, time: RailTime) -> None:
    before = threading.active_count()
    peer.objects[DRIVE][0x1018, 1] = u32(1)
    for _ in range(2):
        with pytest.raises(DeviceRefused):
            rail_for(peer, time).connect()
    peer.server.drop()
    assert soon(lambda: threading.active_count() <= before + 2)


# -- what the link has carried ----------------------------------------------------------------


def test_what_the_link_loses_is_counted_and_kept_after_the_end(
    peer: CanPeer, time: RailTime
) -> None:
    rail = rail_for(peer, time)
    assert rail.statistics() == LinkStatistics()
    rail.connect()
    before = rail.statistics()
    assert before.frames > 20
    assert (before.bad_lines, before.refused, before.malformed) == (0, 0, 0)
    spoilt = iter((b"\xff\r", b"\a", b"t2851AA\r", b"t08510\r"))
    peer.tamper = lambda line: [line, *([piece] if (piece := next(spoilt, b"")) else [])]
    rail.read()
    rail.close()
    found = rail.statistics()
    assert (found.bad_lines, found.refused, found.malformed) == (2, 1, 1)
    assert found.frames > before.frames
