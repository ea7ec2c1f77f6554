"""The end of a session with a drive that sends and obeys no PDO."""

from __future__ import annotations

import pytest

from drivers.canopen import rail as canopen_rail
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
from tests.drivers.canopen.rail_bed import RailTime, holding, peer, time
from tests.drivers.peers import refusal, soon

pytestmark = pytest.mark.waits

__all__ = ["peer", "time"]


def falls_out(peer: CanPeer, time: RailTime, state: int) -> None:
    """Let the drive miss the PC's heartbeat: it leaves OPERATIONAL, and neither sends nor obeys
    PDOs; ``state`` is where its own reaction has brought it.
    """
    peer.nmt[DRIVE] = PRE_OPERATIONAL
    peer.axis.state = state
    time.silence()


@pytest.mark.parametrize("state", [DISABLED, FAULT])
def test_close_confirms_by_sdo_that_a_drive_without_pdos_has_braked_by_itself(
    peer: CanPeer, time: RailTime, state: int
) -> None:
    rail = holding(peer, time)
    falls_out(peer, time, state)
    rail.close()
    assert peer.written(0x6040) == []
    assert rail.statistics().held_by_sdo
    assert peer.objects[DRIVE][0x1016, 1] == u32(0)


@pytest.mark.parametrize("stopped", [False, True])
def test_close_disables_a_drive_by_sdo_that_obeys_no_pdo_and_keeps_its_power(
    peer: CanPeer, time: RailTime, stopped: bool
) -> None:
    rail = holding(peer, time, standstill_dwell_s=0.2)
    falls_out(peer, time, ENABLED)
    if stopped:
        rail.stop()
    rail.close()
    assert peer.axis.state == DISABLED
    assert peer.written(0x6040) == [u16(0)]
    assert rail.statistics().held_by_sdo


def test_close_brakes_a_slide_by_sdo_that_moves_with_power_and_obeys_no_pdo(
    peer: CanPeer, time: RailTime
) -> None:
    rail = holding(peer, time)
    peer.axis.target, peer.axis.steps, peer.axis.bits = 1_100_000, 1000, 0
    falls_out(peer, time, ENABLED)
    rail.close()
    assert peer.axis.state == DISABLED
    assert peer.written(0x6040) == [u16(2)]


@pytest.mark.parametrize("state", [ENABLED, DISABLED])
def test_close_raises_the_alarm_where_sdo_confirms_nothing(
    peer: CanPeer, time: RailTime, state: int
) -> None:
    """With its power, or while it moves."""
    rail = holding(peer, time)
    falls_out(peer, time, state)
    peer.axis.deaf, peer.axis.steps = True, 1000
    assert refusal(rail.close).code == "HC-R37"
    assert not rail.statistics().held_by_sdo


@pytest.mark.parametrize("pause_s", [0.0, 3.0])
def test_close_stops_no_slide_that_stands_because_the_pc_looks_seldom(
    peer: CanPeer, time: RailTime, monkeypatch: pytest.MonkeyPatch, pause_s: float
) -> None:
    monkeypatch.setattr(canopen_rail.Release, "RELEASE_S", 60.0)
    rail = holding(peer, time, standstill_dwell_s=0.2)
    peer.axis.hunts = True
    sleep = time.sleep
    monkeypatch.setattr(time, "sleep", lambda s: sleep(s + pause_s))
    rail.close()
    assert peer.axis.state == DISABLED
    assert not peer.quick_stopped.is_set()
    assert not rail.statistics().held_by_sdo


def test_close_brakes_a_slide_that_creeps_also_where_the_pc_looks_seldom(
    peer: CanPeer, time: RailTime, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(canopen_rail.Release, "RELEASE_S", 5.0)  # the product's own
    rail = holding(peer, time, standstill_dwell_s=0.2)
    axis = peer.axis
    peer.on_sync = lambda: setattr(axis, "position", axis.position + 1000 * (axis.state == ENABLED))
    sleep = time.sleep
    monkeypatch.setattr(time, "sleep", lambda s: sleep(s + 3.0))
    rail.close()
    assert peer.quick_stopped.is_set()


def runs(peer: CanPeer) -> None:
    """Let the slide be on its way to a place that it does not reach in the test."""
    peer.axis.target, peer.axis.steps, peer.axis.bits = 1_100_000, 1000, 0


@pytest.mark.parametrize("stopped", [False, True])
@pytest.mark.parametrize("lost", [1, 3])
def test_a_quick_stop_that_is_lost_on_the_wire_is_sent_again(
    peer: CanPeer, time: RailTime, stopped: bool, lost: int
) -> None:
    rail = holding(peer, time)
    runs(peer)
    peer.lost_stops = lost
    if stopped:
        rail.stop()
    rail.close()
    assert (peer.axis.state, peer.lost_stops) == (DISABLED, 0)
    assert peer.written(0x6040) == []


def test_a_drive_that_does_not_obey_quick_stops_is_asked_by_sdo_and_loses_its_power(
    peer: CanPeer, time: RailTime, monkeypatch: pytest.MonkeyPatch
) -> None:
    rail = holding(peer, time)
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
    assert len(peer.frames(0x77F)) <= beats[0] + 1  # one may have been on its way
    words = [data[0] for cob_id, data in peer.heard[began:] if cob_id == 0x205]
    assert (words[0], words[-1]) == (0x02, 0x00)
    assert set(peer.written(0x6040)) == {u16(2)}
    assert peer.axis.state == DISABLED


@pytest.mark.parametrize("nmt", [PRE_OPERATIONAL, STOPPED])
def test_a_drive_whose_answers_are_late_is_stopped_before_they_come(
    peer: CanPeer, time: RailTime, nmt: int
) -> None:
    """One in STOPPED answers nothing, and is taken to PRE-OPERATIONAL first."""
    rail = holding(peer, time)
    runs(peer)
    falls_out(peer, time, ENABLED)
    peer.nmt[DRIVE] = nmt
    assert soon(lambda: rail._nodes[0].state == nmt)
    peer.ignore |= {(0x6041, 0), (0x1018, 0)}
    time.silence(0.2)
    refusal(rail.close)
    assert peer.axis.state == DISABLED
    assert u16(2) in peer.written(0x6040)


@pytest.mark.parametrize("state", [DISABLED, FAULT])
def test_a_slide_that_rolls_on_without_power_is_not_held(
    peer: CanPeer, time: RailTime, state: int
) -> None:
    rail = holding(peer, time)
    runs(peer)
    peer.axis.state = state
    time.silence(0.1)
    assert refusal(rail.close).code == "HC-R37"


def test_close_waits_for_a_slide_that_rolls_out(peer: CanPeer, time: RailTime) -> None:
    rail = holding(peer, time)
    peer.axis.target, peer.axis.steps, peer.axis.bits = 620_000, 20, 0
    peer.axis.state = DISABLED
    rail.close()
    assert peer.axis.position == 620_000


def test_a_slide_that_has_stood_is_held_at_the_first_look(peer: CanPeer, time: RailTime) -> None:
    rail = holding(peer, time)
    rail.hold()
    rail.settle()
    syncs = len(peer.frames(0x080))
    rail.close()
    assert len(peer.frames(0x080)) == syncs + 1
