"""Standstill by polls: speed, spread of both positions, dwell; and a rail whose servo hunts."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from drivers import slide, supervision
from drivers.canopen import drive
from drivers.canopen import rail as canopen_rail
from drivers.canopen.process_image import Snapshot
from drivers.slide import Rest, Standstill, Windows
from drivers.supervision import Watchdog
from hilcell.cell.file import load_cell
from hilcell.run.interlocks import ROBOT_BLOCKED, Blocked, check_held
from tests.drivers.canopen.can_peer import DISABLED, DRIVE, ENABLED, CanPeer, u16, u32
from tests.drivers.canopen.rail_bed import BedRail, RailBed
from tests.drivers.peers import figure, refusal

WINDOWS = Windows(speed=500.0, spread=10, strip_spread=2, dwell_s=0.25)


def poll(position: int = 1000, strip: int = 100, velocity: Any = 30) -> Snapshot:
    return Snapshot(position, velocity, strip, 0, True, 0.0, 0x27, 1)


@pytest.mark.parametrize(
    ("statusword", "powered"),
    [(0x27, True), (0x07, True), (0x0F, True), (0x08, False), (0x23, False), (0x40, False)],
)
def test_a_drive_has_power_until_its_brakes_have_ended(statusword: int, powered: bool) -> None:
    now = Snapshot.of(statusword, 1000, 30, strip=100, alarms=1, taken_s=2.0, mode=8)
    assert now == Snapshot(1000, 30, 100, 1, powered, 2.0, statusword, 8)


def after(*polls: Snapshot, every_s: float = 0.1) -> Standstill:
    standstill = Standstill(WINDOWS)
    for n, each in enumerate(polls):
        standstill.add(each, n * every_s)
    return standstill


DITHER = [poll(1000 + d, 100 + j) for d, j in ((0, 0), (3, 1), (-2, 0), (1, -1), (-3, 0), (2, 1))]


def test_a_servo_that_dithers_is_at_rest() -> None:
    assert after(*DITHER).rest == Rest(1001, 100)


def test_a_dwell_and_five_readings_are_needed() -> None:
    assert after(*DITHER[:4]).rest is None, "four readings"
    assert after(*DITHER, every_s=0.04).rest is None, "0.2 s"
    assert after(*DITHER, every_s=0.05).rest is not None


@pytest.mark.parametrize("velocity", [501, -501, math.nan, math.inf, -math.inf])
def test_a_speed_beyond_the_window_is_no_rest(velocity: float) -> None:
    assert after(*DITHER, poll(velocity=velocity)).rest is None
    assert after(*DITHER, poll(velocity=velocity), *DITHER[:4]).rest is None


@pytest.mark.parametrize(("drive_rate", "strip_rate"), [(5, 0), (-5, 0), (0, 1), (0, -1)])
def test_a_creep_is_detected_by_drive_or_strip(drive_rate: int, strip_rate: int) -> None:
    polls = [poll(drive_rate * n, strip_rate * n, velocity=0) for n in range(30)]
    assert after(*polls).rest is None


def test_a_strip_in_alarm_has_no_position_and_the_reading_says_so() -> None:
    dirty = replace(poll(strip=99_000), alarms=1)
    standstill = after(*DITHER, dirty)
    assert standstill.rest is not None
    assert standstill.rest.alarms == 1
    for n in range(5):
        standstill.add(poll(), 1.0 + n * 0.1)
    assert standstill.rest == Rest(1000, 100)
    assert after(dirty, *(replace(poll(20 * n), alarms=1) for n in range(9))).rest is None


@pytest.mark.parametrize(
    ("later", "at_s", "at_rest"),
    [
        (poll(1002, 99), 5.0, True),
        (poll(position=1014), 5.0, False),
        (poll(strip=103), 5.0, False),
        (poll(strip=97), 5.0, False),
        (poll(), 0.6 + Standstill.HISTORY_S, False),  # an old history counts for nothing
    ],
)
def test_one_poll_confirms_a_slide_at_rest_or_shows_that_it_has_moved(
    later: Snapshot, at_s: float, at_rest: bool
) -> None:
    standstill = after(*DITHER)
    standstill.add(later, at_s)
    assert (standstill.rest is not None) is at_rest


def test_polls_before_a_motion_are_forgotten() -> None:
    standstill = after(*DITHER)
    standstill.forget()
    standstill.add(poll(), 5.0)
    assert standstill.rest is None


def test_a_slide_that_came_to_rest_is_read_by_later_polls() -> None:
    path = [poll(1000 * n, 100 * n, velocity=400) for n in range(9)]
    assert after(*path, *[poll(9000, 900)] * 5).rest == Rest(9000, 900)


def test_a_reading_is_the_median_of_the_last_five_polls() -> None:
    assert after(*[poll(1000 + n) for n in range(10)], every_s=0.05).rest == Rest(1007, 100)


@pytest.mark.parametrize("dwell_s", [0.05, 0.25, 0.4, 1.0, 5.0])
def test_a_dwell_of_any_length_is_polled_often_enough_for_the_heartbeat(dwell_s: float) -> None:
    windows = Windows(speed=500.0, spread=10, strip_spread=2, dwell_s=dwell_s)
    assert windows.interval_s < Watchdog.FED_S / 2
    standstill = Standstill(windows)
    for n in range(windows.polls):
        standstill.add(poll(), n * windows.interval_s)
    assert standstill.rest == Rest(1000, 100)


def test_the_largest_motion_of_the_last_polls_is_reported() -> None:
    polls = [poll(1000 + 7 * n, 100 - n, (-1) ** n * 600) for n in range(4)]
    assert after(poll(velocity=9000), *polls, poll(1000, 100)).spreads == (600, 21, 3)


# -- a rail whose servo hunts -----------------------------------------------------------------


@pytest.fixture
def peer(peer: CanPeer) -> CanPeer:
    peer.axis.hunts = True
    return peer


def test_a_servo_that_hunts_connects_homes_moves_settles_holds_and_closes(bed: RailBed) -> None:
    peer = bed.peer
    peer.axis.state, peer.axis.mode = ENABLED, 1  # left with its power on
    rail = bed.connect()
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
def test_a_slide_that_creeps_is_refused(bed: RailBed, powered: bool) -> None:
    rail = bed.connect(standstill_dwell_s=0.4)
    if powered:
        bed.peer.axis.state = ENABLED
    began_s, start = bed.time.now_s(), bed.peer.axis.position

    def creep() -> None:
        bed.peer.axis.position = start + round(1000.0 * 0.05 * (bed.time.now_s() - began_s))

    bed.peer.on_sync = creep
    assert refusal(rail.settle).code == "HC-S06"
    reading = rail.read()
    assert not reading.still
    assert abs(reading.velocity_mm_s) < 0.5
    with pytest.raises(Blocked):
        check_held(load_cell("paper"), reading, None, ROBOT_BLOCKED)


def test_a_strip_that_creeps_alone_is_refused(rail: BedRail) -> None:
    rail.peer.jitter = 1
    rail.peer.on_sync = lambda: setattr(rail.peer, "strip_offset", round(80 * rail.time.now_s()))
    assert refusal(rail.settle).code == "HC-S06"
    assert not rail.read().still


@pytest.mark.parametrize(
    ("option", "limit", "field"),
    [("standstill_speed_mm_s", 0.05, "speed_mm_s"), ("standstill_window_mm", 0.002, "spread_mm")],
)
def test_a_window_too_narrow_for_this_servo_is_named_with_its_option(
    bed: RailBed, option: str, limit: float, field: str
) -> None:
    rail = bed.connect(**{option: limit})
    error = refusal(lambda: rail.move_to(700.0))
    assert error.code == "HC-R43"
    assert figure(error, field) > limit
    assert option in error.act
    assert abs(bed.peer.axis.position - 700_000) < 10


def test_a_long_dwell_is_no_lack_of_progress(bed: RailBed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slide.Windows, "LONGEST_PAUSE_S", 0.01)
    monkeypatch.setattr(drive.Drive, "STALL_S", 0.1)
    monkeypatch.setattr(canopen_rail.Release, "RELEASE_S", 0.1)
    rail = bed.connect(standstill_dwell_s=0.3)
    rail.move_to(700.0)
    assert rail.settle().still
    rail.close()
    assert bed.peer.axis.state == DISABLED


def test_a_slide_at_rest_is_confirmed_by_one_poll(rail: BedRail) -> None:
    assert rail.read().still
    before = len(rail.peer.frames(0x080))
    assert all(rail.read().still for _ in range(10))
    assert len(rail.peer.frames(0x080)) - before == 10


def test_a_strip_that_flickers_is_read_by_its_median_and_one_that_moves_is_detected(
    rail: BedRail,
) -> None:
    flicker = iter([0, 1, 0, -1] * 1000)
    moved = 0
    rail.peer.on_sync = lambda: setattr(rail.peer, "strip_offset", moved + next(flicker))
    assert {rail.read().strip_mm for _ in range(20)} == {500.0}
    moved = 3
    assert rail.read().strip_mm == 500.03


def test_drive_and_strip_are_medians_of_the_same_readings(rail: BedRail) -> None:
    rail.read()
    steps = iter([0, 6, 0, 6, 6])
    at = rail.peer.axis.position
    rail.peer.on_sync = lambda: setattr(rail.peer.axis, "position", at + next(steps, 6))
    last = [rail.read() for _ in range(5)][-1]
    assert (last.position_mm, last.strip_mm) == (500.006, 500.0)


@pytest.mark.parametrize("stale", [False, True])
def test_a_drive_that_is_home_within_one_poll_is_believed(rail: BedRail, stale: bool) -> None:
    rail.peer.axis.homes_at_once = True
    if stale:
        rail.peer.axis.mode, rail.peer.axis.bits = 6, 0x1400
    rail.home()
    assert rail.read().position_mm == pytest.approx(0.0, abs=0.003)
    rail.move_to(10.0)
    rail.home()


def test_a_drive_that_creeps_on_for_ever_ends(
    rail: BedRail, monkeypatch: pytest.MonkeyPatch
) -> None:
    peer = rail.peer
    monkeypatch.setattr(supervision.MotionLimits, "MARGIN_S", 0.2)

    def crawl() -> None:
        peer.axis.frozen = True
        peer.axis.position += 100 if peer.axis.steps else 0

    peer.on_sync = crawl
    error = refusal(lambda: rail.move_to(500.01))
    assert error.code == "HC-R28"
    assert 500.01 < figure(error, "position_mm") < 600.0
    peer.quick_stopped.wait()


DRIVE_WINDOWS = {0x6067: (u32, 50), 0x6068: (u16, 50), 0x606F: (u16, 500), 0x6070: (u16, 50)}


def test_the_drives_own_windows_are_set(bed: RailBed) -> None:
    bed.peer.objects[DRIVE] |= {(index, 0): pack(0) for index, (pack, _) in DRIVE_WINDOWS.items()}
    bed.connect()
    for index, (pack, value) in DRIVE_WINDOWS.items():
        assert bed.peer.objects[DRIVE][index, 0] == pack(value)


def test_a_drive_without_windows_is_no_fault_and_one_that_refuses_them_is(bed: RailBed) -> None:
    for code in (0x06020000, 0x06090011):
        bed.peer.abort |= dict.fromkeys(((index, 0) for index in DRIVE_WINDOWS), code)
        bed.connect().close()
    bed.peer.abort[0x6067, 0] = 0x06090030
    assert refusal(bed.connect).fields["abort_code"] == 0x06090030
