from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.kuka.robot import KukaSweep
from hilcell.ports import JointSample, NoReading, Stopped, Sweep, Sweeps
from tests.drivers.kuka.kuka_bed import BedRobot, RobotBed
from tests.drivers.kuka.kuka_peer import KukaPeer
from tests.drivers.peers import refusal

END_RAD, SLOW_RAD_S = float(np.radians(10.0)), float(np.radians(0.1))  # of 100 deg/s


def sweep(
    robot: Sweeps, meanwhile: Callable[[], object] = lambda: None
) -> tuple[Sweep, list[JointSample]]:
    with robot.sweep(0, END_RAD, SLOW_RAD_S) as moving:
        moving.kickoff()
        samples = [moving.collect()]
        meanwhile()
        while not moving.ended:
            samples.append(moving.collect())
        assert moving.complete().still
    return moving, samples


def override(peer: KukaPeer) -> tuple[str, str]:
    return peer.variables["$OV_PRO"], peer.variables["HC_OV_OLD"]


def writes(peer: KukaPeer) -> list[str]:
    """Return the variables written, but for the signs of life, which come by the PC's clock."""
    names = [name.split()[1] for name in peer.requests if name.startswith("write")]
    return [name for name in names if "TIMER" not in name]


def lose_beam() -> None:
    raise NoReading("HC-T10", "Tracker", "stream", "the beam broke")


def test_a_sweep_lowers_the_override_and_gives_it_back(robot: BedRobot) -> None:
    peer = robot.peer
    seen: list[tuple[str, ...]] = []
    peer.moved = lambda: seen.append((*override(peer), peer.variables["HC_VEL"]))
    assert isinstance(robot, Sweeps)
    moving, samples = sweep(robot)
    assert set(seen) == {("10", "100", "1")}
    assert moving.speed_rad_s == pytest.approx(SLOW_RAD_S)
    assert override(peer) == ("100", "0")
    assert samples[-1].joints_rad[0] > samples[0].joints_rad[0]
    assert np.all(samples[0].joints_rad[1:] == np.radians([-90.0, 90.0, 0.0, 0.0, 0.0]))
    assert all(sample.before_s <= sample.after_s for sample in samples)
    order = ["HC_OV_SET", "HC_OV_OLD", "$OV_PRO", "HC_TGT", "HC_VEL", "HC_CMD"]
    order += ["HC_LIFE", "HC_SEQ"]
    assert writes(peer) == [*order, "$OV_PRO", "HC_OV_OLD"]
    assert robot.read().joints_rad[0] == pytest.approx(END_RAD)


def test_measured_axes_are_read_where_there_are_any(bed: RobotBed) -> None:
    bed.peer.measures, bed.peer.slip_deg = True, 0.004
    robot = bed.connect()
    _, samples = sweep(robot)
    assert min(float(np.degrees(each.joints_rad[3])) for each in samples) == pytest.approx(0.004)


def test_a_sweep_that_needs_no_lower_override_leaves_it(robot: BedRobot) -> None:
    with robot.sweep(0, END_RAD, float(np.radians(5.0))) as moving:
        moving.kickoff()
        moving.complete()
    assert "$OV_PRO" not in writes(robot.peer)


def test_the_operators_override_is_never_raised(bed: RobotBed) -> None:
    bed.peer.variables["$OV_PRO"] = "7"
    robot = bed.connect()
    with robot.sweep(0, END_RAD, SLOW_RAD_S) as moving:
        assert np.degrees(moving.speed_rad_s) == pytest.approx(0.1)  # 2 % of 5 %
        assert override(bed.peer) == ("5", "7")
    assert override(bed.peer) == ("7", "0")


def test_left_early_the_robot_is_braked_and_works_again(robot: BedRobot) -> None:
    with pytest.raises(NoReading):
        sweep(robot, lose_beam)
    assert writes(robot.peer)[-4:] == ["HC_STOP", "$OV_PRO", "HC_OV_OLD", "HC_STOP"]
    assert override(robot.peer) == ("100", "0")
    assert robot.peer.variables["HC_STOP"] == "FALSE"
    assert robot.move_to(np.zeros(6), 30.0).still


def test_a_stop_brakes_and_gives_back_but_stays(robot: BedRobot) -> None:
    with pytest.raises(Stopped):
        sweep(robot, robot.time.stop.set)
    assert override(robot.peer) == ("100", "0")
    assert robot.peer.variables["HC_STOP"] == "TRUE"
    robot.time.stop.clear()
    robot.time.pc_at_s += 60.0
    robot.connect()  # is not late for this motion
    assert robot.peer.variables["HC_STOP"] == "FALSE"


def test_a_stop_while_a_failed_sweep_is_given_back_does_not_hide_the_failure(
    robot: BedRobot,
) -> None:
    def fail_and_stop() -> None:
        robot.time.stop.set()
        lose_beam()

    with pytest.raises(NoReading):
        sweep(robot, fail_and_stop)
    assert override(robot.peer) == ("100", "0")


def test_a_stop_before_the_kickoff_gives_back(robot: BedRobot) -> None:
    def prepare() -> None:
        with robot.sweep(0, END_RAD, SLOW_RAD_S):
            assert override(robot.peer) == ("10", "100")
            robot.time.stop.set()
            robot.read()

    with pytest.raises(Stopped):
        prepare()
    assert override(robot.peer) == ("100", "0")
    assert not robot.peer.stopped.is_set()


@pytest.mark.parametrize(
    ("name", "value", "code"), [("$ALARM_STOP", "FALSE", "HC-B10"), ("$OV_PRO", "60", "HC-B40")]
)
def test_a_fault_in_a_sweep_ends_it(robot: BedRobot, name: str, value: str, code: str) -> None:
    robot.peer.frozen = True
    error = refusal(lambda: sweep(robot, lambda: robot.peer.variables.update({name: value})))
    assert error.code == code
    assert override(robot.peer) == ("60" if name == "$OV_PRO" else "100", "0")


def test_a_robot_that_does_not_come_to_rest_keeps_its_override_low(
    robot: BedRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = robot.peer._write
    deaf = "HC_STOP"  # of a controller that takes no stop
    monkeypatch.setattr(
        robot.peer, "_write", lambda name, text: "TRUE" if name == deaf else write(name, text)
    )
    robot.time.silence()
    with pytest.raises(NoReading) as caught:
        sweep(robot, lose_beam)
    assert override(robot.peer) == ("10", "100")
    assert len(caught.value.__notes__) == 1


@pytest.mark.parametrize("step_deg", [0.5, -0.5])
def test_the_override_comes_back_only_once_no_axis_moves(
    robot: BedRobot, monkeypatch: pytest.MonkeyPatch, step_deg: float
) -> None:
    peer = robot.peer
    write, left, early = peer._write, [4], list[int]()

    def brake(name: str) -> None:
        if name == "$AXIS_ACT" and peer.stopped.is_set() and left[0]:
            left[0] -= 1
            peer.axes[0] += step_deg

    def watched(name: str, value: bytes) -> str:
        if name == "$OV_PRO" and peer.stopped.is_set():
            early.append(left[0])
        return write(name, value)

    peer.on_read = brake
    monkeypatch.setattr(peer, "_write", watched)
    with pytest.raises(NoReading):
        sweep(robot, lose_beam)
    assert early == [0]


@pytest.mark.parametrize(
    ("left", "found", "after"),
    [
        ({"$OV_PRO": "10", "HC_OV_SET": "10", "HC_OV_OLD": "80", "HC_SEQ": "8"}, ("80", "0"),
         ["HC_STOP", "$OV_PRO", "HC_OV_OLD", "HC_STOP"]),
        ({"$OV_PRO": "30", "HC_OV_SET": "10", "HC_OV_OLD": "80"}, ("30", "0"), ["HC_OV_OLD"]),
    ],
)  # fmt: skip
def test_connect_restores_the_override_of_a_dead_engine_unless_it_was_changed_since(
    bed: RobotBed, left: dict[str, str], found: tuple[str, str], after: list[str]
) -> None:
    bed.peer.variables |= left
    bed.connect()
    assert override(bed.peer) == found
    assert bed.peer.variables["HC_STOP"] == "FALSE"
    assert writes(bed.peer) == after


@pytest.mark.parametrize(
    ("axis", "end_rad", "speed_deg_s"),
    [(6, 0.0, 1.0), (-1, 0.0, 1.0), (0, np.nan, 1.0), (0, 0.0, 0.0), (0, 0.0, 101.0),
     (0, 0.0, np.nan), (0, 0.0, 0.009)],
)  # fmt: skip
def test_an_impossible_sweep_is_refused(
    robot: BedRobot, axis: int, end_rad: float, speed_deg_s: float
) -> None:
    refusal(lambda: robot.sweep(axis, end_rad, float(np.radians(speed_deg_s))))


@given(share=st.floats(1e-4, 1.0), override=st.integers(1, 100))
def test_the_speed_is_the_next_from_below(share: float, override: int) -> None:
    velocity, lowered = KukaSweep.split_speed(share, override)
    assert 1 <= velocity <= 100
    assert 1 <= lowered <= override
    possible = (v * o for v in range(1, 101) for o in range(1, override + 1))
    assert velocity * lowered == max(p for p in possible if p <= share * 1e4 * (1 + 1e-9))
