from __future__ import annotations

import re
import threading
import time
from collections.abc import Iterator
from itertools import cycle
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers import supervision
from drivers.kuka import c3
from drivers.kuka import health as kuka_health
from drivers.kuka import robot as kuka_robot
from drivers.kuka.robot_c3 import KukaC3Robot
from drivers.wires import keep_alive
from hilcell.cell.file import Joint
from hilcell.cell.settings import SettingsError, convert
from hilcell.clock import WallClock
from hilcell.ports import Array, Clock, DeviceError, DeviceRefused, Robot, Stopped
from tests.drivers.kuka_peer import VARIABLES, KukaPeer
from tests.drivers.peers import wall_clock

JOINTS = [Joint(a_mm=0.0, alpha_deg=0.0, d_mm=0.0, offset_deg=0.0, speed_deg_s=100.0)] * 6
TARGET_RAD = np.radians([10.0, -80.0, 95.5, -12.25, 33.3, 170.0])


@pytest.fixture(autouse=True)
def short_deadlines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(c3, "REPLY_S", 0.3)
    for name, value in (
        ("POLL_S", 0.002),
        ("DWELL_S", 0.002),
        ("STALL_S", 0.3),
        ("REST_S", 0.1),
        ("CATCH_UP_S", 0.2),
    ):
        monkeypatch.setattr(kuka_robot, name, value)


def robot_for(peer: KukaPeer, clock: Clock | None = None, **options: Any) -> KukaC3Robot:
    values: dict[str, Any] = {
        "host": "127.0.0.1",
        "port": peer.server.port,
        "smr_mm": (98.0, 0.0, 127.0),
        "joint": JOINTS,
    }
    return KukaC3Robot(KukaC3Robot.Options(**(values | options)), clock or wall_clock())


@pytest.fixture
def peer() -> Iterator[KukaPeer]:
    with KukaPeer() as peer:
        yield peer


@pytest.fixture
def robot(peer: KukaPeer) -> Iterator[KukaC3Robot]:
    robot = robot_for(peer)
    robot.connect()
    yield robot
    robot.close()


def test_it_is_a_robot(robot: KukaC3Robot) -> None:
    port: Robot = robot
    assert port.read().still


def test_identity(peer: KukaPeer) -> None:
    robot = robot_for(peer)
    (identity,) = robot.connect()
    robot.close()
    assert (identity.model, identity.serial) == ("#KR210R2700_2 C4 FLR", "472911")
    assert (identity.kind, identity.maker) == ("robot", "KUKA")
    assert "write HC_SEQ" not in peer.requests


def test_a_move_ends_at_the_target_at_rest(robot: KukaC3Robot, peer: KukaPeer) -> None:
    before = exchanges(peer)
    reading = robot.move_to(TARGET_RAD, 30.0)
    np.testing.assert_allclose(reading.joints_rad, TARGET_RAD, atol=1e-8)
    assert reading.still
    assert peer.variables["HC_VEL"] == "30"
    assert peer.variables["HC_CMD"] == "1"
    assert peer.variables["HC_SEQ"] == "8"
    assert re.search(r"A3 95\.500000,", peer.variables["HC_TGT"])
    assert exchanges(peer) - before <= 16


def test_a_reading_says_since_when_the_robot_rests(robot: KukaC3Robot) -> None:
    assert robot.read().ended_s is None
    began_s = time.monotonic()
    arrived = robot.move_to(TARGET_RAD, 30.0)
    assert arrived.ended_s is not None
    assert began_s <= arrived.ended_s <= arrived.taken_s
    later = robot.read()
    assert later.ended_s == arrived.ended_s < later.taken_s


def test_joints_are_read_in_radians(robot: KukaC3Robot, peer: KukaPeer) -> None:
    np.testing.assert_allclose(robot.read().joints_rad, np.radians(peer.axes))


def exchanges(peer: KukaPeer) -> int:
    """Return how many there were; signs of life come by the clock, not by the motion."""
    return len([name for name in peer.requests if "TIMER" not in name])


def test_a_reading_and_a_point_cost_few_exchanges(robot: KukaC3Robot, peer: KukaPeer) -> None:
    """Every point is approached from below: two motions; three looks each until acknowledged."""
    robot.move_to(TARGET_RAD, 30.0)
    began = exchanges(peer)
    robot.read()
    assert exchanges(peer) - began <= 3
    began = exchanges(peer)
    robot.move_to(TARGET_RAD - 0.01, 30.0)
    robot.move_to(TARGET_RAD, 30.0)
    assert exchanges(peer) - began <= 26


def test_all_that_is_watched_is_seen_within_eight_polls(robot: KukaC3Robot, peer: KukaPeer) -> None:
    peer.frozen = True
    began = len(peer.requests)
    with pytest.raises(DeviceError, match="no axis moved"):
        robot.move_to(TARGET_RAD, 30.0)
    polls = " ".join(peer.requests[began:]).split("read HC_ACK")[1:]
    assert len(polls) > 24
    for name in (*kuka_health.HEALTH, "$OV_PRO", "$AXIS_ACT"):
        seen = [number for number, poll in enumerate(polls) if f"{name} " in poll]
        assert seen[0] < 8
        assert max(np.diff(seen)) <= 8


def creeping(peer: KukaPeer, monkeypatch: pytest.MonkeyPatch, override: str) -> KukaC3Robot:
    """Return a robot whose arm creeps on, in a cell where 20 s pass between two looks."""
    peer.frozen = True
    peer.variables["$OV_PRO"] = override
    original = peer._read

    def read(name: str) -> str | None:
        peer.axes[0] += 0.05 * (name == "$AXIS_ACT")
        return original(name)

    now_s = iter(range(0, 1_000_000, 20))
    robot = robot_for(peer)
    robot.connect()
    monkeypatch.setattr(peer, "_read", read)
    monkeypatch.setattr(kuka_robot, "STALL_S", 0.0)
    monkeypatch.setattr(robot._clock, "now_s", lambda: float(next(now_s)))
    return robot


def test_an_arm_that_creeps_for_ever_is_stopped(
    peer: KukaPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = creeping(peer, monkeypatch, "100")
    with pytest.raises(DeviceError, match=r"still under way after 40 s .* within 27 s; the arm"):
        robot.move_to(TARGET_RAD, 30.0)
    robot.close()
    assert peer.stopped.wait(5)


def test_a_low_override_is_given_its_time(peer: KukaPeer, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = creeping(peer, monkeypatch, "5")
    with pytest.raises(DeviceError, match=r"still under way after 28 s at full speed"):
        robot.move_to(TARGET_RAD, 30.0)
    looks = peer.requests.count("read $AXIS_ACT")
    robot.close()
    assert looks > 28


def test_a_pc_that_does_not_look_while_it_moves_stops(
    robot: KukaC3Robot, peer: KukaPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    late_s = [0.0]
    peer.moved = lambda: late_s.__setitem__(0, late_s[0] + 2.0)
    monkeypatch.setattr(robot._clock, "pc_s", lambda: late_s[0])
    with pytest.raises(DeviceError) as late:
        robot.move_to(TARGET_RAD, 30.0)
    assert late.value.code == "HC-B27"
    assert late.value.fields["gap_s"] == 2.0
    robot.close()
    assert peer.stopped.wait(5)


def test_a_pc_that_was_late_at_rest_goes_on(
    robot: KukaC3Robot, peer: KukaPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks = iter(range(0, 1_000_000, 2))
    monkeypatch.setattr(supervision, "time", SimpleNamespace(monotonic=lambda: next(looks)))
    assert robot.read().still


def test_a_robot_that_flickers_while_it_holds_stands(
    robot: KukaC3Robot, peer: KukaPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    original, sign = peer._read, cycle((1e-4, -1e-4, 0.0))

    def read(name: str) -> str | None:
        off = next(sign)
        if name == "$POS_ACT":
            return peer.pose.replace("1620.5", f"{1620.5 + 10 * off:.6f}")
        if name == "$AXIS_ACT":
            axes = ", ".join(f"A{n} {v + off:.6f}" for n, v in enumerate(peer.axes, 1))
            return f"{{E6AXIS: {axes}, E1 0.0}}"
        return original(name)

    monkeypatch.setattr(peer, "_read", read)
    assert robot.move_to(TARGET_RAD, 30.0).still
    assert robot.read().still


@pytest.mark.parametrize("name", ["#KR210R2700_2 C4 FLR", '"#KR210R2700_2 C4 FLR   "\0'])
def test_a_name_may_come_without_quotes_or_padded(name: str) -> None:
    with KukaPeer(**{"$TRAFONAME[]": name}) as peer:
        robot = robot_for(peer)
        (identity,) = robot.connect()
        robot.close()
        assert identity.model == "#KR210R2700_2 C4 FLR"


def test_the_pose_is_in_kukas_angles(robot: KukaC3Robot) -> None:
    pose = robot.read().pose
    expected = (
        Rotation.from_rotvec([0, 0, np.radians(30)])
        * Rotation.from_rotvec([0, np.radians(45), 0])
        * Rotation.from_rotvec([np.radians(-60), 0, 0])
    )
    np.testing.assert_allclose(pose[:3, :3], expected.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(pose[:3, 3], [1620.5, 0.0, 1910.0])
    np.testing.assert_array_equal(pose[3], [0, 0, 0, 1])


ALARMS = {
    "$TRAFONAME[]": "HC-B05", "$TOOL": "HC-B06", "$BASE": "HC-B06", "$ACT_TOOL": "HC-B07",
    "$ACT_BASE": "HC-B07", "$ALARM_STOP": "HC-B10", "$USER_SAF": "HC-B11", "$MODE_OP": "HC-B12",
    "$PERI_RDY": "HC-B13", "$STOPMESS": "HC-B14", "$PRO_STATE1": "HC-B15", "$OV_PRO": "HC-B16",
    "HC_VER": "HC-B17", "HC_ACK": "HC-B25",
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("$TRAFONAME[]", '"#KR16"', "model '#KR16', wanted 'KR210'"),
        ("HC_VER", "5", "HC_VER is 5, wanted 4; install"),
        ("$MODE_OP", "#T1", r"\$MODE_OP is #T1, wanted #EX or #AUT"),
        ("$PERI_RDY", "FALSE", "drives have no power"),
        ("$ALARM_STOP", "FALSE", "emergency stop"),
        ("$USER_SAF", "FALSE", "guard is open"),
        ("$STOPMESS", "TRUE", "stop message"),
        ("$PRO_STATE1", "#P_STOP", "start the program hilcell"),
        ("$OV_PRO", "0", r"\$OV_PRO is 0, wanted 1 to 100"),
        ("$ACT_TOOL", "3", r"\$ACT_TOOL is 3, wanted 1"),
        ("$ACT_BASE", "2", r"\$ACT_BASE is 2, wanted 0"),
        ("$TOOL", VARIABLES["$TOOL"].replace("127.0", "127.002"), "Z 127.002"),
        ("$TOOL", VARIABLES["$TOOL"].replace("127.0", "126.998"), "Z 126.998"),
        ("$TOOL", VARIABLES["$TOOL"].replace("B 0.0", "B 90.0"), "B 90.000"),
        ("$BASE", VARIABLES["$BASE"].replace("X 0.0", "X 0.5"), "X 0.500"),
        ("HC_ACK", "6", "HC_ACK 6, wanted HC_SEQ 7"),
    ],
)
def test_a_wrong_robot_is_refused(name: str, value: str, message: str) -> None:
    with KukaPeer(**{name: value}) as peer:
        robot = robot_for(peer)
        with pytest.raises(DeviceRefused, match=message) as caught:
            robot.connect()
        assert caught.value.code == ALARMS[name]
        with pytest.raises(DeviceError, match="not connected"):
            robot.read()


def test_a_wrong_serial_is_refused(peer: KukaPeer) -> None:
    with pytest.raises(DeviceRefused, match="serial 472911, wanted 1"):
        robot_for(peer, serial=1).connect()


@pytest.mark.parametrize("value", ["1,234", "NaN", "{X 1.0}", "100.5", ""])
def test_unreadable_answers_are_errors(value: str) -> None:
    with KukaPeer(**{"$OV_PRO": value}) as peer, pytest.raises(DeviceError, match=r"\$OV_PRO"):
        robot_for(peer).connect()


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("$ALARM_STOP", "FALSE", "emergency stop"),
        ("$MODE_OP", "#T1", "#T1"),
        ("$OV_PRO", "0", "override"),
        ("$PRO_STATE1", "#P_RESET", "#P_RESET"),
        ("$ACT_TOOL", "2", "ACT_TOOL"),
        ("$ACT_BASE", "2", "ACT_BASE"),
        ("$STOPMESS", "TRUE", "stop message"),
    ],
)
def test_a_fault_in_motion_is_named(
    robot: KukaC3Robot, peer: KukaPeer, name: str, value: str, message: str
) -> None:
    peer.frozen = True
    peer.variables[name] = value
    with pytest.raises(DeviceError, match=message):
        robot.move_to(TARGET_RAD, 30.0)
    robot.close()
    assert peer.stopped.wait(5)


@pytest.mark.parametrize("name", ["$ACT_TOOL", "$ACT_BASE"])
def test_a_frame_changed_in_motion_spoils_the_reading(
    robot: KukaC3Robot, peer: KukaPeer, name: str
) -> None:
    peer.moved = lambda: peer.variables.update({name: "5"})
    with pytest.raises(DeviceError, match=rf"\{name} is 5"):
        robot.move_to(TARGET_RAD, 30.0)


def test_the_cause_is_reported_before_its_consequence(robot: KukaC3Robot, peer: KukaPeer) -> None:
    peer.frozen = True
    peer.variables |= {"$PRO_STATE1": "#P_STOP", "$PERI_RDY": "FALSE", "$ALARM_STOP": "FALSE"}
    with pytest.raises(DeviceError, match=r"\$ALARM_STOP is FALSE, wanted TRUE; emergency stop"):
        robot.move_to(TARGET_RAD, 30.0)


@pytest.mark.parametrize(("error", "message"), [("1", "unknown command"), ("2", "software limits")])
def test_the_programs_errors_are_reported(
    robot: KukaC3Robot, peer: KukaPeer, error: str, message: str
) -> None:
    peer.error = error
    with pytest.raises(DeviceError, match=message):
        robot.move_to(TARGET_RAD, 30.0)


def test_a_frozen_robot_is_noticed(robot: KukaC3Robot, peer: KukaPeer) -> None:
    peer.frozen = True
    with pytest.raises(DeviceError, match=r"no axis moved for .* HC_ACK 7, wanted HC_ACK 8"):
        robot.move_to(TARGET_RAD, 30.0)


@pytest.mark.parametrize(("short_deg", "found"), [(-0.006, r"A1 9\.994"), (0.006, r"A1 10\.006")])
def test_stopping_beside_the_target_is_noticed(
    robot: KukaC3Robot, peer: KukaPeer, short_deg: float, found: str
) -> None:
    peer.short_deg = short_deg
    with pytest.raises(DeviceError, match=found):
        robot.move_to(TARGET_RAD, 30.0)


@pytest.mark.parametrize("steps", [range(1000), range(999, -1, -1)], ids=["up", "down"])
def test_a_moving_pose_is_not_rest(
    robot: KukaC3Robot, peer: KukaPeer, monkeypatch: pytest.MonkeyPatch, steps: range
) -> None:
    number = iter(steps)
    original = peer._read

    def read(name: str) -> str | None:
        if name == "$POS_ACT":
            return peer.pose.replace("1620.5", f"1{next(number):03}.5")
        return original(name)

    monkeypatch.setattr(peer, "_read", read)
    with pytest.raises(DeviceError, match="stands or creeps"):
        robot.move_to(TARGET_RAD, 30.0)


@pytest.mark.parametrize("joints", [TARGET_RAD[:5], TARGET_RAD * np.nan])
def test_bad_targets_never_leave(robot: KukaC3Robot, peer: KukaPeer, joints: Array) -> None:
    with pytest.raises(DeviceError, match="six finite angles"):
        robot.move_to(joints, 30.0)
    assert "write HC_TGT" not in peer.requests


@pytest.mark.parametrize("speed", [0.0, 101.0, np.nan, np.inf])
def test_bad_speeds_never_leave(robot: KukaC3Robot, peer: KukaPeer, speed: float) -> None:
    with pytest.raises(DeviceError, match="1 to 100 %"):
        robot.move_to(TARGET_RAD, speed)
    assert "write HC_TGT" not in peer.requests


def test_a_stop_gets_through_while_a_call_hangs(robot: KukaC3Robot, peer: KukaPeer) -> None:
    asked = threading.Event()

    def hang(name: str, reply: bytes) -> list[bytes]:
        asked.set()
        return [] if name == "$AXIS_ACT" else [reply]

    peer.mangle = hang
    failures: list[DeviceError] = []

    def read() -> None:
        try:
            robot.read()
        except DeviceError as error:
            failures.append(error)

    worker = threading.Thread(target=read)
    worker.start()
    assert asked.wait(5)
    robot.stop()
    assert peer.stopped.wait(5)
    worker.join(5)
    assert "no answer" in str(failures[0])
    with pytest.raises(DeviceError, match=r"stopped|never answered"):
        robot.move_to(TARGET_RAD, 30.0)


def test_the_runs_stop_ends_a_motion(peer: KukaPeer) -> None:
    stop = threading.Event()
    peer.frozen = True
    options = KukaC3Robot.Options(
        host="127.0.0.1", port=peer.server.port, smr_mm=(98.0, 0.0, 127.0), joint=JOINTS
    )
    robot = KukaC3Robot(options, WallClock(stop))
    robot.connect()
    timer = threading.Timer(0.05, stop.set)
    timer.start()
    with pytest.raises(Stopped):
        robot.move_to(TARGET_RAD, 30.0)
    robot.close()
    assert peer.stopped.wait(5)


def test_only_a_new_connect_takes_a_stop_back(robot: KukaC3Robot, peer: KukaPeer) -> None:
    peer.moved = robot.stop
    with pytest.raises(DeviceError):
        robot.move_to(TARGET_RAD, 30.0)
    assert peer.stopped.wait(5)
    peer.moved = lambda: None
    assert peer.variables["HC_STOP"] == "TRUE"
    with pytest.raises(DeviceError, match="was stopped"):
        robot.move_to(TARGET_RAD, 30.0)
    robot.connect()
    assert peer.variables["HC_STOP"] == "FALSE"
    assert robot.move_to(TARGET_RAD, 30.0).still


def test_connect_waits_for_an_earlier_sessions_motion() -> None:
    with KukaPeer(HC_SEQ="8") as peer:
        peer._steps = 3
        robot = robot_for(peer)
        robot.connect()
        assert peer.variables["HC_ACK"] == "8"
        robot.close()


def test_a_restarted_controller_fails_every_read(robot: KukaC3Robot, peer: KukaPeer) -> None:
    peer.variables.clear()
    with pytest.raises(DeviceError, match="refused with error 1"):
        robot.move_to(TARGET_RAD, 30.0)


def test_idle_connections_are_kept_and_a_loss_is_reported(
    peer: KukaPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(keep_alive, "IDLE_S", 0.02)
    monkeypatch.setattr(keep_alive, "LOOK_S", 0.01)
    twice = threading.Event()

    def count(name: str, reply: bytes) -> list[bytes]:
        if peer.requests.count("read $MODE_OP") >= 5:
            twice.set()
        return [reply]

    peer.mangle = count
    robot = robot_for(peer)
    robot.connect()
    assert twice.wait(5)
    assert peer.connections == 2  # only now: a connection is made before it is accepted
    peer.server.drop()
    keeper = robot.wire()._keeper  # type: ignore[attr-defined]  # of the C3 wires
    keeper._thread.join(5)
    with pytest.raises(DeviceError, match=r"closed the connection|reset|Broken pipe"):
        robot.read()
    robot.close()


def test_stop_and_close_before_connect_do_nothing(peer: KukaPeer) -> None:
    robot = robot_for(peer)
    robot.stop()
    robot.close()
    assert peer.requests == []


def test_options_are_strict() -> None:
    with pytest.raises(SettingsError) as caught:
        convert(
            {"host": "x", "smr_mm": [1.0, 2.0, 3.0], "joint": [], "prt": 1, "tool": 0},
            KukaC3Robot.Options,
            "",
        )
    assert len(caught.value.problems) == 2
