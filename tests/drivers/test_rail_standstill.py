"""A rail whose servo hunts, creeps, or is home at once, as the driver judges it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest

from drivers import motion_limits, standing, standstill
from drivers.canopen import drive, release
from drivers.canopen.rail import CanopenRail
from hilcell.cell.file import load_cell
from hilcell.ports import DeviceError
from hilcell.run.interlocks import ROBOT_BLOCKED, Blocked, check_held
from tests.drivers.can_peer import DISABLED, DRIVE, ENABLED, CanPeer, u16, u32
from tests.drivers.peers import wall_clock

CELL = load_cell("paper")


@pytest.fixture(autouse=True)
def short_deadlines(monkeypatch: pytest.MonkeyPatch) -> None:
    for module, name, value in (
        (drive, "STALL_S", 0.3),
        (drive, "POLL_S", 0.002),
        (standing, "POLL_S", 0.002),
        (release, "POLL_S", 0.002),
        (standing, "SETTLE_S", 0.6),
        (release, "RELEASE_S", 0.5),
    ):
        monkeypatch.setattr(module, name, value)


def rail_for(peer: CanPeer, dwell_s: float = 0.01, **windows: Any) -> CanopenRail:
    options = CanopenRail.Options(
        channel=peer.channel,
        travel_min_mm=0.0,
        travel_max_mm=3000.0,
        speed_mm_s=250.0,
        acceleration_mm_s2=200.0,
        standstill_dwell_s=dwell_s,
        **windows,
    )
    return CanopenRail(options, wall_clock())


@pytest.fixture
def peer() -> Iterator[CanPeer]:
    with CanPeer() as peer:
        peer.axis.hunts = True
        yield peer


def test_a_servo_that_hunts_connects_homes_moves_settles_holds_and_closes(peer: CanPeer) -> None:
    peer.axis.state, peer.axis.mode = ENABLED, 1  # somebody has left it with its power on
    rail = rail_for(peer)
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


def creep(peer: CanPeer, mm_s: float) -> None:
    began_s, start = time.monotonic(), peer.axis.position

    def go() -> None:
        peer.axis.position = start + round(1000.0 * mm_s * (time.monotonic() - began_s))

    peer.on_sync = go


@pytest.mark.parametrize("powered", [True, False])
def test_a_slide_that_creeps_is_refused(peer: CanPeer, powered: bool) -> None:
    rail = rail_for(peer, dwell_s=0.4)
    rail.connect()
    if powered:
        peer.axis.state = ENABLED
    creep(peer, 0.05)
    with pytest.raises(DeviceError, match=r"wanted 5 readings .* the drive's within 0\.010 mm"):
        rail.settle()
    reading = rail.read()
    assert not reading.still
    assert abs(reading.velocity_mm_s) < 0.5
    with pytest.raises(Blocked, match=r"slide moves at .* wanted at rest"):
        check_held(CELL, reading, None, ROBOT_BLOCKED)
    peer.on_sync = lambda: None
    rail.close()


@pytest.mark.parametrize(
    ("narrow", "found", "wanted"),
    [
        ({"standstill_speed_mm_s": 0.05}, r"speed 0\.060 mm/s", r"<= 0\.050 mm/s"),
        ({"standstill_window_mm": 0.002}, r"drive within 0\.00[3-5] mm", r"0\.002 mm and"),
    ],
)
def test_a_window_too_narrow_for_this_servo_is_named_with_its_option(
    peer: CanPeer, narrow: dict[str, float], found: str, wanted: str
) -> None:
    rail = rail_for(peer, **narrow)
    rail.connect()
    (option,) = narrow
    with pytest.raises(
        DeviceError, match=f"not come to rest: .*{found}.*, wanted .*{wanted}.*{option}"
    ) as raised:
        rail.move_to(700.0)
    assert raised.value.code == "HC-R43"
    assert abs(peer.axis.position - 700_000) < 10
    rail.close()


def test_a_long_dwell_is_no_lack_of_progress(
    peer: CanPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(standstill, "LONGEST_PAUSE_S", 0.01)
    monkeypatch.setattr(drive, "STALL_S", 0.1)
    monkeypatch.setattr(release, "RELEASE_S", 0.1)
    rail = rail_for(peer, dwell_s=0.3)
    rail.connect()
    rail.move_to(700.0)
    assert rail.settle().still
    rail.close()
    assert peer.axis.state == DISABLED


def test_a_strip_that_creeps_alone_is_refused(peer: CanPeer) -> None:
    rail = rail_for(peer, dwell_s=0.05)
    rail.connect()
    began_s = time.monotonic()
    peer.jitter = 1
    peer.on_sync = lambda: setattr(peer, "strip_offset", round(80 * (time.monotonic() - began_s)))
    with pytest.raises(DeviceError, match=r"wanted 5 readings within \+-1 count"):
        rail.settle()
    assert not rail.read().still
    rail.close()


def test_a_slide_at_rest_is_confirmed_by_one_poll(peer: CanPeer) -> None:
    rail = rail_for(peer)
    rail.connect()
    assert rail.read().still
    before = len(peer.frames(0x080))
    assert all(rail.read().still for _ in range(10))
    assert len(peer.frames(0x080)) - before == 10
    rail.close()


def test_a_strip_that_flickers_is_read_by_its_middle_and_one_that_moves_is_seen(
    peer: CanPeer,
) -> None:
    rail = rail_for(peer)
    rail.connect()
    flicker = iter([0, 1, 0, -1] * 1000)
    moved = 0
    peer.on_sync = lambda: setattr(peer, "strip_offset", moved + next(flicker))
    assert {rail.read().strip_mm for _ in range(20)} == {500.0}
    moved = 3
    assert rail.read().strip_mm == 500.03
    rail.close()


def test_drive_and_strip_are_medians_of_the_same_readings(peer: CanPeer) -> None:
    rail = rail_for(peer)
    rail.connect()
    rail.read()
    steps = iter([0, 6, 0, 6, 6])
    at = peer.axis.position
    peer.on_sync = lambda: setattr(peer.axis, "position", at + next(steps))
    found = [rail.read() for _ in range(5)][-1]
    assert found.position_mm == 500.006
    assert found.strip_mm == 500.0
    peer.on_sync = lambda: None
    rail.close()


@pytest.mark.parametrize("stale", [False, True])
def test_a_drive_that_is_home_within_one_poll_is_believed(peer: CanPeer, stale: bool) -> None:
    rail = rail_for(peer)
    rail.connect()
    peer.axis.homes_at_once = True
    if stale:
        peer.axis.mode, peer.axis.bits = 6, 0x1400
    rail.home()
    assert rail.read().position_mm == pytest.approx(0.0, abs=0.003)
    rail.move_to(10.0)
    rail.home()
    rail.close()


def test_a_drive_that_creeps_on_for_ever_ends(
    peer: CanPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(motion_limits, "MARGIN_S", 0.2)
    rail = rail_for(peer)
    rail.connect()

    def crawl() -> None:
        peer.axis.frozen = True
        peer.axis.position += 100 if peer.axis.steps else 0

    peer.on_sync = crawl
    with pytest.raises(
        DeviceError, match=r"not done after 0 s at 5\d\d\.\d+ mm.*wanted target .* within 0 s"
    ):
        rail.move_to(500.01)
    assert peer.quick_stopped.wait(5)
    peer.on_sync = lambda: None
    rail.close()


WINDOWS = {0x6067: (u32, 50), 0x6068: (u16, 10), 0x606F: (u16, 500), 0x6070: (u16, 10)}


def test_the_drives_own_windows_are_set(peer: CanPeer) -> None:
    peer.objects[DRIVE] |= {(index, 0): pack(0) for index, (pack, _) in WINDOWS.items()}
    rail = rail_for(peer)
    rail.connect()
    for index, (pack, value) in WINDOWS.items():
        assert peer.objects[DRIVE][index, 0] == pack(value)
    rail.close()


@pytest.mark.parametrize("code", [0x06020000, 0x06090011])
def test_a_drive_without_windows_is_no_fault(peer: CanPeer, code: int) -> None:
    peer.abort |= dict.fromkeys(((index, 0) for index in WINDOWS), code)
    rail = rail_for(peer)
    rail.connect()
    rail.close()


def test_a_window_that_is_refused_otherwise_is_a_fault(peer: CanPeer) -> None:
    peer.abort[0x6067, 0] = 0x06090030
    with pytest.raises(DeviceError, match="6067h:00: SDO abort 0x06090030"):
        rail_for(peer).connect()
