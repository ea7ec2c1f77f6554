from __future__ import annotations

from types import SimpleNamespace

import pytest

from drivers import supervision
from drivers.device_errors import RAIL, ROBOT
from drivers.supervision import LATE_S, Deadline, Watchdog, polls
from tests.clocks import DrivenClock
from tests.drivers.peers import refusal


class Time:
    """A clock that a test puts on."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 100.0
        monkeypatch.setattr(supervision, "time", SimpleNamespace(monotonic=lambda: self.now_s))

    def polls(self, deadline: Deadline, every_s: float) -> int:
        """Return how many looks it takes until deadline is over."""
        for count in range(1, 10_000):
            self.now_s += every_s
            if deadline.expired():
                return count
        raise AssertionError("it never ends")


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch) -> Time:
    return Time(monkeypatch)


def test_a_pc_that_polls_often_waits_as_long_as_it_says(time: Time) -> None:
    assert time.polls(Deadline(2.0), every_s=0.02) in (100, 101)


def test_one_more_look_is_made_after_the_time_was_up(time: Time) -> None:
    seen = list[bool]()
    for last in polls(1.0, step_s=0.4):
        seen.append(last)
        time.now_s += 10.0
    assert seen == [False, False, False, True]


@pytest.mark.parametrize("gap_s", [0.2, 2.0, 60.0])
def test_a_gap_of_the_pc_counts_as_one_poll(time: Time, gap_s: float) -> None:
    assert time.polls(Deadline(2.0), every_s=gap_s) in (20, 21)


def test_no_patience_is_over_at_once(time: Time) -> None:
    assert Deadline(0.0).expired()


def test_a_limit_that_is_no_number_is_over_at_once(time: Time) -> None:
    assert Deadline(float("nan")).expired()


def test_a_motion_without_a_look_stops() -> None:
    clock = DrivenClock()
    watch = Watchdog(ROBOT, "HC-B27", clock)
    watch.start()
    clock.pc_at_s += LATE_S - 0.01
    watch.feed()
    clock.pc_at_s += LATE_S + 0.5
    error = refusal(watch.feed)
    assert error.code == "HC-B27"
    assert error.fields == {"gap_s": pytest.approx(1.5), "limit_s": 1.0}


def test_a_robot_at_rest_needs_no_poll() -> None:
    clock = DrivenClock()
    watch = Watchdog(ROBOT, "HC-B27", clock)
    watch.feed()
    watch.start()
    watch.stop()
    clock.pc_at_s += 60.0
    watch.feed()


def test_a_heartbeat_pauses_when_the_motion_is_not_polled() -> None:
    clock = DrivenClock()
    watch = Watchdog(RAIL, "HC-R39", clock, late_s=0.8)
    with watch.motion():
        clock.pc_at_s += 0.41
        assert not watch.is_fed()
        watch.check()
        watch.feed()
        assert watch.is_fed()
        clock.pc_at_s += 0.81
        assert refusal(watch.check).fields == {"gap_s": pytest.approx(0.81), "limit_s": 0.8}
    assert watch.is_fed()
    watch.check()
