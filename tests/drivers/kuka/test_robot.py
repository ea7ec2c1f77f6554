"""A KUKA robot's motions, readings and stops, over the C3 protocol."""

from __future__ import annotations

import threading
from itertools import cycle

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.kuka import controller, robot_c3
from drivers.kuka import robot as kuka_robot
from drivers.kuka.robot_c3 import C3Controller, KukaC3Robot
from drivers.supervision import HEARTBEAT_TIMEOUT_S, LATE_S
from hilcell.cell.settings import SettingsError, convert
from hilcell.ports import Array, DeviceError, DeviceRefused, Robot, Stopped
from tests.drivers.kuka.kuka_bed import ALARMS, TARGET_RAD, BedRobot, RobotBed
from tests.drivers.kuka.kuka_peer import VARIABLES, KukaPeer
from tests.drivers.peers import figure, in_thread, kind, refusal, soon

pytestmark = pytest.mark.waits


def test_identity(robot: BedRobot) -> None:
    port: Robot = robot
    (identity,) = port.connect()
    assert (identity.model, identity.serial) == ("#KR210R2700_2 C4 FLR", "472911")
    assert (identity.kind, identity.maker) == ("robot", "KUKA")
    assert "write HC_SEQ" not in robot.peer.requests


def test_a_name_may_be_padded_and_says_whether_the_robot_is_simulated(bed: RobotBed) -> None:
    for name, simulated in (('"#KR210 FLR   "\0', False), ("#KR210 SIMULATED", True)):
        bed.peer.variables["$TRAFONAME[]"] = name
        robot = bed.make()
        (identity,) = robot.connect()
        robot.close()
        assert identity.model == name.strip('\0"').strip()
        assert identity.simulated is simulated


def exchanges(peer: KukaPeer) -> int:
    """Return how many there were; signs of life come by the clock, not by the motion."""
    return len([name for name in peer.requests if "TIMER" not in name])


def test_a_move_ends_at_the_target_at_rest(robot: BedRobot) -> None:
    before = exchanges(robot.peer)
    reading = robot.move_to(TARGET_RAD, 30.0)
    assert exchanges(robot.peer) - before <= 20
    np.testing.assert_allclose(reading.joints_rad, TARGET_RAD, atol=1e-8)
    np.testing.assert_allclose(robot.read().joints_rad, TARGET_RAD, atol=1e-8)
    assert reading.still
    sent = robot.peer.variables
    assert (sent["HC_VEL"], sent["HC_CMD"], sent["HC_SEQ"]) == ("30", "1", "8")
    assert "A3 95.500000," in sent["HC_TGT"]


def test_a_reading_and_a_point_cost_few_exchanges(robot: BedRobot) -> None:
    """Every point is approached from below: two motions; three looks each until acknowledged."""
    robot.move_to(TARGET_RAD, 30.0)
    began = exchanges(robot.peer)
    robot.read()
    assert exchanges(robot.peer) - began <= 3
    began = exchanges(robot.peer)
    robot.move_to(TARGET_RAD - 0.01, 30.0)
    robot.move_to(TARGET_RAD, 30.0)
    assert exchanges(robot.peer) - began <= 34


def test_each_state_is_read_within_eight_polls(
    robot: BedRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kuka_robot, "STALL_S", 1.0)
    robot.peer.frozen = True
    began = len(robot.peer.requests)
    assert refusal(lambda: robot.move_to(TARGET_RAD, 30.0)).code == "HC-B23"
    polls = " ".join(robot.peer.requests[began:]).split("read HC_ACK")[1:]
    assert len(polls) > 24
    for name in (*controller.HEALTH, "$OV_PRO", "$AXIS_ACT"):
        seen = [number for number, poll in enumerate(polls) if f"{name} " in poll]
        assert seen[0] < 8
        assert max(np.diff(seen)) <= 8


def test_a_number_is_no_state_that_is_true(robot: BedRobot) -> None:
    robot.peer.variables["$USER_SAF"] = "1"
    assert refusal(lambda: robot.move_to(TARGET_RAD, 30.0)).code == "HC-B11"


@pytest.mark.parametrize("override", ["100", "5"])
def test_an_arm_that_creeps_for_ever_is_stopped_and_a_low_override_given_its_time(
    robot: BedRobot, monkeypatch: pytest.MonkeyPatch, override: str
) -> None:
    peer = robot.peer
    peer.frozen = True
    peer.variables["$OV_PRO"] = override

    def creep(name: str) -> None:
        peer.axes[0] += 0.05 * (name == "$AXIS_ACT" and not peer.stopped.is_set())

    peer.on_read = creep
    monkeypatch.setattr(kuka_robot, "STALL_S", 0.0)
    monkeypatch.setattr(kuka_robot, "POLL_S", 0.9)
    began_s = robot.time.now_s()
    error = refusal(lambda: robot.move_to(TARGET_RAD, 30.0))
    assert error.code == "HC-B29"
    assert 26.0 < figure(error, "spent_s") < 30.0
    assert robot.time.now_s() - began_s > 26.0 * 100 / int(override)
    robot.close()
    peer.stopped.wait()


def test_a_pc_that_does_not_poll_in_motion_stops(robot: BedRobot) -> None:
    def late() -> None:
        robot.time.pc_at_s += 2.0

    robot.peer.moved = late
    error = refusal(lambda: robot.move_to(TARGET_RAD, 30.0))
    assert error.code == "HC-B27"
    assert error.fields["gap_s"] == pytest.approx(2.0, abs=0.1)
    robot.close()
    robot.peer.stopped.wait()


def test_a_pc_that_was_late_at_rest_goes_on(
    robot: BedRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(robot_c3, "REPLY_S", 30.0)  # the controller answers
    robot.time.silence(2.0)
    assert robot.read().still


def test_a_robot_that_flickers_is_at_rest(robot: BedRobot, monkeypatch: pytest.MonkeyPatch) -> None:
    original, sign = robot.peer._read, cycle((1e-4, -1e-4, 0.0))

    def read(name: str) -> str | None:
        off = next(sign)
        if name == "$POS_ACT":
            return robot.peer.pose.replace("1620.5", f"{1620.5 + 10 * off:.6f}")
        if name == "$AXIS_ACT":
            axes = ", ".join(f"A{n} {v + off:.6f}" for n, v in enumerate(robot.peer.axes, 1))
            return f"{{E6AXIS: {axes}, E1 0.0}}"
        return original(name)

    monkeypatch.setattr(robot.peer, "_read", read)
    assert robot.move_to(TARGET_RAD, 30.0).still
    assert robot.read().still


def test_the_pose_is_in_kukas_angles(robot: BedRobot) -> None:
    pose = robot.read().pose
    expected = (
        Rotation.from_rotvec([0, 0, np.radians(30)])
        * Rotation.from_rotvec([0, np.radians(45), 0])
        * Rotation.from_rotvec([np.radians(-60), 0, 0])
    )
    np.testing.assert_allclose(pose[:3, :3], expected.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(pose[:3, 3], [1620.5, 0.0, 1910.0])
    np.testing.assert_array_equal(pose[3], [0, 0, 0, 1])


@pytest.mark.parametrize(
    ("name", "value", "found"),
    [
        ("$TRAFONAME[]", '"#KR16"', "#KR16"),
        ("HC_VER", "5", "version 5 (HC_VER)"),
        ("$MODE_OP", "#T1", "#T1"),
        ("$PERI_RDY", "FALSE", ""),
        ("$ALARM_STOP", "FALSE", ""),
        ("$USER_SAF", "FALSE", ""),
        ("$STOPMESS", "TRUE", ""),
        ("$PRO_STATE1", "#P_STOP", ""),
        ("$OV_PRO", "0", "is 0"),
        ("$ACT_TOOL", "3", "is 3"),
        ("$ACT_BASE", "2", "is 2"),
        ("$TOOL", VARIABLES["$TOOL"].replace("127.0", "127.002"), "Z 127.002"),
        ("$TOOL", VARIABLES["$TOOL"].replace("127.0", "126.998"), "Z 126.998"),
        ("$TOOL", VARIABLES["$TOOL"].replace("B 0.0", "B 90.0"), "B 90.000"),
        ("$BASE", VARIABLES["$BASE"].replace("X 0.0", "X 0.5"), "X 0.500"),
        ("HC_ACK", "6", "HC_ACK 6"),
    ],
)
def test_a_wrong_robot_is_refused(bed: RobotBed, name: str, value: str, found: str) -> None:
    bed.peer.variables[name] = value
    robot = bed.make()
    refused = refusal(robot.connect)
    assert kind(refused) == (DeviceRefused, ALARMS[name])
    assert found in refused.found
    refusal(robot.read)


@pytest.mark.parametrize("value", ["1,234", "NaN", "{X 1.0}", "100.5", ""])
def test_unreadable_answers_are_errors(bed: RobotBed, value: str) -> None:
    bed.peer.variables["$OV_PRO"] = value
    with pytest.raises(DeviceError, match=r"\$OV_PRO"):
        bed.make().connect()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("$ALARM_STOP", "FALSE"),
        ("$MODE_OP", "#T1"),
        ("$OV_PRO", "0"),
        ("$PRO_STATE1", "#P_RESET"),
        ("$ACT_TOOL", "2"),
        ("$STOPMESS", "TRUE"),
    ],
)
def test_a_fault_in_motion_is_named(robot: BedRobot, name: str, value: str) -> None:
    robot.peer.frozen = True
    robot.peer.started = lambda: robot.peer.variables.update({name: value})
    assert refusal(lambda: robot.move_to(TARGET_RAD, 30.0)).code == ALARMS[name]
    robot.close()
    robot.peer.stopped.wait()


@pytest.mark.parametrize(("name", "value"), [("$MODE_OP", "#T1"), ("$USER_SAF", "FALSE")])
def test_no_motion_is_ordered_where_an_operator_may_be_near(
    robot: BedRobot, name: str, value: str
) -> None:
    robot.peer.variables[name] = value
    assert refusal(lambda: robot.move_to(TARGET_RAD, 30.0)).code == ALARMS[name]
    assert "write HC_SEQ" not in robot.peer.requests
    robot.close()
    assert not robot.peer.stopped.is_set()


def test_a_speed_that_was_changed_at_the_panel_is_written_again(robot: BedRobot) -> None:
    robot.move_to(TARGET_RAD - 0.01, 30.0)
    robot.peer.variables["HC_VEL"] = "100"
    robot.move_to(TARGET_RAD, 30.0)
    assert robot.peer.variables["HC_VEL"] == "30"


@pytest.mark.parametrize("lost", [0, 1, 2])
@pytest.mark.parametrize("stopped", [False, True])
def test_close_waits_for_rest_and_repeats_a_stop_that_was_lost(
    robot: BedRobot, monkeypatch: pytest.MonkeyPatch, lost: int, stopped: bool
) -> None:
    in_motion(robot, robot.peer, monkeypatch)
    robot.peer.deaf = lost
    if stopped:
        robot.stop()
    robot.close()
    assert robot.peer.variables["HC_STOP"] == "TRUE"
    assert robot.peer.deaf == 0


def test_an_arm_that_does_not_come_to_rest_is_named(
    robot: BedRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    in_motion(robot, robot.peer, monkeypatch)

    def sink(name: str) -> None:
        robot.peer.axes[1] += 0.01 * (name == "$AXIS_ACT")

    monkeypatch.setattr(robot_c3, "REPLY_S", 30.0)  # the controller answers
    robot.peer.on_read = sink
    robot.time.silence(0.5)
    error = refusal(robot.close)
    assert (error.code, error.operation) == ("HC-B41", "close")


def in_motion(robot: BedRobot, peer: KukaPeer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave a motion that has not ended."""
    monkeypatch.setattr(kuka_robot, "STALL_S", 0.0)
    peer.frozen = True
    assert refusal(lambda: robot.move_to(TARGET_RAD, 30.0)).code == "HC-B23"


def test_joints_are_the_measured_ones(bed: RobotBed) -> None:
    """The ordered ones stand while a brake slips."""
    bed.peer.measures, bed.peer.slip_deg = True, 0.3
    robot = bed.connect()
    assert np.degrees(robot.read().joints_rad[0]) == pytest.approx(0.3)
    assert refusal(lambda: robot.move_to(TARGET_RAD, 30.0)).code == "HC-B24"


@pytest.mark.parametrize("name", ["$ACT_TOOL", "$ACT_BASE"])
def test_a_frame_changed_in_motion_spoils_the_reading(robot: BedRobot, name: str) -> None:
    robot.peer.moved = lambda: robot.peer.variables.update({name: "5"})
    assert refusal(lambda: robot.move_to(TARGET_RAD, 30.0)).code == ALARMS[name]


def test_the_cause_is_reported_before_its_consequence(robot: BedRobot) -> None:
    robot.peer.frozen = True
    wrong = {"$PRO_STATE1": "#P_STOP", "$PERI_RDY": "FALSE", "$ALARM_STOP": "FALSE"}
    robot.peer.started = lambda: robot.peer.variables.update(wrong)
    assert refusal(lambda: robot.move_to(TARGET_RAD, 30.0)).code == ALARMS["$ALARM_STOP"]


@pytest.mark.parametrize("number", [1, 2])
def test_the_programs_errors_are_reported(robot: BedRobot, number: int) -> None:
    robot.peer.error = str(number)
    error = refusal(lambda: robot.move_to(TARGET_RAD, 30.0))
    assert (error.code, error.fields) == ("HC-B20", {"error": number})


@pytest.mark.parametrize("short_deg", [-0.006, 0.006])
def test_stopping_beside_the_target_is_noticed(robot: BedRobot, short_deg: float) -> None:
    robot.peer.short_deg = short_deg
    error = refusal(lambda: robot.move_to(TARGET_RAD, 30.0))
    assert error.code == "HC-B24"
    assert f"A1 {10.0 + short_deg:.3f}" in error.found


@pytest.mark.parametrize("steps", [range(1000), range(999, -1, -1)], ids=["up", "down"])
def test_a_moving_pose_is_not_rest(robot: BedRobot, steps: range) -> None:
    pose, number = robot.peer.pose, iter(steps)

    def move(name: str) -> None:
        if name == "$POS_ACT":
            robot.peer.pose = pose.replace("1620.5", f"1{next(number):03}.5")

    robot.peer.on_read = move
    assert refusal(lambda: robot.move_to(TARGET_RAD, 30.0)).code == "HC-B24"


@pytest.mark.parametrize(
    ("joints", "speed"),
    [(TARGET_RAD[:5], 30.0), (TARGET_RAD * np.nan, 30.0), (TARGET_RAD, 0.0), (TARGET_RAD, 101.0),
     (TARGET_RAD, np.nan)],
)  # fmt: skip
def test_bad_targets_and_speeds_are_never_sent(
    robot: BedRobot, joints: Array, speed: float
) -> None:
    refusal(lambda: robot.move_to(joints, speed))
    assert "write HC_TGT" not in robot.peer.requests


def test_a_stop_gets_through_while_a_call_hangs(robot: BedRobot) -> None:
    asked = threading.Event()

    def hang(name: str, reply: bytes) -> list[bytes]:
        if name == "$AXIS_ACT":
            asked.set()
        return [] if name == "$AXIS_ACT" else [reply]

    robot.peer.mangle = hang
    with in_thread(robot.read, DeviceError) as failures:
        asked.wait()
        robot.stop()
        robot.peer.stopped.wait()
        robot.time.silence(0.1)
    assert [getattr(each, "code", "") for each in failures] == ["HC-B02"]
    refusal(lambda: robot.move_to(TARGET_RAD, 30.0))


def test_the_runs_stop_ends_a_motion(robot: BedRobot) -> None:
    robot.peer.moved = robot.time.stop.set
    with pytest.raises(Stopped):
        robot.move_to(TARGET_RAD, 30.0)
    robot.close()
    robot.peer.stopped.wait()


def test_only_a_new_connect_takes_a_stop_back(robot: BedRobot) -> None:
    peer = robot.peer
    peer.moved = robot.stop
    refusal(lambda: robot.move_to(TARGET_RAD, 30.0))
    peer.stopped.wait()
    peer.moved = lambda: None
    assert peer.variables["HC_STOP"] == "TRUE"
    assert refusal(lambda: robot.move_to(TARGET_RAD, 30.0)).code == "HC-B21"
    robot.connect()
    assert peer.variables["HC_STOP"] == "FALSE"
    assert robot.move_to(TARGET_RAD, 30.0).still


def test_connect_waits_for_an_earlier_sessions_motion(bed: RobotBed) -> None:
    bed.peer.variables["HC_SEQ"] = "8"
    bed.peer._steps = 3
    bed.connect()
    assert bed.peer.variables["HC_ACK"] == "8"


@pytest.fixture
def kept_eagerly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(controller.KeepAlive, "IDLE_S", 0.02)
    monkeypatch.setattr(controller.KeepAlive, "PERIOD_S", 0.01)


def test_idle_connections_are_kept_and_a_loss_is_reported(
    bed: RobotBed, kept_eagerly: None
) -> None:
    robot = bed.connect()
    soon(lambda: bed.peer.requests.count("read $MODE_OP") >= 5)
    assert bed.peer.connections == 2  # only now: a connection is made before it is accepted
    bed.peer.server.drop()
    keeper = robot.wire()._keeper
    keeper._thread.join()
    assert refusal(robot.read).code == "HC-B02"


def test_the_connection_of_a_stop_is_not_kept_afterwards(bed: RobotBed, kept_eagerly: None) -> None:
    robot = bed.connect()
    keeper = robot.wire()._keeper
    robot.stop()
    soon(lambda: "write HC_STOP" in bed.peer.requests)
    asked = bed.peer.requests.count("read $MODE_OP") + 3
    soon(lambda: bed.peer.requests.count("read $MODE_OP") >= asked or bool(keeper._failure))
    keeper.check()


def test_options_are_strict() -> None:
    options = {"host": "x", "smr_mm": [1.0, 2.0, 3.0], "joint": [], "prt": 1, "tool": 0}
    with pytest.raises(SettingsError) as caught:
        convert(options, KukaC3Robot.Options, "")
    assert len(caught.value.problems) == 2


SIGN = "write $TIMER[10]"


def test_each_motion_gets_signs_of_life_and_a_robot_at_rest_none(
    robot: BedRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    peer = robot.peer
    monkeypatch.setattr(C3Controller, "HEARTBEAT_S", 0.0)
    robot.move_to(TARGET_RAD, 30.0)
    assert peer.requests.count(SIGN) == 3  # one a look
    assert peer.variables["$TIMER[10]"] == "-1500"
    assert peer.variables["HC_LIFE"] == "1500"
    assert peer.requests.index("write HC_LIFE") < peer.requests.index("write HC_SEQ")
    robot.read()
    assert peer.requests.count(SIGN) == 3
    with robot.sweep(0, float(TARGET_RAD[0]) + 0.1, 0.01) as sweep:
        sweep.kickoff()
        sweep.collect()
        sweep.complete()
    assert peer.requests.count(SIGN) == 6


def test_a_late_pc_reports_that_before_the_robot_brakes() -> None:
    assert HEARTBEAT_TIMEOUT_S > LATE_S + C3Controller.HEARTBEAT_S


def test_a_robot_that_has_braked_by_itself_says_why(robot: BedRobot) -> None:
    robot.peer.frozen = True
    robot.peer.variables["HC_ERR"] = "8"
    assert refusal(lambda: robot.move_to(TARGET_RAD, 30.0)).code == "HC-B43"


def test_a_motion_that_a_dead_engine_left_brakes_and_is_taken_back(
    bed: RobotBed, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its timer runs out while the next connect waits for its end."""
    peer = bed.peer
    peer.variables["HC_SEQ"] = "8"
    looks = iter(["FALSE", "FALSE"])

    def brake(name: str) -> None:
        if name == "HC_STOP":  # it comes by itself
            peer.variables["HC_STOP"] = next(looks, "TRUE")

    peer.on_read = brake
    bed.connect()
    assert peer.variables["HC_ACK"] == "8"
    assert peer.requests.count("write HC_STOP") == 1


def test_a_stop_from_another_thread_ends_the_motion_as_such(
    robot: BedRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kuka_robot, "STALL_S", 1e6)
    robot.peer.frozen = True
    stops = list[threading.Thread]()

    def stop(name: str) -> None:
        if name == "$AXIS_ACT" and not stops:  # a read may be answered after the motion ended
            stops.append(threading.Thread(target=robot.stop))
            stops[0].start()

    robot.peer.on_read = stop
    assert refusal(lambda: robot.move_to(TARGET_RAD, 30.0)).code == "HC-B21"
    robot.peer.stopped.wait()
    stops[0].join()  # before the robot is closed
