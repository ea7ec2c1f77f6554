"""Standstill is judged from polls: speed, spread of both positions, dwell."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from drivers.canopen.process_image import Snapshot
from drivers.standstill import Rest, Standstill, Windows
from drivers.supervision import Supervision

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
        standstill.take(each, n * every_s)
    return standstill


DITHER = [poll(1000 + d, 100 + j) for d, j in ((0, 0), (3, 1), (-2, 0), (1, -1), (-3, 0), (2, 1))]


def test_a_servo_that_dithers_stands() -> None:
    assert after(*DITHER).rest == Rest(1001, 100)


def test_a_dwell_and_five_readings_are_wanted() -> None:
    assert after(*DITHER[:4]).rest is None, "four readings"
    assert after(*DITHER, every_s=0.04).rest is None, "0.2 s"
    assert after(*DITHER, every_s=0.05).rest is not None


@pytest.mark.parametrize("velocity", [501, -501, math.nan, math.inf, -math.inf])
def test_a_speed_beyond_the_window_is_no_rest(velocity: float) -> None:
    assert after(*DITHER, poll(velocity=velocity)).rest is None
    assert after(*DITHER, poll(velocity=velocity), *DITHER[:4]).rest is None


@pytest.mark.parametrize(("drive_rate", "strip_rate"), [(5, 0), (-5, 0), (0, 1), (0, -1)])
def test_a_creep_is_seen_by_drive_or_strip(drive_rate: int, strip_rate: int) -> None:
    polls = [poll(drive_rate * n, strip_rate * n, velocity=0) for n in range(30)]
    assert after(*polls).rest is None


def test_a_strip_in_alarm_has_no_position_and_the_reading_says_so() -> None:
    dirty = replace(poll(strip=99_000), alarms=1)
    standstill = after(*DITHER, dirty)
    assert standstill.rest is not None
    assert standstill.rest.alarms == 1
    for n in range(5):
        standstill.take(poll(), 1.0 + n * 0.1)
    assert standstill.rest == Rest(1000, 100)
    assert after(dirty, *(replace(poll(20 * n), alarms=1) for n in range(9))).rest is None


def test_one_poll_confirms_a_slide_that_has_stood() -> None:
    standstill = after(*DITHER)
    standstill.take(poll(1002, 99), 5.0)
    assert standstill.rest is not None


@pytest.mark.parametrize("moved", [poll(position=1014), poll(strip=103), poll(strip=97)])
def test_one_poll_shows_that_the_slide_has_moved(moved: Snapshot) -> None:
    standstill = after(*DITHER)
    standstill.take(moved, 5.0)
    assert standstill.rest is None


def test_an_old_history_counts_for_nothing() -> None:
    standstill = after(*DITHER)
    standstill.take(poll(), 0.6 + Standstill.HISTORY_S)
    assert standstill.rest is None


def test_what_was_before_a_motion_is_forgotten() -> None:
    standstill = after(*DITHER)
    standstill.forget()
    standstill.take(poll(), 5.0)
    assert standstill.rest is None


def test_a_slide_that_came_to_rest_is_read_by_later_polls() -> None:
    way = [poll(1000 * n, 100 * n, velocity=400) for n in range(9)]
    assert after(*way, *[poll(9000, 900)] * 5).rest == Rest(9000, 900)


def test_a_reading_is_the_median_of_the_last_five_polls() -> None:
    assert after(*[poll(1000 + n) for n in range(10)], every_s=0.05).rest == Rest(1007, 100)


@pytest.mark.parametrize("dwell_s", [0.05, 0.25, 0.4, 1.0, 5.0])
def test_a_dwell_of_any_length_is_polled_often_enough_for_the_heartbeat(dwell_s: float) -> None:
    windows = Windows(speed=500.0, spread=10, strip_spread=2, dwell_s=dwell_s)
    assert windows.apart_s < Supervision.ATTENDED_S / 2
    standstill = Standstill(windows)
    for n in range(windows.polls):
        standstill.take(poll(), n * windows.apart_s)
    assert standstill.rest == Rest(1000, 100)


def test_what_keeps_a_slide_from_standing_is_seen() -> None:
    polls = [poll(1000 + 7 * n, 100 - n, (-1) ** n * 600) for n in range(4)]
    assert after(poll(velocity=9000), *polls, poll(1000, 100)).unrest == (600, 21, 3)
