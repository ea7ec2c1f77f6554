"""The slide as external axis E1 of its robot: one wire for both, and a strip of its own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import count
from typing import Any

import numpy as np
import pytest

from drivers.kuka import robot as kuka_robot
from drivers.kuka.rail_e1 import KukaE1Rail
from drivers.strips import StripOptions
from hilcell.ports import DeviceRefused, Jogs, Stopped, StripLost
from tests.drivers.kuka.kuka_bed import ALARMS, TARGET_RAD, BedRobot
from tests.drivers.kuka.kuka_peer import KukaPeer
from tests.drivers.peers import WireTime, kind, refusal
from tests.drivers.strip_peer import StripPeer


class Bench:
    """A robot and the rail that rides on it, at their peers."""

    def __init__(self, kuka: KukaPeer, strip: StripPeer, time: WireTime) -> None:
        self.kuka, self.strip, self.time = kuka, strip, time
        strip.counts = lambda: round(100.0 * kuka.slide_mm)
        self.robot = BedRobot(kuka, time)
        self.rail = self.rail_for()

    def rail_for(self, **options: Any) -> KukaE1Rail:
        values: dict[str, Any] = {
            "strip": StripOptions(driver="serial", channel=self.strip.channel),
            "travel_min_mm": 0.0,
            "travel_max_mm": 3000.0,
            "speed_mm_s": 250.0,
            "standstill_dwell_s": 0.05,
        }
        rail = KukaE1Rail(KukaE1Rail.Options(**(values | options)), self.time)
        rail.attach_robot(self.robot)
        return rail

    def slides(self, places: Iterable[float], by: str = "$AXIS_ACT.E1") -> None:
        """Let each read of the slide's place find it at the next one."""
        following = iter(places)

        def slide(name: str) -> None:
            if name == by:
                self.kuka.slide_mm = float(next(following))

        self.kuka.on_read = slide

    def connect(self) -> None:
        self.robot.connect()
        self.rail.connect()

    def close(self) -> None:
        self.rail.close()
        self.robot.close()


@pytest.fixture
def bench(time: WireTime) -> Iterator[Bench]:
    with KukaPeer(**{"$EX_AX_NUM": "1", "$AXIS_JUS[7]": "TRUE"}) as kuka, StripPeer() as strip:
        kuka.slide_mm = 640.0
        bench = Bench(kuka, strip, time)
        yield bench
        bench.close()


def test_connect_names_drive_and_strip_and_moves_nothing(bench: Bench) -> None:
    bench.robot.connect()
    drive, strip = bench.rail.connect()
    assert (drive.kind, drive.model) == ("drive", "E1 of #KR210R2700_2 C4 FLR")
    assert (strip.kind, strip.serial) == ("strip", "1234567")
    assert drive.serial == "472911"
    assert "write HC_SEQ" not in bench.kuka.requests


def test_connect_holds_an_axis_that_was_left_free(bench: Bench) -> None:
    bench.kuka.variables["HC_HELD"] = "FALSE"
    bench.robot.connect()
    assert bench.kuka.variables["HC_HELD"] == "TRUE"


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
    error = refusal(lambda: bench.robot.move_to(TARGET_RAD, 30.0))
    assert error.code == "HC-B24"
    assert "E1 640.150" in error.found


def test_a_slide_that_is_read_twice_at_two_places_moves(bench: Bench) -> None:
    bench.connect()
    bench.slides(np.arange(640.1, 700.0, 0.1), by="$AXIS_ACT")
    assert not bench.robot.read().still


def test_the_program_refuses_a_slide_that_is_held(bench: Bench) -> None:
    bench.connect()
    bench.kuka.started = lambda: bench.kuka.variables.update(HC_HELD="TRUE")
    assert refusal(lambda: bench.rail.move_to(1100.0)).fields == {"error": 4}
    bench.kuka.stopped.wait()


def test_a_slide_that_was_pushed_is_named_by_the_arms_motion(bench: Bench) -> None:
    bench.connect()
    bench.kuka.error = "3"
    assert refusal(lambda: bench.robot.move_to(TARGET_RAD, 30.0)).code == "HC-R52"


@pytest.mark.parametrize("target_mm", [-0.1, 3000.1, float("nan"), float("inf")])
def test_a_target_outside_the_travel_is_refused(bench: Bench, target_mm: float) -> None:
    bench.connect()
    assert refusal(lambda: bench.rail.move_to(target_mm)).code == "HC-R36"
    assert "write HC_SEQ" not in bench.kuka.requests


def test_the_controllers_own_limit_stops_it(bench: Bench) -> None:
    bench.connect()
    bench.kuka.error = "2"
    assert refusal(lambda: bench.rail.move_to(2999.0)).code == "HC-B20"
    bench.kuka.stopped.wait()


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
    assert kind(refusal(bench.rail.connect)) == (DeviceRefused, code)


def test_an_axis_that_was_mastered_elsewhere_is_refused(bench: Bench) -> None:
    bench.strip.counts = lambda: round(100.0 * bench.kuka.slide_mm) + 201
    bench.connect()
    assert refusal(bench.rail.home).code == "HC-R53"


def test_an_axis_that_runs_faster_than_it_should_is_stopped(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kuka_robot.KukaRobot, "SPEED_OVER_S", 0.001)
    bench.connect()
    bench.kuka.frozen = True  # it runs by itself, without an end
    bench.slides(count(640.0, 50.0))
    assert refusal(lambda: bench.rail.move_to(2999.0)).code == "HC-R33"
    bench.kuka.stopped.wait()


@pytest.mark.parametrize("ratio", [0.5, 1.25, 2.0])
def test_scales_that_differ_are_named_in_motion(bench: Bench, ratio: float) -> None:
    bench.connect()
    bench.kuka.frozen, began_mm = True, bench.kuka.slide_mm
    bench.strip.counts = lambda: round(100.0 * ratio * bench.kuka.slide_mm)
    bench.slides(count(began_mm + 1.0))
    error = refusal(lambda: bench.rail.move_to(2900.0))
    assert error.code == "HC-R47"
    assert error.fields["ratio"] == pytest.approx(ratio, rel=0.05)
    bench.kuka.stopped.wait()
    assert bench.kuka.slide_mm - began_mm < 250.0


@pytest.mark.parametrize(
    ("variable", "value"),
    [("$MODE_OP", "#T1"), ("$ALARM_STOP", "FALSE"), ("$OV_PRO", "0"), ("$PRO_STATE1", "#P_STOP")],
)
def test_a_controller_that_is_not_well_ends_the_motion(
    bench: Bench, variable: str, value: str
) -> None:
    bench.connect()
    bench.kuka.frozen = True
    bench.kuka.variables[variable] = value
    assert refusal(lambda: bench.rail.move_to(1100.0)).code == ALARMS[variable]
    bench.kuka.stopped.wait()


def test_a_stop_ends_the_motion_and_only_a_new_connect_moves_again(
    bench: Bench, time: WireTime
) -> None:
    bench.connect()
    bench.kuka.frozen = True

    def stop(name: str, reply: bytes) -> list[bytes]:
        variables = bench.kuka.variables
        if name == "$ALARM_STOP" and variables["HC_SEQ"] != variables["HC_ACK"]:
            time.stop.set()
        return [reply]

    bench.kuka.mangle = stop
    with pytest.raises(Stopped):
        bench.rail.move_to(1100.0)
    bench.kuka.stopped.wait()
    bench.kuka.mangle, bench.kuka.frozen = (lambda _name, reply: [reply]), False
    time.stop.clear()
    error = refusal(lambda: bench.rail.move_to(1100.0))
    assert error.code in {"HC-B02", "HC-B21"}  # its wire missed an answer, or not
    bench.connect()
    assert not bench.rail.read().powered
    bench.rail.move_to(1100.0)


def test_a_strip_in_alarm_or_lost_lets_the_slide_move_and_no_reading_through(
    bench: Bench, time: WireTime
) -> None:
    bench.connect()
    bench.strip.register = 1
    bench.rail.move_to(700.0)
    assert refusal(bench.rail.settle).fields["alarms"] == 1
    bench.strip.register = 0
    assert bench.rail.settle().strip_mm == 700.0
    bench.strip.server.drop()
    bench.rail.move_to(800.0)
    bench.rail.hold()
    assert bench.rail.settle().strip_mm == 800.0  # lost on the way, opened again at rest
    bench.strip.server.drop()
    assert isinstance(refusal(bench.rail.settle), StripLost)
    assert bench.rail.settle().strip_mm == 800.0
    bench.strip.silent = True
    time.silence()
    assert isinstance(refusal(bench.rail.read), StripLost)
    bench.strip.silent = False
    time.silence(0.0)
    assert bench.rail.read().strip_mm == 800.0


def test_a_creep_is_no_rest(bench: Bench) -> None:
    bench.connect()
    bench.slides(np.arange(640.0, 700.0, 0.02))
    assert refusal(bench.rail.settle).code == "HC-S06"
    assert not bench.rail.read().still


@pytest.mark.parametrize("text", ["NaN", "1,5", "#NONE", "TRUE", "1e9"])
def test_a_place_that_is_no_number_is_an_error(bench: Bench, text: str) -> None:
    bench.connect()
    bench.kuka.places = text
    assert refusal(bench.rail.read).code == "HC-B26"


def test_closing_leaves_the_slide_held(bench: Bench) -> None:
    bench.connect()
    bench.rail.move_to(700.0)
    assert bench.kuka.variables["HC_HELD"] == "FALSE"
    bench.close()
    assert bench.kuka.variables["HC_HELD"] == "TRUE"


def test_speeds_below_one_percent_are_refused(bench: Bench) -> None:
    with pytest.raises(ValueError, match="full_mm_s"):
        bench.rail_for(speed_mm_s=10.0)


@pytest.mark.parametrize(
    ("strip_per_mm", "stop_after_mm", "stopped_by", "moved_mm"),
    [
        (1.0, None, "", 5.0),
        (-1.0, None, "", 5.0),
        (10.0, None, "bound", 5.0 / 3.0),
        (1.0, 2.0, "stop", 10.0 / 3.0),
    ],
)
def test_a_jog_ends_at_its_distance_or_its_bound_and_the_session_goes_on(
    bench: Bench,
    strip_per_mm: float,
    stop_after_mm: float | None,
    stopped_by: str,
    moved_mm: float,
) -> None:
    """A strip of another scale or sign ends no jog: only the bound of both does."""
    jogs: Jogs = bench.rail
    bench.connect()
    counts = 100.0 * strip_per_mm
    bench.strip.counts = lambda: round(64_000 + counts * (bench.kuka.slide_mm - 640.0))
    trace = jogs.jog(5.0, bound_mm=8.0, speed_mm_s=20.0, stop_after_mm=stop_after_mm)
    assert trace.stopped_by == stopped_by
    assert (trace.drive_mm[0], trace.strip_mm[0]) == (640.0, 640.0)
    drive_mm, strip_mm = trace.drive_mm[-1] - 640.0, trace.strip_mm[-1] - 640.0
    assert strip_mm == pytest.approx(strip_per_mm * drive_mm, abs=0.01)
    assert drive_mm == pytest.approx(moved_mm, abs=1e-4)
    assert set(trace.velocity_mm_s) == {0.0, 20.0}
    assert bool(np.all(np.diff(trace.taken_s) >= 0.0))
    assert bench.kuka.variables["HC_VEL"] == "1"  # of 1890 mm/s, in whole percents
    assert bench.kuka.variables["HC_HELD"] == "TRUE"
    assert ("write HC_STOP" in bench.kuka.requests) is bool(stopped_by)
    bench.robot.move_to(TARGET_RAD, 30.0)  # carries the slide's place
    assert f"E1 {trace.drive_mm[-1]:.6f}" in bench.kuka.variables["HC_TGT"]
    back = jogs.jog(-1.0, bound_mm=50.0, speed_mm_s=1.0)  # at 1 %
    assert back.drive_mm[-1] == pytest.approx(trace.drive_mm[-1] - 1.0)
    assert set(back.velocity_mm_s) == {0.0, 18.9}
    assert f"E1 {back.drive_mm[-1]:.6f}" in bench.kuka.variables["HC_TGT"]


def test_a_jog_without_its_strip_brakes(bench: Bench) -> None:
    bench.connect()
    bench.kuka.moved = bench.strip.server.drop
    with pytest.raises(StripLost):
        bench.rail.jog(5.0, bound_mm=8.0, speed_mm_s=20.0)
    bench.kuka.stopped.wait()
    assert refusal(lambda: bench.rail.move_to(700.0)).code == "HC-B21"


def test_scale_of_the_strip_and_speed_are_options_that_of_e1_is_the_controllers(
    bench: Bench,
) -> None:
    found = bench.rail.rescaled(1.0, -0.5, 1.1)
    assert found["full_mm_s"] == pytest.approx(1890.0 * 1.1)
    strip = found["strip"]
    assert isinstance(strip, dict)
    assert strip["counts_per_mm"] == pytest.approx(-200.0)
    assert strip["channel"] == bench.strip.channel
    assert kind(refusal(lambda: bench.rail.rescaled(0.9, 1.0, 1.0))) == (DeviceRefused, "HC-R53")
