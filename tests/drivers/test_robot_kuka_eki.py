from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from drivers.kuka import eki, robot_eki
from drivers.kuka import robot as kuka_robot
from drivers.kuka import sweep as kuka_sweep
from drivers.kuka.robot_eki import KukaEkiRobot
from drivers.wires import keep_alive
from hilcell.clock import WallClock
from hilcell.ports import Clock, DeviceError, DeviceRefused, Robot, Stopped, Sweeps
from tests.drivers.eki_peer import EkiPeer
from tests.drivers.peers import wall_clock
from tests.drivers.test_robot_kuka_c3 import ALARMS, JOINTS, TARGET_RAD

HEALTHY = {
    "$ALARM_STOP": "FALSE", "$USER_SAF": "FALSE", "$MODE_OP": "#T1", "$PERI_RDY": "FALSE",
    "$STOPMESS": "TRUE", "$PRO_STATE1": "#P_FREE", "$OV_PRO": "0", "$ACT_TOOL": "3",
}  # fmt: skip


@pytest.fixture(autouse=True)
def short_deadlines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot_eki, "ANSWER_S", 0.3)
    monkeypatch.setattr(robot_eki, "OPEN_S", 0.05)
    for module in (kuka_robot, kuka_sweep):
        for name, value in (("POLL_S", 0.002), ("DWELL_S", 0.002), ("REST_S", 0.2)):
            monkeypatch.setattr(module, name, value)
    for name, value in (("STALL_S", 0.3), ("CATCH_UP_S", 0.2)):
        monkeypatch.setattr(kuka_robot, name, value)


def robot_for(peer: EkiPeer, clock: Clock | None = None, **options: Any) -> KukaEkiRobot:
    values: dict[str, Any] = {
        "host": "127.0.0.1",
        "port": peer.server.port,
        "stop_port": peer.stop_server.port,
        "smr_mm": (98.0, 0.0, 127.0),
        "joint": JOINTS,
    }
    return KukaEkiRobot(KukaEkiRobot.Options(**(values | options)), clock or wall_clock())


@pytest.fixture
def peer() -> Iterator[EkiPeer]:
    with EkiPeer() as peer:
        yield peer


@pytest.fixture
def robot(peer: EkiPeer) -> Iterator[KukaEkiRobot]:
    robot = robot_for(peer)
    robot.connect()
    yield robot
    robot.close()


def test_it_is_a_robot_that_sweeps(robot: KukaEkiRobot) -> None:
    port: Robot = robot
    assert port.read().still
    assert isinstance(robot, Sweeps)


def test_identity(peer: EkiPeer) -> None:
    robot = robot_for(peer)
    (identity,) = robot.connect()
    robot.close()
    assert (identity.model, identity.serial) == ("#KR210R2700_2 C4 FLR", "472911")
    assert identity.address == f"127.0.0.1:{peer.server.port}"
    assert identity.firmware == "hilcell.src 4"
    assert {command["Type"] for command in peer.commands} == {str(eki.ASK)}


def test_a_move_is_one_document_that_only_its_finished_id_confirms(
    robot: KukaEkiRobot, peer: EkiPeer
) -> None:
    began = len(peer.commands)
    reading = robot.move_to(TARGET_RAD, 30.0)
    np.testing.assert_allclose(reading.joints_rad, TARGET_RAD, atol=1e-8)
    assert reading.still
    motion, *others = peer.commands[began:]
    assert (motion["Id"], motion["Type"], motion["Percent"]) == ("8", str(eki.MOVE), "30")
    assert (motion["A3"], motion["Life"]) == ("95.500000", "1500")
    assert all(int(other["Id"]) < 0 for other in others)
    assert len(others) <= 6


@pytest.mark.parametrize(("name", "value"), HEALTHY.items())
def test_a_wrong_state_refuses_to_connect(name: str, value: str) -> None:
    with EkiPeer(**{name: value}) as peer:
        with pytest.raises(DeviceRefused) as caught:
            robot_for(peer).connect()
        assert caught.value.code == ALARMS[name]


@pytest.mark.parametrize(("name", "value"), HEALTHY.items())
def test_a_fault_in_motion_is_named(
    robot: KukaEkiRobot, peer: EkiPeer, name: str, value: str
) -> None:
    peer.frozen = True
    peer.variables[name] = value
    with pytest.raises(DeviceError) as caught:
        robot.move_to(TARGET_RAD, 30.0)
    assert caught.value.code == ALARMS[name]
    robot.close()
    assert peer.stopped.wait(5)


def test_other_documents_are_refused() -> None:
    with EkiPeer() as peer:
        peer.variables["HE_VER"] = "2"
        with pytest.raises(DeviceRefused, match="HE_VER is 2, wanted 1") as caught:
            robot_for(peer).connect()
        assert caught.value.code == "HC-B17"


def test_answers_in_pieces_and_twice_in_a_packet(robot: KukaEkiRobot, peer: EkiPeer) -> None:
    former: list[bytes] = [b""]

    def glue(_number: int, answer: bytes) -> list[bytes]:
        before, former[0] = former[0], answer
        whole = before + answer
        return [whole[:700], whole[700:]]

    peer.spoil = glue
    assert robot.move_to(TARGET_RAD, 30.0).still


BOMB = (
    b'<!DOCTYPE RobotState [<!ENTITY a "1"><!ENTITY b "&a;&a;">]>'
    b'<RobotState><Command Id="&b;"/></RobotState>'
)


@pytest.mark.parametrize(
    ("answers", "code", "message"),
    [
        ([BOMB], "HC-B49", "a declaration"),
        ([b"<RobotState>" + b"0" * 9000], "HC-B49", r"9012 bytes without </RobotState>"),
        ([b"\0" * 40 + b"</RobotState>"], "HC-B49", "no XML"),
        ([b"<RobotState><Command"], "HC-B02", "no answer within .* 20 bytes of one came"),
        ([], "HC-B02", "no answer within"),
    ],
)
def test_bad_answers_by_policy(
    robot: KukaEkiRobot, peer: EkiPeer, answers: list[bytes], code: str, message: str
) -> None:
    peer.spoil = lambda _number, _answer: answers
    with pytest.raises(DeviceError, match=message) as caught:
        robot.read()
    assert caught.value.code == code


def test_an_answer_with_another_id_is_never_used(robot: KukaEkiRobot, peer: EkiPeer) -> None:
    peer.spoil = lambda number, answer: [answer.replace(f'"{number}"'.encode(), b'"-12"')]
    with pytest.raises(DeviceError, match="1 answers to other commands came") as caught:
        robot.read()
    assert caught.value.code == "HC-B02"


def test_not_a_number_is_an_error(robot: KukaEkiRobot, peer: EkiPeer) -> None:
    peer.pose = peer.pose.replace("1620.5", "NaN")
    with pytest.raises(DeviceError, match="POS_ACT") as caught:
        robot.read()
    assert caught.value.code == "HC-B26"


def test_a_stop_gets_through_while_a_call_hangs(robot: KukaEkiRobot, peer: EkiPeer) -> None:
    asked = threading.Event()

    def hang(_number: int, _answer: bytes) -> list[bytes]:
        asked.set()
        return []

    peer.spoil = hang
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


def test_only_a_new_connect_takes_a_stop_back(robot: KukaEkiRobot, peer: EkiPeer) -> None:
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


def test_a_dead_channel_of_the_stop_is_noticed_at_rest(
    peer: EkiPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(keep_alive, "IDLE_S", 0.02)
    monkeypatch.setattr(keep_alive, "LOOK_S", 0.01)
    robot = robot_for(peer)
    robot.connect()
    peer.stop_server.drop()
    robot.wire()._keeper._thread.join(5)  # type: ignore[attr-defined]  # of the EKI wires
    with pytest.raises(DeviceError, match=r"closed the connection|reset|Broken pipe"):
        robot.move_to(TARGET_RAD, 30.0)
    robot.close()


def test_a_sweep_lowers_the_override_and_gives_it_back(robot: KukaEkiRobot, peer: EkiPeer) -> None:
    seen: set[tuple[str, str]] = set()
    peer.moved = lambda: seen.add((peer.variables["$OV_PRO"], peer.variables["HC_OV_OLD"]))
    with robot.sweep(0, 0.1, float(np.radians(0.1))) as flyer:
        flyer.kickoff()
        sample = flyer.collect()
        assert flyer.complete().still
    assert sample.before_s <= sample.after_s
    assert seen == {("10", "100")}
    assert (peer.variables["$OV_PRO"], peer.variables["HC_OV_OLD"]) == ("100", "0")


def test_a_stop_in_a_sweep_gives_the_override_back_over_the_same_channel(peer: EkiPeer) -> None:
    """The controller serves one client a channel: there is no second connection."""
    stop = threading.Event()
    robot = robot_for(peer, WallClock(stop))
    robot.connect()

    def swept() -> None:
        with robot.sweep(0, 0.1, float(np.radians(0.1))) as flyer:
            flyer.kickoff()
            stop.set()
            flyer.collect()

    with pytest.raises(Stopped):
        swept()
    assert (peer.variables["$OV_PRO"], peer.variables["HC_STOP"]) == ("100", "TRUE")
    robot.close()


def test_a_channel_that_is_not_yet_open_again_is_tried_for_a_while(
    peer: EkiPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(robot_eki, "OPEN_S", 5.0)
    tries = iter([[], [b"x" * 9000 + b"</RobotState>"]])
    peer.spoil = lambda _number, answer: next(tries, [answer])
    robot = robot_for(peer)
    robot.connect()
    robot.close()


def test_signs_come_from_the_watched_motion_only(robot: KukaEkiRobot, peer: EkiPeer) -> None:
    """A connect that waits for a dead engine's motion must not keep it alive."""
    assert {command["Life"] for command in peer.commands} == {"0"}
    began = len(peer.commands)
    robot.move_to(TARGET_RAD, 30.0)
    motion, *others = [command["Life"] for command in peer.commands[began:]]
    assert motion == "1500"
    assert others[:2] == ["1500", "1500"]
    assert set(others[-2:]) == {"0"}
    robot.read()
    assert peer.commands[-1]["Life"] == "0"
