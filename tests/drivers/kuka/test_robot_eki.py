"""A KUKA robot over two EthernetKRL channels, and their documents."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.device_errors import ProtocolError
from drivers.kuka import controller, robot_eki
from drivers.kuka import robot_eki as eki
from drivers.kuka.robot_eki import KukaEkiRobot
from hilcell.ports import DeviceError, DeviceRefused, Robot, Stopped, Sweeps
from tests.drivers.kuka.eki_peer import EkiPeer
from tests.drivers.kuka.kuka_bed import ALARMS, JOINTS, TARGET_RAD
from tests.drivers.peers import Bed, WireTime, in_thread, kind, refusal

SHORT = b'<RobotState><Command Id="17" Finished_Id="5"/><Pos A1="1.5" A2="nan"/></RobotState>'
DECLARED = b'<?xml version="1.0" encoding="UTF-8"?>\r\n'
BOMB = (
    b'<!DOCTYPE RobotState [<!ENTITY a "1"><!ENTITY b "&a;&a;&a;&a;">]>'
    b'<RobotState><Command Id="&b;"/></RobotState>'
)
UNFIT = {
    "$ALARM_STOP": "FALSE", "$USER_SAF": "FALSE", "$MODE_OP": "#T1", "$PERI_RDY": "FALSE",
    "$STOPMESS": "TRUE", "$PRO_STATE1": "#P_FREE", "$OV_PRO": "0", "$ACT_TOOL": "3",
}  # fmt: skip


class BedRobot(KukaEkiRobot):
    """A robot at its peer."""

    def __init__(self, peer: EkiPeer, time: WireTime, **options: Any) -> None:
        values: dict[str, Any] = {
            "host": "127.0.0.1",
            "port": peer.server.port,
            "stop_port": peer.stop_server.port,
            "smr_mm": (98.0, 0.0, 127.0),
            "joint": JOINTS,
        }
        super().__init__(self.Options(**(values | options)), time)
        self.peer, self.time = peer, time


EkiBed = Bed[EkiPeer, BedRobot]


@pytest.fixture
def bed(time: WireTime) -> Iterator[EkiBed]:
    with EkiPeer() as peer, closing(Bed(peer, time, BedRobot)) as bed:
        yield bed


@pytest.fixture
def robot(bed: EkiBed) -> BedRobot:
    return bed.connect()


def test_identity(bed: EkiBed) -> None:
    robot, peer = bed.make(), bed.peer
    port: Robot = robot
    assert isinstance(port, Sweeps)
    (identity,) = robot.connect()
    robot.close()
    assert (identity.model, identity.serial) == ("#KR210R2700_2 C4 FLR", "472911")
    assert identity.address == f"127.0.0.1:{peer.server.port}"
    assert identity.firmware == "hilcell.src 4"
    assert {command["Type"] for command in peer.commands} == {str(robot_eki.Kind.ASK)}


def test_a_move_is_one_document_that_only_its_finished_id_confirms(robot: BedRobot) -> None:
    began = len(robot.peer.commands)
    reading = robot.move_to(TARGET_RAD, 30.0)
    np.testing.assert_allclose(reading.joints_rad, TARGET_RAD, atol=1e-8)
    assert reading.still
    look, motion, *others = robot.peer.commands[began:]
    assert look["Type"] == str(robot_eki.Kind.ASK)
    moved = {"Id": "8", "Type": str(robot_eki.Kind.MOVE), "Percent": "30"}
    assert moved | {"A3": "95.500000", "Life": "1500"} == {
        name: motion[name] for name in ("Id", "Type", "Percent", "A3", "Life")
    }
    assert all(int(other["Id"]) < 0 for other in others)
    assert len(others) <= 6


@pytest.mark.parametrize(("name", "value"), UNFIT.items())
def test_a_wrong_state_refuses_to_connect_and_ends_a_motion(
    bed: EkiBed, name: str, value: str
) -> None:
    peer = bed.peer
    good, peer.variables[name] = peer.variables[name], value
    assert kind(refusal(bed.make().connect)) == (DeviceRefused, ALARMS[name])
    peer.variables[name] = good
    robot = bed.connect()
    peer.variables[name] = value
    assert refusal(lambda: robot.move_to(TARGET_RAD, 30.0)).code == ALARMS[name]
    assert peer.variables["HC_SEQ"] == "7", "no motion was ordered"
    peer.variables[name], peer.frozen = good, True
    peer.started = lambda: peer.variables.update({name: value})
    assert refusal(lambda: robot.move_to(TARGET_RAD, 30.0)).code == ALARMS[name]
    robot.close()
    peer.stopped.wait()


def test_a_program_with_other_documents_is_refused(bed: EkiBed) -> None:
    bed.peer.variables["HE_VER"] = "1"
    assert kind(refusal(bed.make().connect)) == (DeviceRefused, "HC-B17")


def test_answers_in_pieces_and_twice_in_a_packet(robot: BedRobot) -> None:
    former: list[bytes] = [b""]

    def glue(_number: int, answer: bytes) -> list[bytes]:
        before, former[0] = former[0], answer
        whole = before + answer
        return [whole[:700], whole[700:]]

    robot.peer.spoil = glue
    assert robot.move_to(TARGET_RAD, 30.0).still


@pytest.mark.parametrize(
    ("answers", "code"),
    [
        ([BOMB], "HC-B49"),
        ([b"<RobotState>" + b"0" * 9000], "HC-B49"),
        ([b"\0" * 40 + b"</RobotState>"], "HC-B49"),
        ([b"<RobotState><Command"], "HC-B02"),
        ([], "HC-B02"),
    ],
)
def test_bad_answers_by_policy(robot: BedRobot, answers: list[bytes], code: str) -> None:
    robot.peer.spoil = lambda _number, _answer: answers
    if code == "HC-B02":
        robot.time.silence(0.1)
    assert refusal(robot.read).code == code


def test_an_answer_with_another_id_is_never_used(robot: BedRobot) -> None:
    robot.peer.spoil = lambda number, answer: [answer.replace(f'"{number}"'.encode(), b'"-12"')]
    robot.time.silence(0.1)
    assert refusal(robot.read).code == "HC-B02"


def test_not_a_number_is_an_error(robot: BedRobot) -> None:
    robot.peer.pose = robot.peer.pose.replace("1620.5", "NaN")
    assert refusal(robot.read).code == "HC-B26"


def test_a_stop_gets_through_while_a_call_hangs(robot: BedRobot) -> None:
    asked = threading.Event()

    def hang(_number: int, _answer: bytes) -> list[bytes]:
        asked.set()
        return []

    robot.peer.spoil = hang
    with in_thread(robot.read, DeviceError) as failures:
        asked.wait()
        robot.stop()
        robot.peer.stopped.wait()
        robot.time.silence(0.1)
    assert [getattr(each, "code", "") for each in failures] == ["HC-B02"]


def test_a_dead_channel_of_the_stop_is_noticed_at_rest(
    bed: EkiBed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(controller.KeepAlive, "IDLE_S", 0.02)
    monkeypatch.setattr(controller.KeepAlive, "PERIOD_S", 0.01)
    monkeypatch.setattr(controller, "time", bed.time)
    robot = bed.connect()
    bed.peer.stop_server.drop()
    bed.time.wait(1.0)
    robot.wire()._keeper._thread.join()
    assert refusal(lambda: robot.move_to(TARGET_RAD, 30.0)).code == "HC-B02"
    robot.close()


def test_a_sweep_lowers_the_override_and_gives_it_back(robot: BedRobot) -> None:
    peer = robot.peer
    seen: set[tuple[str, str]] = set()
    peer.moved = lambda: seen.add((peer.variables["$OV_PRO"], peer.variables["HC_OV_OLD"]))
    with robot.sweep(0, 0.1, float(np.radians(0.1))) as moving:
        moving.kickoff()
        sample = moving.collect()
        assert moving.complete().still
    assert sample.before_s <= sample.after_s
    assert seen == {("10", "100")}
    assert (peer.variables["$OV_PRO"], peer.variables["HC_OV_OLD"]) == ("100", "0")


def test_a_stop_in_a_sweep_gives_the_override_back_over_the_same_channel(robot: BedRobot) -> None:
    """The controller serves one client a channel: there is no second connection."""

    def swept() -> None:
        with robot.sweep(0, 0.1, float(np.radians(0.1))) as moving:
            moving.kickoff()
            robot.time.stop.set()
            moving.collect()

    with pytest.raises(Stopped):
        swept()
    assert (robot.peer.variables["$OV_PRO"], robot.peer.variables["HC_STOP"]) == ("100", "TRUE")


def test_a_channel_that_is_not_yet_open_again_is_tried_for_a_while(
    bed: EkiBed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(robot_eki, "OPEN_S", 60.0)
    tries = iter([[b"x" * 9000 + b"</RobotState>"]] * 2)
    bed.peer.spoil = lambda _number, answer: next(tries, [answer])
    robot = bed.connect()
    robot.close()


def test_signs_come_from_the_watched_motion_only(robot: BedRobot) -> None:
    """A connect that waits for a dead engine's motion must not keep it alive."""
    assert {command["Life"] for command in robot.peer.commands} == {"0"}
    began = len(robot.peer.commands)
    robot.move_to(TARGET_RAD, 30.0)
    look, motion, *others = [command["Life"] for command in robot.peer.commands[began:]]
    assert (look, motion) == ("0", "1500")
    assert others[:2] == ["1500", "1500"]
    assert set(others[-2:]) == {"0"}
    robot.read()
    assert robot.peer.commands[-1]["Life"] == "0"


def test_a_command_has_all_values() -> None:
    """A queue that gets no value would shift all later ones."""
    document = eki.command(7, eki.Kind.MOVE, axes=(1.0, -90.0, 90.5, 0.0, 0.25, -6.0), percent=30)
    assert document == (
        b'<RobotCommand Id="7" Type="1" Percent="30" Life="0"><Pos A1="1.000000" A2="-90.000000" '
        b'A3="90.500000" A4="0.000000" A5="0.250000" A6="-6.000000" E1="0.000000"></Pos>'
        b"</RobotCommand>"
    )
    names = [part.split(b"=")[0] for part in document.split() if b"=" in part]
    asked = eki.command(-3, eki.Kind.ASK)
    assert names == [part.split(b"=")[0] for part in asked.split() if b"=" in part]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_no_target_that_is_not_finite(bad: float) -> None:
    with pytest.raises(ProtocolError, match="A2"):
        eki.command(7, eki.Kind.MOVE, axes=(0.0, bad, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(ProtocolError, match="E1"):
        eki.command(7, eki.Kind.MOVE, e1=bad)


@given(st.lists(st.integers(1, 40)))
def test_documents_come_in_any_pieces(cuts: list[int]) -> None:
    stream = SHORT + b"\r\n" + SHORT.replace(b'"17"', b'"18"') + b"<RobotSt"
    found, rest = [], b""
    while stream:
        size = cuts.pop() if cuts else len(stream)
        whole, rest = eki.split(rest + stream[:size], eki.STATE)
        stream = stream[size:]
        found += whole
    assert [eki.parse(document, eki.STATE)[0] for document in found] == [17, 18]
    assert rest == b"<RobotSt"


def test_a_document_without_an_end_is_an_error() -> None:
    eki.split(b"<RobotState>" + b" " * (eki.LONGEST - 12), eki.STATE)
    with pytest.raises(ProtocolError, match="8193"):
        eki.split(b"<RobotState>" + b" " * (eki.LONGEST - 11), eki.STATE)


def test_values_of_a_state() -> None:
    number, state = eki.parse(SHORT, eki.STATE)
    assert number == 17
    assert state.single("HC_ACK") == 5
    assert state.numbers("$AXIS_ACT", ["A1"]) == [1.5]
    with pytest.raises(ProtocolError):
        state.numbers("$AXIS_ACT", ["A2"])
    with pytest.raises(ProtocolError, match="Status/@Mode_Op"):
        state.single("$MODE_OP")


def test_documents_behind_an_xml_declaration_and_in_capitals() -> None:
    loud = SHORT.replace(b"RobotState", b"ROBOTSTATE").replace(b"Finished_Id", b"FINISHED_ID")
    received = DECLARED + SHORT + b"\r\n" + DECLARED + loud
    whole, rest = eki.split(received, eki.STATE)
    assert (len(whole), rest) == (2, b"")
    for document in whole:
        number, state = eki.parse(document, eki.STATE)
        assert (number, state.single("HC_ACK"), state.text("Pos", "A1")) == (17, 5, "1.5")


@pytest.mark.parametrize(
    ("text", "value"),
    [("TRUE", True), ("true", True), ("1", True), ("0", False), ("False", False), ("2", 2)],
)
def test_booleans_as_text_or_numbers(text: str, value: object) -> None:
    document = (
        f'<RobotState><Command Id="1" Stopped="{text}"/><Status Pro_State1="1"/></RobotState>'
    )
    state = eki.parse(document.encode(), eki.STATE)[1]
    stopped = state.single("HC_STOP")
    assert (stopped, type(stopped)) == (value, type(value))
    assert state.single("$PRO_STATE1") == 1
    assert not isinstance(state.single("$PRO_STATE1"), bool)


@pytest.mark.parametrize(
    "document",
    [
        BOMB,
        DECLARED + DECLARED + SHORT,
        DECLARED.replace(b"?>", b"<?>") + SHORT,
        DECLARED + BOMB,
        SHORT.replace(b'Finished_Id="5"', b'Id="17" id="18"'),
        SHORT.replace(b"<Pos", b"<pos A1='0'/><Pos"),
        SHORT.replace(b"<Pos", b"<!-- x --><Pos"),
        SHORT.replace(b"17", "１７".encode()),
        SHORT.replace(b'"17"', b'"&c;"'),
        SHORT.replace(b"<Pos", b"<<Pos"),
        SHORT.replace(b'Id="17"', b'Id="17" Id="18"'),
        SHORT.replace(b"17", b"1.5"),
        SHORT.replace(b"17", b"9" * 5000),
        SHORT.replace(b"Command", b"Other"),
        SHORT.replace(b"Pos A1", b"Command A1"),
        SHORT.replace(b'5"/>', b'5"><Deep/></Command>'),
        SHORT.replace(b"RobotState", b"RobotStatus"),
        b"</RobotState>",
    ],
)
def test_other_documents_are_refused(document: bytes) -> None:
    with pytest.raises(ProtocolError):
        eki.parse(document, eki.STATE)


@given(st.binary(max_size=200))
def test_any_bytes_are_a_document_or_an_error(data: bytes) -> None:
    for document in (data, SHORT[:40] + data + SHORT[40:]):
        try:
            whole, _ = eki.split(document, eki.STATE)
            for each in whole:
                eki.parse(each, eki.STATE)
        except ProtocolError:
            pass
