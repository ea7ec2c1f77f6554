"""The end of a session with a drive that sends and obeys no PDO."""

from __future__ import annotations

from itertools import count
from types import SimpleNamespace

import pytest

from drivers.canopen import release
from hilcell.ports import DeviceError
from tests.drivers.can_peer import (
    DISABLED,
    DRIVE,
    ENABLED,
    FAULT,
    PRE_OPERATIONAL,
    CanPeer,
    u16,
    u32,
)
from tests.drivers.rail_bed import holding, peer, short_deadlines

__all__ = ["peer", "short_deadlines"]


def falls_out(peer: CanPeer, state: int) -> None:
    """Let the drive miss the PC's heartbeat: it leaves OPERATIONAL, and neither sends nor obeys
    PDOs; ``state`` is where its own reaction has brought it.
    """
    peer.nmt[DRIVE] = PRE_OPERATIONAL
    peer.axis.state = state


@pytest.mark.parametrize("state", [DISABLED, FAULT])
def test_close_confirms_by_sdo_that_a_drive_without_pdos_has_braked_by_itself(
    peer: CanPeer, state: int
) -> None:
    rail = holding(peer)
    falls_out(peer, state)
    rail.close()
    assert peer.written(0x6040) == []
    assert rail.statistics().held_by_sdo
    assert peer.objects[DRIVE][0x1016, 1] == u32(0)


@pytest.mark.parametrize("stopped", [False, True])
def test_close_disables_a_drive_by_sdo_that_obeys_no_pdo_and_keeps_its_power(
    peer: CanPeer, stopped: bool
) -> None:
    rail = holding(peer, standstill_dwell_s=0.2)
    falls_out(peer, ENABLED)
    if stopped:
        rail.stop()
    rail.close()
    assert peer.axis.state == DISABLED
    assert peer.written(0x6040) == [u16(0)]
    assert rail.statistics().held_by_sdo


def test_close_brakes_a_slide_by_sdo_that_moves_with_power_and_obeys_no_pdo(
    peer: CanPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(release, "RELEASE_S", 5.0)
    rail = holding(peer)
    peer.axis.target, peer.axis.steps, peer.axis.bits = 1_100_000, 1000, 0
    falls_out(peer, ENABLED)
    rail.close()
    assert peer.axis.state == DISABLED
    assert peer.written(0x6040) == [u16(2)]


@pytest.mark.parametrize(
    ("state", "found"),
    [(ENABLED, "the drive keeps its power: operation enabled"),
     (DISABLED, "the slide does not rest: switch on disabled")],
)  # fmt: skip
def test_close_raises_the_alarm_where_sdo_confirms_nothing(
    peer: CanPeer, monkeypatch: pytest.MonkeyPatch, state: int, found: str
) -> None:
    rail = holding(peer)
    falls_out(peer, state)
    peer.axis.deaf, peer.axis.steps = True, 1000
    with pytest.raises(DeviceError, match=found) as caught:
        rail.close()
    assert caught.value.code == "HC-R37"
    assert not rail.statistics().held_by_sdo


def test_close_by_pdo_says_nothing_of_sdo(peer: CanPeer) -> None:
    rail = holding(peer)
    rail.close()
    assert not rail.statistics().held_by_sdo


def test_close_stops_no_slide_that_stands_because_the_pc_looks_seldom(
    peer: CanPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    rail = holding(peer, standstill_dwell_s=0.2)
    peer.axis.hunts = True
    looks_s = count(0.0, 3.0)  # of a PC that is busy
    monkeypatch.setattr(
        release, "time", SimpleNamespace(monotonic=lambda: next(looks_s), sleep=lambda _: None)
    )
    rail.close()
    assert peer.axis.state == DISABLED
    assert not peer.quick_stopped.is_set()
