"""Motions, readings and stops of the rail's driver on the wire."""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable

import pytest

from drivers.canopen import drive, nodes
from hilcell.ports import DeviceError, LinkStatistics, Rail, Stopped, StripLost
from tests.drivers.canopen.can_peer import DISABLED, DRIVE, ENABLED, FAULT, QUICK, READY, CanPeer
from tests.drivers.canopen.rail_bed import BedRail, RailBed
from tests.drivers.peers import in_thread, refusal

pytestmark = pytest.mark.waits


def never_starts(peer: CanPeer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the bit that starts a motion (controlword, bit 4) from the drive."""
    control = peer.axis.control
    monkeypatch.setattr(peer.axis, "control", lambda word, target: control(word & ~0x10, target))


def test_a_move_ends_at_standstill_and_the_slide_can_be_held(rail: BedRail) -> None:
    port: Rail = rail
    assert port.read().still
    rail.move_to(1100.25)
    reading = rail.read()
    assert (reading.position_mm, reading.strip_mm) == (1100.25, 1100.25)
    assert reading.still
    assert reading.powered
    rail.hold()
    assert not rail.read().powered
    assert rail.peer.axis.state == READY


def test_a_move_ignores_status_bits_of_the_move_before(rail: BedRail) -> None:
    for target_mm in (900.0, 901.0, 901.0):
        rail.move_to(target_mm)
        assert rail.read().position_mm == target_mm


@pytest.mark.parametrize("counts", [300, -300])
def test_homing_that_ends_beside_zero_is_refused(rail: BedRail, counts: int) -> None:
    rail.peer.axis.zero = counts
    error = refusal(rail.home)
    assert (error.code, error.fields["position_mm"]) == ("HC-R35", counts / 1000)


@pytest.mark.parametrize("target_mm", [490.0, 510.0])
def test_a_target_that_was_not_reached_is_not_believed(rail: BedRail, target_mm: float) -> None:
    rail.peer.axis.lies = True
    assert refusal(lambda: rail.move_to(target_mm)).code == "HC-R31"


def test_homing_that_was_done_before_is_not_believed(
    rail: BedRail, monkeypatch: pytest.MonkeyPatch
) -> None:
    rail.home()
    rail.peer.axis.bits |= 0x1400
    never_starts(rail.peer, monkeypatch)
    error = refusal(rail.home)
    assert (error.code, error.expected) == ("HC-R31", "homing started")


def test_a_set_point_never_acknowledged_is_reported(
    rail: BedRail, monkeypatch: pytest.MonkeyPatch
) -> None:
    never_starts(rail.peer, monkeypatch)
    error = refusal(lambda: rail.move_to(1100.0))
    assert (error.code, error.expected) == ("HC-R31", "set-point acknowledged")


@pytest.mark.parametrize("position", [-0.1, 3000.1, float("nan")])
def test_targets_out_of_travel_are_never_sent(rail: BedRail, position: float) -> None:
    before = len(rail.peer.frames(0x205))
    assert refusal(lambda: rail.move_to(position)).code == "HC-R36"
    assert len(rail.peer.frames(0x205)) == before


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
    "heartbeat": (lambda p: p.silent.update(p.nmt), "HC-R02"),
    "nmt stop": (lambda p: p.nmt.update({DRIVE: 0x04}), "HC-R03"),
    "freeze": (lambda p: setattr(p.axis, "frozen", True), "HC-R31"),
    "early": (lambda p: setattr(p.axis, "lies", True), "HC-R31"),
    "end of stream": (lambda p: p.server.drop(), "HC-R01"),
}


@pytest.mark.parametrize("name", MOTION_FAULTS)
def test_a_fault_in_motion_stops_and_is_named(
    rail: BedRail, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    peer = rail.peer
    cause, code = MOTION_FAULTS[name]
    if name in ("heartbeat", "nmt stop"):
        monkeypatch.setattr(drive.Drive, "STALL_S", 1e6)
        monkeypatch.setattr(nodes.NodeMonitor, "HEARTBEAT_AGE_S", 0.2)
        peer.axis.frozen = True

    def strike() -> None:
        if peer.axis.steps == 2 or peer.axis.frozen:
            cause(peer)
            if name == "heartbeat":
                rail.time.silence()

    peer.on_sync = strike
    if name in ("freeze", "early"):
        cause(peer)
    assert refusal(lambda: rail.move_to(1100.0)).code == code
    if name != "end of stream":
        peer.quick_stopped.wait()
    refusal(lambda: rail.move_to(1100.0))


def dirty(peer: CanPeer) -> None:
    """Let the strip go into alarm, as sensors do: by an emergency and in each PDO."""
    peer.send(0x086, struct.pack("<HB5x", 0x7305, 1))
    peer.alarms, peer.strip_offset = 1, 7000


def clean(peer: CanPeer) -> None:
    peer.alarms = peer.strip_offset = 0


def test_a_strip_alarm_in_motion_ends_no_motion(rail: BedRail) -> None:
    rail.peer.on_sync = lambda: dirty(rail.peer) if rail.peer.axis.steps == 2 else clean(rail.peer)
    rail.move_to(1100.0)
    assert rail.settle().strip_mm == 1100.0


def test_without_the_strip_the_drive_moves_and_holds_and_nothing_is_read(rail: BedRail) -> None:
    dirty(rail.peer)
    rail.move_to(1100.0)
    for read in (rail.settle, rail.read):
        error = refusal(read)
        assert (type(error), error.code, error.fields["alarms"]) == (StripLost, "HC-S01", 1)
    rail.hold()
    assert rail.peer.axis.state == READY
    clean(rail.peer)
    reading = rail.read()
    assert (reading.strip_mm, reading.powered) == (1100.0, False)
    rail.move_to(1200.0)


def test_a_strip_is_read_again_once_its_alarm_has_left_the_reading(rail: BedRail) -> None:
    rail.settle()
    peer = rail.peer
    dirty(peer)
    polls = len(peer.frames(0x080))
    rail.peer.on_sync = lambda: (
        clean(rail.peer) if len(rail.peer.frames(0x080)) > polls + 2 else None
    )
    assert rail.read().strip_mm == 500.0
    assert len(rail.peer.frames(0x080)) >= polls + 7, "two in alarm, five without"


@pytest.mark.parametrize(
    ("supply", "reason"),
    [(0x0200, "no voltage"), (0x0010, "obey the bus"), (0x0210, "lost frames")],
)
def test_a_drive_that_stays_without_power_says_why(rail: BedRail, supply: int, reason: str) -> None:
    rail.peer.axis.deaf, rail.peer.axis.supply = True, supply
    error = refusal(lambda: rail.move_to(700.0))
    assert (error.code, error.fields["state"]) == ("HC-R31", "switch on disabled")
    assert reason in str(error)


# -- reading ----------------------------------------------------------------------------------


def test_a_reading_says_since_when_the_slide_is_at_rest(
    rail: BedRail, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: drive.Drive, target: int) -> None:
        raise DeviceError("HC-R31", "Rail", "move", "it does not move")

    rail.time.wait(1.0)
    reading = rail.read()
    assert (reading.ended_s, reading.taken_s) == (None, rail.time.pc_s())
    began_s = rail.time.pc_s()
    rail.move_to(510.0)
    reading = rail.read()
    assert reading.ended_s is not None
    assert began_s < reading.ended_s <= reading.taken_s
    rail.time.wait(1.0)
    assert rail.read().ended_s == reading.ended_s
    monkeypatch.setattr(drive.Drive, "move", fail)
    refusal(lambda: rail.move_to(1100.0))
    assert rail.read().ended_s is None


def test_a_lost_tpdo_costs_one_more_sync(rail: BedRail) -> None:
    lost = iter([True])
    rail.peer.tamper = lambda line: [] if line.startswith(b"t285") and next(lost, False) else [line]
    rail.time.silence()
    assert rail.read().position_mm == 500.0


@pytest.mark.parametrize(
    "spoil",
    [lambda _: [], lambda line: [b"t2854" + line[5:13] + b"\r"], lambda line: [b"\x9f" + line]],
    ids=["missing", "truncated", "garbled"],
)
def test_a_reading_without_each_tpdo_is_none(
    rail: BedRail, spoil: Callable[[bytes], list[bytes]]
) -> None:
    rail.peer.tamper = lambda line: spoil(line) if line.startswith(b"t285") else [line]
    rail.time.silence()
    error = refusal(rail.read)
    assert (error.code, error.fields["syncs"]) == ("HC-R07", 3)
    assert "0x285" in str(error.fields["cob_ids"])
    rail.peer.tamper = lambda line: [line]


def test_garbage_and_slices_on_the_line_do_no_harm(bed: RailBed) -> None:
    lines = iter(range(10**6))

    def tamper(line: bytes) -> list[bytes]:
        garbage = [b"\xff\r", b"\a", b"t1\r"] if next(lines) % 3 == 0 else []
        return [*garbage, line[:5], line[5:]]

    bed.peer.tamper = tamper
    rail = bed.connect()
    rail.move_to(700.0)
    assert rail.settle().position_mm == 700.0


# -- stopping ---------------------------------------------------------------------------------


def test_a_stop_gets_through_while_a_call_hangs(rail: BedRail) -> None:
    hanging = threading.Event()

    def swallow(line: bytes) -> list[bytes]:
        hanging.set()
        return []

    rail.peer.tamper = swallow
    with in_thread(rail.read, DeviceError) as failures:
        hanging.wait()
        rail.stop()
        rail.peer.quick_stopped.wait()
        rail.time.silence()
    assert len(failures) == 1
    rail.peer.tamper = lambda line: [line]


def test_after_a_stop_only_a_new_connect_moves(rail: BedRail) -> None:
    rail.stop()
    assert refusal(lambda: rail.move_to(600.0)).code == "HC-R38"
    assert rail.peer.written(0x6060) == []
    rail.connect()
    rail.move_to(600.0)
    assert rail.read().position_mm == 600.0


def test_the_runs_stop_ends_a_motion_on_the_ramp(rail: BedRail) -> None:
    peer = rail.peer
    peer.axis.frozen = True
    peer.on_sync = lambda: rail.time.stop.set() if peer.axis.steps else None
    with pytest.raises(Stopped):
        rail.move_to(1100.0)
    peer.quick_stopped.wait()
    peer.axis.frozen = False
    rail.close()
    assert peer.axis.state not in (ENABLED, QUICK)


def test_link_losses_are_counted_and_known_after_the_end(bed: RailBed) -> None:
    rail = bed.make()
    assert rail.statistics() == LinkStatistics()
    rail.connect()
    before = rail.statistics()
    assert before.frames > 20
    assert (before.bad_lines, before.refused, before.malformed) == (0, 0, 0)
    spoilt = iter((b"\xff\r", b"\a", b"t2851AA\r", b"t08510\r"))
    bed.peer.tamper = lambda line: [line, *([piece] if (piece := next(spoilt, b"")) else [])]
    rail.read()
    rail.close()
    after = rail.statistics()
    assert (after.bad_lines, after.refused, after.malformed) == (2, 1, 1)
    assert after.frames > before.frames
