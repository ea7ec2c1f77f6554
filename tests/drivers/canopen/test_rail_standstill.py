"""A rail whose servo hunts, creeps, or is home at once, as the driver judges it."""

from __future__ import annotations

import pytest

from drivers import motion_limits, standstill
from drivers.canopen import drive
from drivers.canopen import rail as canopen_rail
from hilcell.cell.file import load_cell
from hilcell.run.interlocks import ROBOT_BLOCKED, Blocked, check_held
from tests.drivers.canopen.can_peer import DISABLED, DRIVE, ENABLED, CanPeer, u16, u32
from tests.drivers.canopen.rail_bed import RailTime, connected, peer, rail_for, time
from tests.drivers.peers import figure, refusal

__all__ = ["peer", "time"]

CELL = load_cell("paper")


@pytest.fixture(autouse=True)
def _hunts(peer: CanPeer) -> None:
    peer.axis.hunts = True


def test_a_servo_that_hunts_connects_homes_moves_settles_holds_and_closes(
    peer: CanPeer, time: RailTime
) -> None:
    peer.axis.state, peer.axis.mode = ENABLED, 1  # somebody has left it with its power on
    rail = rail_for(peer, time)
    rail.connect()
    assert peer.axis.state != ENABLED
    rail.home()
    rail.move_to(700.0)
    moved = rail.read()
    assert moved.still
    assert moved.powered
    assert moved.velocity_mm_s != 0.0
    assert rail.settle().position_mm == pytest.approx(700.0, abs=0.003)
    rail.hold()
    assert not rail.read().powered
    rail.move_to(701.0)
    rail.close()
    assert peer.axis.state == DISABLED
    assert not peer.quick_stopped.is_set()


@pytest.mark.parametrize("powered", [True, False])
def test_a_slide_that_creeps_is_refused(peer: CanPeer, time: RailTime, powered: bool) -> None:
    with connected(peer, time, standstill_dwell_s=0.4) as rail:
        if powered:
            peer.axis.state = ENABLED
        began_s, start = time.now_s(), peer.axis.position

        def creep() -> None:
            peer.axis.position = start + round(1000.0 * 0.05 * (time.now_s() - began_s))

        peer.on_sync = creep
        assert refusal(rail.settle).code == "HC-S06"
        reading = rail.read()
        assert not reading.still
        assert abs(reading.velocity_mm_s) < 0.5
        with pytest.raises(Blocked):
            check_held(CELL, reading, None, ROBOT_BLOCKED)
        peer.on_sync = lambda: None


def test_a_strip_that_creeps_alone_is_refused(peer: CanPeer, time: RailTime) -> None:
    with connected(peer, time) as rail:
        peer.jitter = 1
        peer.on_sync = lambda: setattr(peer, "strip_offset", round(80 * time.now_s()))
        assert refusal(rail.settle).code == "HC-S06"
        assert not rail.read().still


@pytest.mark.parametrize(
    ("narrow", "field"),
    [
        ({"standstill_speed_mm_s": 0.05}, "speed_mm_s"),
        ({"standstill_window_mm": 0.002}, "spread_mm"),
    ],
)
def test_a_window_too_narrow_for_this_servo_is_named_with_its_option(
    peer: CanPeer, time: RailTime, narrow: dict[str, float], field: str
) -> None:
    with connected(peer, time, **narrow) as rail:
        found = refusal(lambda: rail.move_to(700.0))
        ((option, limit),) = narrow.items()
        assert found.code == "HC-R43"
        assert figure(found, field) > limit
        assert option in found.act
        assert abs(peer.axis.position - 700_000) < 10


def test_a_long_dwell_is_no_lack_of_progress(
    peer: CanPeer, time: RailTime, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(standstill.Windows, "LONGEST_PAUSE_S", 0.01)
    monkeypatch.setattr(drive.Drive, "STALL_S", 0.1)
    monkeypatch.setattr(canopen_rail.Release, "RELEASE_S", 0.1)
    with connected(peer, time, standstill_dwell_s=0.3) as rail:
        rail.move_to(700.0)
        assert rail.settle().still
    assert peer.axis.state == DISABLED


def test_a_slide_at_rest_is_confirmed_by_one_poll(peer: CanPeer, time: RailTime) -> None:
    with connected(peer, time) as rail:
        assert rail.read().still
        before = len(peer.frames(0x080))
        assert all(rail.read().still for _ in range(10))
        assert len(peer.frames(0x080)) - before == 10


def test_a_strip_that_flickers_is_read_by_its_middle_and_one_that_moves_is_seen(
    peer: CanPeer, time: RailTime
) -> None:
    with connected(peer, time) as rail:
        flicker = iter([0, 1, 0, -1] * 1000)
        moved = 0
        peer.on_sync = lambda: setattr(peer, "strip_offset", moved + next(flicker))
        assert {rail.read().strip_mm for _ in range(20)} == {500.0}
        moved = 3
        assert rail.read().strip_mm == 500.03


def test_drive_and_strip_are_medians_of_the_same_readings(peer: CanPeer, time: RailTime) -> None:
    with connected(peer, time) as rail:
        rail.read()
        steps = iter([0, 6, 0, 6, 6])
        at = peer.axis.position
        peer.on_sync = lambda: setattr(peer.axis, "position", at + next(steps))
        found = [rail.read() for _ in range(5)][-1]
        assert found.position_mm == 500.006
        assert found.strip_mm == 500.0
        peer.on_sync = lambda: None


@pytest.mark.parametrize("stale", [False, True])
def test_a_drive_that_is_home_within_one_poll_is_believed(
    peer: CanPeer, time: RailTime, stale: bool
) -> None:
    with connected(peer, time) as rail:
        peer.axis.homes_at_once = True
        if stale:
            peer.axis.mode, peer.axis.bits = 6, 0x1400
        rail.home()
        assert rail.read().position_mm == pytest.approx(0.0, abs=0.003)
        rail.move_to(10.0)
        rail.home()


def test_a_drive_that_creeps_on_for_ever_ends(
    peer: CanPeer, time: RailTime, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(motion_limits.MotionLimits, "MARGIN_S", 0.2)
    with connected(peer, time) as rail:

        def crawl() -> None:
            peer.axis.frozen = True
            peer.axis.position += 100 if peer.axis.steps else 0

        peer.on_sync = crawl
        found = refusal(lambda: rail.move_to(500.01))
        assert found.code == "HC-R28"
        assert 500.01 < figure(found, "position_mm") < 600.0
        peer.quick_stopped.wait()
        peer.on_sync = lambda: None


WINDOWS = {0x6067: (u32, 50), 0x6068: (u16, 50), 0x606F: (u16, 500), 0x6070: (u16, 50)}


def test_the_drives_own_windows_are_set(peer: CanPeer, time: RailTime) -> None:
    peer.objects[DRIVE] |= {(index, 0): pack(0) for index, (pack, _) in WINDOWS.items()}
    with connected(peer, time):
        for index, (pack, value) in WINDOWS.items():
            assert peer.objects[DRIVE][index, 0] == pack(value)


def test_a_drive_without_windows_is_no_fault_and_one_that_refuses_them_is(
    peer: CanPeer, time: RailTime
) -> None:
    for code in (0x06020000, 0x06090011):
        peer.abort |= dict.fromkeys(((index, 0) for index in WINDOWS), code)
        with connected(peer, time):
            pass
    peer.abort[0x6067, 0] = 0x06090030
    assert refusal(rail_for(peer, time).connect).fields["abort_code"] == 0x06090030
