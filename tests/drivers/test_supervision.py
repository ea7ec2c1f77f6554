"""Deadlines of waits, motions and progress: a PC that is late excuses its devices."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from drivers import supervision
from drivers.device_errors import RAIL, ROBOT
from drivers.supervision import (
    LATE_S,
    Deadline,
    MotionLimits,
    Watchdog,
    check_sweep,
    checked_target,
    planned_s,
    polls,
)
from hilcell.ports import DeviceError
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


@pytest.mark.parametrize("limit_s", [0.0, float("nan")])
def test_no_time_is_over_at_once(time: Time, limit_s: float) -> None:
    assert Deadline(limit_s).expired()


def test_a_motion_without_a_look_stops_and_one_that_has_ended_needs_none() -> None:
    clock = DrivenClock()
    watch = Watchdog(ROBOT, "HC-B27", clock)
    watch.feed()
    watch.start()
    clock.pc_at_s += LATE_S - 0.01
    watch.feed()
    clock.pc_at_s += LATE_S + 0.5
    error = refusal(watch.feed)
    assert error.code == "HC-B27"
    assert error.fields == {"gap_s": pytest.approx(1.5), "limit_s": 1.0}
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


def limits(planned: float = 2.0, stall_s: float = 0.0) -> MotionLimits:
    return MotionLimits(planned, stall_s=stall_s, progress=0.01)


def test_the_slowest_axis_sets_the_plan() -> None:
    assert planned_s(np.array([10.0, -80.0]), np.array([100.0, 50.0]), 25.0) == 6.4


def test_a_motion_may_take_several_times_its_plan() -> None:
    motion = limits()
    allowed_s = MotionLimits.PLANNED_TIMES * 2.0 + MotionLimits.MARGIN_S
    assert not motion.overdue(1000.0, 100)
    assert not motion.overdue(1000.0 + allowed_s, 100)
    assert motion.overdue(1000.1 + allowed_s, 100)


def test_a_lowered_override_stretches_the_time() -> None:
    motion = limits()
    assert not motion.overdue(0.0, 100)
    assert not motion.overdue(100.0, 10)  # whenever it was lowered, it counts for all of the gap
    assert motion.spent_s == pytest.approx(10.0)
    assert not motion.overdue(160.0, 10)
    assert motion.overdue(161.0, 10)


@pytest.mark.parametrize("angle", [np.nan, np.inf, -np.inf, 1e307])
def test_an_angle_that_is_finite_in_one_unit_alone_is_no_target(angle: float) -> None:
    joints_rad = np.array([0.0, 0.1, angle, 0.0, 0.0, 0.0])
    with pytest.raises(DeviceError, match="six finite angles") as caught:
        checked_target(joints_rad, 10.0)
    assert caught.value.code == "HC-B28"


@pytest.mark.parametrize("planned", [np.nan, 2.0])
def test_a_time_that_is_no_number_is_overdue(planned: float) -> None:
    motion = limits(planned)
    motion.overdue(0.0, 100)
    assert motion.overdue(np.nan if planned == 2.0 else 1.0, 100)


def test_a_pause_of_the_pc_is_no_long_motion_in_a_fast_cell() -> None:
    motion = limits(stall_s=5.0)
    assert not motion.overdue(0.0, 100)
    assert not motion.overdue(1000.0, 100)


def test_flicker_is_no_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = iter(np.arange(0.0, 100.0, 0.5))
    monkeypatch.setattr(supervision, "time", SimpleNamespace(monotonic=lambda: next(now_s)))
    motion = limits(stall_s=5.0)
    at = np.array([10.0, 20.0])
    looks = [motion.stalled(at + 1e-4 * (-1.0) ** look) for look in range(12)]
    assert looks == [False] * 10 + [True] * 2
    assert not motion.stalled(at + 0.02)


@pytest.mark.parametrize("step_deg", [0.02, -0.02])
def test_progress_is_progress_in_either_direction(step_deg: float) -> None:
    motion = MotionLimits(2.0, stall_s=0.0, progress=0.01)
    at = np.array([10.0, 20.0])
    assert [motion.stalled(at), motion.stalled(at)] == [False, True]
    assert not motion.stalled(at + step_deg)


def test_an_axis_that_is_no_number_never_counts_as_at_rest() -> None:
    motion = limits()
    assert not motion.stalled(np.array([np.nan, 0.0]))


def test_an_axis_at_rest_is_not_overdue() -> None:
    motion = MotionLimits(2.0, stall_s=0.0, progress=0.01)
    at = np.array([10.0])
    motion.stalled(at)
    assert not motion.overdue(0.0, 100)
    motion.stalled(at)
    assert not motion.overdue(1000.0, 100)
    motion.stalled(at + 0.02)
    assert motion.overdue(1001.0, 100)


NAN = float("nan")


@pytest.mark.parametrize(
    ("end_rad", "speed_rad_s", "full_rad_s"),
    [(NAN, 0.01, 1.0), (0.5, NAN, 1.0), (0.5, 9e-5, 1.0), (0.5, 1.1, 1.0), (0.5, 0.01, NAN)],
)
def test_an_impossible_sweep_is_refused(
    end_rad: float, speed_rad_s: float, full_rad_s: float
) -> None:
    error = refusal(lambda: check_sweep(2, end_rad, speed_rad_s, full_rad_s))
    assert error.code == "HC-B28"
    assert error.found == f"axis 3 to {end_rad} rad at {speed_rad_s} rad/s"
    check_sweep(2, 0.5, 1e-4, 1.0)
    check_sweep(2, 0.5, 1.0, 1.0)
