"""The slide as external axis E1 of its robot: one wire for both, and a strip of its own."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from drivers import standing
from drivers.kuka import c3
from drivers.kuka import external as kuka_external
from drivers.kuka import robot as kuka_robot
from drivers.kuka.rail_e1 import KukaE1Rail
from drivers.kuka.robot_c3 import KukaC3Robot
from drivers.strips import serial as strip_serial
from drivers.strips.strip import StripOptions
from hilcell.clock import WallClock
from hilcell.ports import (
    Clock,
    DeviceError,
    DeviceRefused,
    ExternalAxis,
    Rail,
    RidesOnRobot,
    Stopped,
    StripLost,
)
from tests.drivers.kuka_peer import KukaPeer
from tests.drivers.peers import wall_clock
from tests.drivers.strip_peer import StripPeer
from tests.drivers.test_robot_kuka_c3 import TARGET_RAD, robot_for


@pytest.fixture(autouse=True)
def short_deadlines(monkeypatch: pytest.MonkeyPatch) -> None:
    for module, name, value in (
        (c3, "REPLY_S", 0.3),
        (kuka_robot, "POLL_S", 0.002),
        (kuka_robot, "DWELL_S", 0.002),
        (kuka_robot, "STALL_S", 0.3),
        (kuka_external, "STALL_S", 0.3),
        (kuka_external, "POLL_S", 0.002),
        (kuka_external, "SPEED_OVER_S", 10.0),  # the peer's slide is there within three looks
        (kuka_robot, "REST_S", 0.1),
        (kuka_robot, "CATCH_UP_S", 0.2),
        (standing, "POLL_S", 0.002),
        (standing, "SETTLE_S", 0.3),
        (strip_serial, "REPLY_S", 0.1),
    ):
        monkeypatch.setattr(module, name, value)


class Bench:
    """A robot and the rail that rides on it, at their peers."""

    def __init__(self, kuka: KukaPeer, strip: StripPeer, clock: Clock | None = None) -> None:
        self.kuka, self.strip = kuka, strip
        strip.counts = lambda: round(100.0 * kuka.slide_mm)
        self.clock = clock or wall_clock()
        self.robot: KukaC3Robot = robot_for(kuka, self.clock)
        self.rail = self.rail_for()

    def rail_for(self, **options: Any) -> KukaE1Rail:
        values: dict[str, Any] = {
            "strip": StripOptions(driver="serial", channel=self.strip.channel),
            "travel_min_mm": 0.0,
            "travel_max_mm": 3000.0,
            "speed_mm_s": 250.0,
            "standstill_dwell_s": 0.05,
        }
        rail = KukaE1Rail(KukaE1Rail.Options(**(values | options)), self.clock)
        rail.ride(self.robot)
        return rail

    def connect(self) -> None:
        self.robot.connect()
        self.rail.connect()

    def close(self) -> None:
        self.rail.close()
        self.robot.close()


@pytest.fixture
def bench() -> Iterator[Bench]:
    with KukaPeer(**{"$EX_AX_NUM": "1", "$AXIS_JUS[7]": "TRUE"}) as kuka, StripPeer() as strip:
        kuka.slide_mm = 640.0
        bench = Bench(kuka, strip)
        yield bench
        bench.close()


def test_it_is_a_rail_that_rides_on_a_robot_with_an_external_axis(bench: Bench) -> None:
    rail: Rail = bench.rail
    axis: ExternalAxis = bench.robot
    assert isinstance(rail, RidesOnRobot)
    assert isinstance(axis, ExternalAxis)


def test_connect_names_drive_and_strip_and_moves_nothing(bench: Bench) -> None:
    bench.robot.connect()
    drive, strip = bench.rail.connect()
    assert (drive.kind, drive.model) == ("drive", "E1 of #KR210R2700_2 C4 FLR")
    assert (strip.kind, strip.serial) == ("strip", "1234567")
    assert drive.serial == "472911"
    assert "write HC_SEQ" not in bench.kuka.requests


def test_a_motion_goes_alone_at_its_speed_and_ends_held(bench: Bench) -> None:
    bench.connect()
    bench.rail.home()
    bench.rail.move_to(1100.0)
    assert bench.kuka.variables["HC_CMD"] == "2"
    assert bench.kuka.variables["HC_VEL"] == "13"  # of 1890 mm/s, rounded down
    moved = bench.rail.settle()
    assert moved.powered
    assert moved.still
    assert (moved.position_mm, moved.strip_mm) == (1100.0, 1100.0)
    assert moved.ended_s is not None
    assert moved.ended_s <= moved.taken_s
    bench.rail.hold()
    assert not bench.rail.read().powered
    assert bench.kuka.axes == [0.0, -90.0, 90.0, 0.0, 0.0, 0.0]


def test_motions_of_the_arm_carry_the_place_of_the_slide(bench: Bench) -> None:
    bench.connect()
    bench.rail.move_to(1100.0)
    bench.rail.hold()
    bench.robot.move_to(TARGET_RAD, 30.0)
    assert bench.kuka.variables["HC_CMD"] == "1"
    assert "E1 1100.000000" in bench.kuka.variables["HC_TGT"]
    with bench.robot.sweep(0, float(TARGET_RAD[0]) + 0.1, 0.01) as sweep:
        sweep.kickoff()
        sweep.complete()
    assert "E1 1100.000000" in bench.kuka.variables["HC_TGT"]


def test_an_arm_whose_slide_moves_along_is_not_at_rest(bench: Bench) -> None:
    bench.connect()

    def creep() -> None:
        bench.kuka.slide_mm += 0.05

    bench.kuka.moved = creep
    with pytest.raises(DeviceError, match=r"E1 640\.150 mm") as caught:
        bench.robot.move_to(TARGET_RAD, 30.0)
    assert caught.value.code == "HC-B24"


def test_a_slide_that_is_read_twice_at_two_places_moves(bench: Bench) -> None:
    bench.connect()
    places = iter(np.arange(640.1, 700.0, 0.1))

    def mangle(name: str, reply: bytes) -> list[bytes]:
        if name == "$AXIS_ACT":
            bench.kuka.slide_mm = float(next(places))
        return [reply]

    bench.kuka.mangle = mangle
    assert not bench.robot.read().still


def test_the_program_refuses_a_slide_that_is_held(bench: Bench) -> None:
    bench.connect()
    bench.kuka.mangle = lambda name, reply: [_hold(bench.kuka, name) or reply]
    with pytest.raises(DeviceError, match="HC_ERR 4: external axis E1 is held"):
        bench.rail.move_to(1100.0)
    assert bench.kuka.stopped.wait(5)


def _hold(kuka: KukaPeer, name: str) -> bytes:
    if name == "HC_SEQ":
        kuka.variables["HC_HELD"] = "TRUE"
    return b""


def test_a_slide_that_was_pushed_is_named_by_the_arms_motion(bench: Bench) -> None:
    bench.connect()
    bench.kuka.error = "3"
    with pytest.raises(DeviceError) as caught:
        bench.robot.move_to(TARGET_RAD, 30.0)
    assert caught.value.code == "HC-R52"


@pytest.mark.parametrize("target_mm", [-0.1, 3000.1, float("nan"), float("inf")])
def test_a_target_outside_the_travel_is_refused(bench: Bench, target_mm: float) -> None:
    bench.connect()
    with pytest.raises(DeviceError) as caught:
        bench.rail.move_to(target_mm)
    assert caught.value.code == "HC-R36"
    assert "write HC_SEQ" not in bench.kuka.requests


def test_the_controllers_own_limit_stops_it(bench: Bench) -> None:
    bench.connect()
    bench.kuka.error = "2"
    with pytest.raises(DeviceError, match="outside the software limits") as caught:
        bench.rail.move_to(2999.0)
    assert caught.value.code == "HC-B20"
    assert bench.kuka.stopped.wait(5)


@pytest.mark.parametrize(
    ("changed", "code"),
    [
        ({"$EX_AX_NUM": "0"}, "HC-R50"),
        ({"$AXIS_JUS[7]": "FALSE"}, "HC-R51"),
    ],
)
def test_a_robot_that_cannot_move_it_is_refused(
    bench: Bench, changed: dict[str, str], code: str
) -> None:
    bench.kuka.variables |= changed
    bench.robot.connect()
    with pytest.raises(DeviceRefused) as caught:
        bench.rail.connect()
    assert caught.value.code == code


def test_an_axis_that_was_mastered_elsewhere_is_refused(bench: Bench) -> None:
    bench.strip.counts = lambda: round(100.0 * bench.kuka.slide_mm) + 201
    bench.connect()
    with pytest.raises(DeviceError, match="differ") as caught:
        bench.rail.home()
    assert caught.value.code == "HC-R53"


def test_an_axis_that_runs_faster_than_it_should_is_stopped(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kuka_external, "SPEED_OVER_S", 0.001)
    bench.connect()
    bench.kuka.frozen = True  # it runs by itself, without an end
    place = iter(range(100_000))

    def mangle(name: str, reply: bytes) -> list[bytes]:
        if name == "$AXIS_ACT.E1":
            bench.kuka.slide_mm = 640.0 + 50.0 * next(place)
        return [reply]

    bench.kuka.mangle = mangle
    with pytest.raises(DeviceError, match=r"allowed 300\.0 mm/s") as caught:
        bench.rail.move_to(2999.0)
    assert caught.value.code == "HC-R33"
    assert bench.kuka.stopped.wait(5)


@pytest.mark.parametrize(
    ("variable", "value", "code"),
    [
        ("$MODE_OP", "#T1", "HC-B12"),
        ("$ALARM_STOP", "FALSE", "HC-B10"),
        ("$OV_PRO", "0", "HC-B16"),
        ("$PRO_STATE1", "#P_STOP", "HC-B15"),
    ],
)
def test_a_controller_that_is_not_well_ends_the_motion(
    bench: Bench, variable: str, value: str, code: str
) -> None:
    bench.connect()
    bench.kuka.frozen = True
    bench.kuka.variables[variable] = value
    with pytest.raises(DeviceError) as caught:
        bench.rail.move_to(1100.0)
    assert caught.value.code == code
    assert bench.kuka.stopped.wait(5)


def test_a_stop_ends_the_motion_and_only_a_new_connect_moves_again(
    bench: Bench,
) -> None:
    stop = threading.Event()
    other = Bench(bench.kuka, bench.strip, WallClock(stop))
    other.connect()
    bench.kuka.frozen = True
    bench.kuka.mangle = lambda name, reply: [_stop(stop, name, other) or reply]
    with pytest.raises(Stopped):
        other.rail.move_to(1100.0)
    assert bench.kuka.stopped.wait(5)
    bench.kuka.mangle, bench.kuka.frozen = (lambda _name, reply: [reply]), False
    stop.clear()
    with pytest.raises(DeviceError) as caught:
        other.rail.move_to(1100.0)
    assert caught.value.code in {"HC-B02", "HC-B21"}  # its wire missed an answer, or not
    other.connect()
    assert not other.rail.read().powered
    other.rail.move_to(1100.0)
    other.close()


def _stop(stop: threading.Event, name: str, other: Bench) -> bytes:
    if name == "$ALARM_STOP" and bench_moves(other.kuka):
        stop.set()
    return b""


def bench_moves(kuka: KukaPeer) -> bool:
    return kuka.variables["HC_SEQ"] != kuka.variables["HC_ACK"]


def test_a_strip_in_alarm_or_lost_lets_the_slide_move_and_no_reading_through(bench: Bench) -> None:
    bench.connect()
    bench.strip.register = 1
    bench.rail.move_to(700.0)
    with pytest.raises(StripLost, match="too far from the strip"):
        bench.rail.settle()
    bench.strip.register = 0
    assert bench.rail.settle().strip_mm == 700.0
    bench.strip.server.drop()
    bench.rail.move_to(800.0)
    bench.rail.hold()
    with pytest.raises(StripLost, match="closed the connection"):
        bench.rail.settle()
    assert bench.rail.settle().strip_mm == 800.0  # the line was opened again
    bench.strip.silent = True
    with pytest.raises(StripLost, match="did not answer"):
        bench.rail.read()
    bench.strip.silent = False
    assert bench.rail.read().strip_mm == 800.0


def test_a_creep_is_no_rest(bench: Bench) -> None:
    bench.connect()
    places = iter(np.arange(640.0, 700.0, 0.02))

    def mangle(name: str, reply: bytes) -> list[bytes]:
        if name == "$AXIS_ACT.E1":
            bench.kuka.slide_mm = float(next(places))
        return [reply]

    bench.kuka.mangle = mangle
    with pytest.raises(DeviceError) as caught:
        bench.rail.settle()
    assert caught.value.code == "HC-S06"
    assert not bench.rail.read().still


@pytest.mark.parametrize("text", ["NaN", "1,5", "#NONE", "TRUE", "1e9"])
def test_a_place_that_is_no_number_is_an_error(bench: Bench, text: str) -> None:
    bench.connect()
    bench.kuka.places = text
    with pytest.raises(DeviceError) as caught:
        bench.rail.read()
    assert caught.value.code == "HC-B26"


def test_closing_leaves_the_slide_held(bench: Bench) -> None:
    bench.connect()
    bench.rail.move_to(700.0)
    assert bench.kuka.variables["HC_HELD"] == "FALSE"
    bench.close()
    assert bench.kuka.variables["HC_HELD"] == "TRUE"


def test_speeds_below_one_percent_are_refused(bench: Bench) -> None:
    with pytest.raises(ValueError, match="1 to 100 % of full_mm_s"):
        bench.rail_for(speed_mm_s=10.0)
