"""The end of a session: a slide at rest without power, also of a drive that obeys no PDO."""

from __future__ import annotations

import threading

import pytest

from drivers.canopen import rail as canopen_rail
from drivers.canopen.process_image import SYNCS
from tests.drivers.canopen.can_peer import (
    DISABLED,
    DRIVE,
    ENABLED,
    FAULT,
    PRE_OPERATIONAL,
    STOPPED,
    CanPeer,
    u16,
    u32,
)
from tests.drivers.canopen.rail_bed import BedRail, RailBed
from tests.drivers.peers import refusal, soon

pytestmark = pytest.mark.waits


def falls_out(bed: RailBed, state: int) -> None:
    """Let the drive miss the PC's heartbeat: it leaves OPERATIONAL, and neither sends nor obeys
    PDOs; ``state`` is the one that its own reaction has led to.
    """
    bed.peer.nmt[DRIVE] = PRE_OPERATIONAL
    bed.peer.axis.state = state
    bed.time.silence()


def runs(peer: CanPeer, to_counts: int = 1_100_000, steps: int = 1000) -> None:
    """Let the slide move; by default it does not arrive within the test."""
    peer.axis.target, peer.axis.steps, peer.axis.bits = to_counts, steps, 0


def test_close_takes_the_power_away_and_ends_the_supervision(bed: RailBed) -> None:
    rail = bed.moved()
    rail.close()
    assert bed.peer.axis.state == DISABLED
    assert bed.peer.objects[DRIVE][0x1016, 1] == u32(0)
    assert refusal(rail.read).code == "HC-R38"


def test_close_says_when_the_power_stays(bed: RailBed) -> None:
    rail = bed.moved()
    bed.peer.axis.deaf = True
    assert refusal(rail.close).code == "HC-R37"
    assert refusal(rail.read).code == "HC-R38"


def test_close_waits_for_a_drive_that_is_silent_for_a_while(
    bed: RailBed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(canopen_rail.Release, "RELEASE_S", 60.0)
    rail = bed.moved()
    bed.peer.ignore.add((0x6041, 0))
    silent = iter(range(2 * SYNCS))  # two polls without an answer, by SDO neither
    bed.peer.tamper = lambda line: (
        [] if line.startswith(b"t185") and next(silent, None) is not None else [line]
    )
    bed.time.silence(0.1)
    rail.close()
    assert next(silent, None) is None
    assert bed.peer.axis.state == DISABLED


def test_close_names_a_drive_that_stays_silent(rail: BedRail) -> None:
    rail.peer.ignore.add((0x6041, 0))
    rail.peer.tamper = lambda line: [] if line.startswith(b"t185") else [line]
    rail.time.silence(0.5)
    error = refusal(rail.close)
    assert error.code == "HC-R07"
    assert "0x185" in str(error.fields["cob_ids"])
    assert "it may move" in str(error)
    assert refusal(rail.read).code == "HC-R38"


@pytest.mark.parametrize("state", [DISABLED, FAULT])
def test_close_confirms_by_sdo_that_a_drive_without_pdos_has_braked_by_itself(
    bed: RailBed, state: int
) -> None:
    rail = bed.moved()
    falls_out(bed, state)
    rail.close()
    assert bed.peer.written(0x6040) == []
    assert rail.statistics().held_by_sdo
    assert bed.peer.objects[DRIVE][0x1016, 1] == u32(0)


@pytest.mark.parametrize("stopped", [False, True])
def test_close_disables_a_drive_by_sdo_that_obeys_no_pdo(bed: RailBed, stopped: bool) -> None:
    rail = bed.moved(standstill_dwell_s=0.2)
    falls_out(bed, ENABLED)
    if stopped:
        rail.stop()
    rail.close()
    assert bed.peer.axis.state == DISABLED
    assert bed.peer.written(0x6040) == [u16(0)]
    assert rail.statistics().held_by_sdo


def test_close_brakes_a_moving_slide_by_sdo_whose_drive_obeys_no_pdo(bed: RailBed) -> None:
    rail = bed.moved()
    runs(bed.peer)
    falls_out(bed, ENABLED)
    rail.close()
    assert bed.peer.axis.state == DISABLED
    assert bed.peer.written(0x6040) == [u16(2)]


@pytest.mark.parametrize("state", [ENABLED, DISABLED])
def test_close_raises_the_alarm_where_sdo_confirms_nothing(bed: RailBed, state: int) -> None:
    """With its power, or while it moves."""
    rail = bed.moved()
    falls_out(bed, state)
    bed.peer.axis.deaf, bed.peer.axis.steps = True, 1000
    assert refusal(rail.close).code == "HC-R37"
    assert not rail.statistics().held_by_sdo


@pytest.mark.parametrize("pause_s", [0.0, 3.0])
def test_close_stops_no_slide_at_rest_because_the_pc_polls_seldom(
    bed: RailBed, monkeypatch: pytest.MonkeyPatch, pause_s: float
) -> None:
    monkeypatch.setattr(canopen_rail.Release, "RELEASE_S", 60.0)
    rail = bed.moved(standstill_dwell_s=0.2)
    bed.peer.axis.hunts = True
    sleep = bed.time.sleep
    monkeypatch.setattr(bed.time, "sleep", lambda s: sleep(s + pause_s))
    rail.close()
    assert bed.peer.axis.state == DISABLED
    assert not bed.peer.quick_stopped.is_set()
    assert not rail.statistics().held_by_sdo


def test_close_brakes_a_slide_that_creeps_also_where_the_pc_polls_seldom(
    bed: RailBed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(canopen_rail.Release, "RELEASE_S", 5.0)  # the product's own
    rail = bed.moved(standstill_dwell_s=0.2)
    axis = bed.peer.axis
    bed.peer.on_sync = lambda: setattr(
        axis, "position", axis.position + 1000 * (axis.state == ENABLED)
    )
    sleep = bed.time.sleep
    monkeypatch.setattr(bed.time, "sleep", lambda s: sleep(s + 3.0))
    rail.close()
    assert bed.peer.quick_stopped.is_set()


@pytest.mark.parametrize("stopped", [False, True])
@pytest.mark.parametrize("lost", [1, 3])
def test_a_quick_stop_that_is_lost_on_the_wire_is_sent_again(
    bed: RailBed, stopped: bool, lost: int
) -> None:
    peer = bed.peer
    rail = bed.moved()
    runs(peer)
    peer.lost_stops = lost
    if stopped:
        rail.stop()
    rail.close()
    assert (peer.axis.state, peer.lost_stops) == (DISABLED, 0)
    assert peer.written(0x6040) == []


def test_a_drive_that_obeys_no_quick_stop_is_asked_by_sdo_and_loses_its_power(
    bed: RailBed, monkeypatch: pytest.MonkeyPatch
) -> None:
    peer = bed.peer
    rail = bed.moved()
    runs(peer)
    peer.axis.masked = {0x0002}
    began, link = len(peer.heard), rail._link
    assert link is not None
    beats, end_heartbeat = [], link.end_heartbeat

    def end() -> None:
        end_heartbeat()
        link._threads[1].join()  # or this test never ends
        beats.append(len(peer.frames(0x77F)))

    monkeypatch.setattr(link, "end_heartbeat", end)
    rail.close()
    assert beats
    assert len(peer.frames(0x77F)) <= beats[0] + 1  # one may have been in transit
    words = [data[0] for cob_id, data in peer.heard[began:] if cob_id == 0x205]
    assert (words[0], words[-1]) == (0x02, 0x00)
    assert set(peer.written(0x6040)) == {u16(2)}
    assert peer.axis.state == DISABLED


@pytest.mark.parametrize("nmt", [PRE_OPERATIONAL, STOPPED])
def test_a_drive_whose_answers_are_late_is_stopped_before_they_come(bed: RailBed, nmt: int) -> None:
    """One in STOPPED answers nothing, and is taken to PRE-OPERATIONAL first."""
    peer = bed.peer
    rail = bed.moved()
    runs(peer)
    falls_out(bed, ENABLED)
    peer.nmt[DRIVE] = nmt
    assert soon(lambda: rail._nodes[0].state == nmt)
    peer.ignore |= {(0x6041, 0), (0x1018, 0)}
    bed.time.silence(0.2)
    refusal(rail.close)
    assert peer.axis.state == DISABLED
    assert u16(2) in peer.written(0x6040)


@pytest.mark.parametrize("state", [DISABLED, FAULT])
def test_a_slide_that_rolls_on_without_power_is_not_held(bed: RailBed, state: int) -> None:
    rail = bed.moved()
    runs(bed.peer)
    bed.peer.axis.state = state
    bed.time.silence(0.1)
    assert refusal(rail.close).code == "HC-R37"


def test_close_waits_for_a_slide_that_rolls_out(bed: RailBed) -> None:
    rail = bed.moved()
    runs(bed.peer, 620_000, steps=20)
    bed.peer.axis.state = DISABLED
    rail.close()
    assert bed.peer.axis.position == 620_000


def test_a_slide_at_rest_is_held_after_one_poll(bed: RailBed) -> None:
    rail = bed.moved()
    rail.hold()
    rail.settle()
    syncs = len(bed.peer.frames(0x080))
    rail.close()
    assert len(bed.peer.frames(0x080)) == syncs + 1


def test_a_connect_that_fails_leaves_no_threads(bed: RailBed) -> None:
    before = threading.active_count()
    bed.peer.objects[DRIVE][0x1018, 1] = u32(1)
    for _ in range(2):
        refusal(bed.make().connect)
    bed.peer.server.drop()
    assert soon(lambda: threading.active_count() <= before + 2)
