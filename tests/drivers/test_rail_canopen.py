"""Motions, readings and stops of the rail's driver on the wire."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable

import pytest

from drivers.canopen import drive, release
from drivers.canopen.pdo import SYNCS
from drivers.canopen.rail import CanopenRail
from hilcell.clock import WallClock
from hilcell.ports import DeviceError, DeviceRefused, LinkStatistics, Rail, Stopped, StripLost
from hilcell.run import stopping
from tests.drivers import can_peer
from tests.drivers.can_peer import (
    DRIVE,
    ENABLED,
    FAULT,
    STRIP,
    CanPeer,
    u32,
)
from tests.drivers.rail_bed import holding, peer, rail, rail_for, short_deadlines, soon

__all__ = ["peer", "rail", "short_deadlines"]


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


@pytest.mark.parametrize("counts", [300, -300])
def test_homing_that_ends_beside_zero_is_refused(
    rail: CanopenRail, peer: CanPeer, counts: int
) -> None:
    peer.axis.zero = counts
    with pytest.raises(DeviceError, match=f"stands at {counts / 1000:.3f} mm") as caught:
        rail.home()
    assert caught.value.code == "HC-R35"


@pytest.mark.parametrize("target_mm", [490.0, 510.0])
def test_a_target_that_was_not_reached_is_not_believed(
    rail: CanopenRail, peer: CanPeer, monkeypatch: pytest.MonkeyPatch, target_mm: float
) -> None:
    monkeypatch.setattr(drive, "STALL_S", 0.3)
    peer.axis.lies = True
    with pytest.raises(DeviceError, match=r"no progress for .* wanted target reached"):
        rail.move_to(target_mm)


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
    "runaway back": (
        lambda p: setattr(p.axis, "speed", -300_001),
        r"speed -300\.001 mm/s, allowed 300\.000 mm/s",
    ),
    "outside": (
        lambda p: vars(p.axis).update(position=3_005_100, frozen=True),
        r"3005\.100 mm is beyond -5\.000 mm \.\. 3005\.000 mm",
    ),
    "fault": (lambda p: fault(p.axis), "drive in fault, error 0x0000"),
    "power lost": (lambda p: setattr(p.axis, "state", 0x40), "left operation enabled: switch on"),
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
MOTION_ALARMS = {
    "following error": "HC-R26", "limit": "HC-R32", "runaway": "HC-R33",
    "runaway back": "HC-R33", "outside": "HC-R34", "fault": "HC-R27", "power lost": "HC-R30",
    "emcy": "HC-R24",
    "strip emcy": "HC-R27", "reset": "HC-R03", "heartbeat": "HC-R02", "nmt stop": "HC-R03",
    "freeze": "HC-R31", "early": "HC-R31", "end of stream": "HC-R01",
}  # fmt: skip


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
    with pytest.raises(DeviceError, match=message) as caught:
        rail.move_to(1100.0)
    assert caught.value.code == MOTION_ALARMS[name]
    if name != "end of stream":
        assert peer.quick_stopped.wait(5)
    with pytest.raises(DeviceError):
        rail.move_to(1100.0)


def dirty(peer: CanPeer) -> None:
    """Let the strip go into alarm, as sensors do: by an emergency and in each PDO."""
    peer.send(0x086, struct.pack("<HB5x", 0x7305, 1))
    peer.alarms, peer.strip_offset = 1, 7000


def test_dirt_on_the_way_ends_no_motion(rail: CanopenRail, peer: CanPeer) -> None:
    peer.on_sync = lambda: dirty(peer) if peer.axis.steps == 2 else clean(peer)
    rail.move_to(1100.0)
    assert rail.settle().strip_mm == 1100.0


def clean(peer: CanPeer) -> None:
    peer.alarms = peer.strip_offset = 0


def test_without_the_strip_the_drive_moves_and_holds_and_nothing_is_read(
    rail: CanopenRail, peer: CanPeer
) -> None:
    dirty(peer)
    rail.move_to(1100.0)
    for read in (rail.settle, rail.read):
        with pytest.raises(StripLost, match="missing magnet") as caught:
            read()
        assert caught.value.code == "HC-S01"
    rail.hold()
    assert peer.axis.state == can_peer.READY
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
    with pytest.raises(DeviceError, match="wanted set-point acknowledged"):
        rail.move_to(1100.0)


def test_a_drive_that_does_not_enable_is_reported(rail: CanopenRail, peer: CanPeer) -> None:
    peer.axis.deaf = True
    with pytest.raises(DeviceError, match="wanted drive to leave 'switch on disabled'"):
        rail.move_to(1100.0)


def test_a_refused_mode_is_reported(rail: CanopenRail, peer: CanPeer) -> None:
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


def test_a_reading_says_since_when_the_slide_rests(
    rail: CanopenRail, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: drive.Drive, target: int) -> None:
        raise DeviceError("HC-R31", "Rail", "move", "it stands")

    assert rail.read().ended_s is None
    began_s = time.monotonic()
    rail.move_to(510.0)
    reading = rail.read()
    assert reading.ended_s is not None
    assert began_s <= reading.ended_s <= reading.taken_s
    assert rail.read().ended_s == reading.ended_s
    monkeypatch.setattr(drive.Drive, "move", fail)
    with pytest.raises(DeviceError):
        rail.move_to(1100.0)
    assert rail.read().ended_s is None


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
    with pytest.raises(DeviceError, match="the rail was stopped; resume to reconnect"):
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
    rail = holding(peer)
    rail.close()
    assert peer.axis.state == can_peer.DISABLED
    assert peer.objects[DRIVE][0x1016, 1] == u32(0)
    with pytest.raises(DeviceError, match="not connected"):
        rail.read()


def test_close_says_when_the_power_stays(peer: CanPeer) -> None:
    rail = holding(peer)
    peer.axis.deaf = True
    with pytest.raises(DeviceError, match="the drive keeps its power: operation enabled"):
        rail.close()
    assert rail._link is None


def test_close_waits_for_a_drive_that_is_silent_for_a_while(
    peer: CanPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(release, "RELEASE_S", 5.0)
    rail = holding(peer)
    peer.ignore.add((0x6041, 0))
    silent = iter(range(2 * SYNCS))  # two polls without an answer, by SDO neither
    peer.tamper = lambda line: (
        [] if line.startswith(b"t185") and next(silent, None) is not None else [line]
    )
    rail.close()
    assert next(silent, None) is None
    assert peer.axis.state == can_peer.DISABLED


def test_close_names_a_drive_that_stays_silent(peer: CanPeer) -> None:
    rail = rail_for(peer)
    rail.connect()
    peer.ignore.add((0x6041, 0))
    peer.tamper = lambda line: [] if line.startswith(b"t185") else [line]
    began_s = time.monotonic()
    with pytest.raises(DeviceError, match="no fresh TPDO 0x185"):
        rail.close()
    assert time.monotonic() - began_s < stopping.CLOSE_S
    assert rail._link is None


def test_a_failed_connect_leaves_no_threads(peer: CanPeer) -> None:
    before = threading.active_count()
    peer.objects[DRIVE][0x1018, 1] = u32(1)
    for _ in range(2):
        with pytest.raises(DeviceRefused):
            rail_for(peer).connect()
    peer.server.drop()
    assert soon(lambda: threading.active_count() <= before + 2)


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
