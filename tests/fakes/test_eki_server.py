from __future__ import annotations

import contextlib
import re
import socket
from collections.abc import Iterator

import pytest

from fakes.kuka.controller import KrlError
from fakes.kuka.eki_server import RECEIVED, EkiServer, Overflow, Queues
from hilcell.cell.file import Cell
from tests.fakes.conftest import DeviceTime, Served, served
from tests.fakes.rail_bench import until
from tests.fakes.wires import connected

NEAR = [5.0, -85.0, 95.0, 0.0, -30.0, 10.0]
FAR = [-60.0, -60.0, 60.0, 30.0, -60.0, 90.0]
END, STOP_END = b"</RobotState>", b"</RobotStopState>"
ASK, MOVE, BRAKE, RELEASE, LOWER, GIVE_BACK = range(6)


class EkiClient:
    """Frames on the closing tag."""

    def __init__(self, wire: socket.socket, end: bytes = END) -> None:
        self.wire, self._end, self._pending = wire, end, b""

    def document(self) -> bytes:
        while self._end not in self._pending:
            piece = self.wire.recv(4096)
            if not piece:
                raise EOFError(self._pending)
            self._pending += piece
        first, _, self._pending = self._pending.partition(self._end)
        return first + self._end

    def send(self, number: int, kind: int, axes: list[float] | None = None, more: int = 30) -> None:
        places = " ".join(f'A{n}="{v}"' for n, v in enumerate(axes or [0.0] * 6, 1))
        self.wire.sendall(
            f'<RobotCommand Id="{number}" Type="{kind}" Percent="{more}" Life="1500">'
            f'<Pos {places} E1="0"/></RobotCommand>'.encode()
        )

    def answer(self, number: int) -> dict[str, str]:
        """Return element.attribute: text of the answer to a command."""
        while True:
            found = values(self.document())
            if found["Command.Id"] == str(number):
                return found

    def ask(self, number: int, kind: int = ASK, axes: list[float] | None = None) -> dict[str, str]:
        self.send(number, kind, axes)
        return self.answer(number)

    def go(self, number: int, axes: list[float]) -> dict[str, str]:
        state = self.ask(number, MOVE, axes)
        for asked in range(-100, 0):
            if state["Command.Finished_Id"] == str(number):
                return state
            state = self.ask(asked)
        raise AssertionError("never finished")


def values(document: bytes) -> dict[str, str]:
    found = {}
    for element, attributes in re.findall(r"<(\w+) ([^>]*)/>", document.decode()):
        for name, text in re.findall(r'(\w+)="([^"]*)"', attributes):
            found[f"{element}.{name}"] = text
    return found


def axes_of(state: dict[str, str]) -> list[float]:
    return [float(state[f"Pos.A{n}"]) for n in range(1, 7)]


Robot = Served[EkiServer, EkiClient]


@pytest.fixture
def robot(cell: Cell) -> Iterator[Robot]:
    with served(EkiServer, EkiClient, cell) as robot:
        yield robot


def test_a_motion_by_one_document(robot: Robot) -> None:
    state = robot.client.go(7, NEAR)
    assert axes_of(state) == pytest.approx(NEAR, abs=1.2e-4)
    assert (state["Error.Code"], state["Command.Motion_Id"]) == ("0", "7")
    assert state["Robot.Model"] == "#KR210R2700_2 C4 FLR SIMULATED"
    assert (state["Status.Mode_Op"], state["Status.Alarm_Stop"]) == ("#EX", "TRUE")


def test_documents_in_pieces_and_several_in_one_packet(robot: Robot) -> None:
    command = b'<RobotCommand Id="3" Type="0" Percent="1" Life="0"><Pos A1="0" A2="0" A3="0" '
    command += b'A4="0" A5="0" A6="0" E1="0"/></RobotCommand>'
    for byte in command:
        robot.client.wire.sendall(bytes([byte]))
    assert robot.client.answer(3)
    robot.client.wire.sendall(command.replace(b'"3"', b'"4"') + command.replace(b'"3"', b'"5"'))
    assert robot.client.answer(4)["Command.Id"] == "4"
    assert robot.client.answer(5)["Command.Id"] == "5"


def test_answers_come_late_in_pieces_and_twice_by_themselves(robot: Robot) -> None:
    found = []
    for number in range(1, 121):
        robot.client.send(number, ASK)
        found.append(values(robot.client.document())["Command.Id"])
        if found[-1] != str(number):
            found.append(values(robot.client.document())["Command.Id"])
    assert found[:54] == [*(str(n) for n in range(1, 53)), "52", "53"]
    assert len(found) == 122


def test_one_client_a_channel(robot: Robot) -> None:
    robot.client.ask(1)
    with connected(robot.server.port) as second, pytest.raises((EOFError, ConnectionError)):
        EkiClient(second).ask(2)
    robot.client.wire.shutdown(socket.SHUT_RDWR)
    until(lambda: opens(robot))


def opens(robot: Robot) -> bool:
    with connected(robot.server.port) as wire, contextlib.suppress(EOFError, ConnectionError):
        return EkiClient(wire).ask(3)["Command.Id"] == "3"
    return False


def test_the_stop_has_a_channel_of_its_own(robot: Robot) -> None:
    robot.client.ask(1, MOVE, FAR)
    with connected(robot.server.stop_port) as wire:
        wire.sendall(b'<RobotStop Id="4" Brake="0"></RobotStop>')
        assert values(EkiClient(wire, STOP_END).document())["Command.Id"] == "4"
        assert robot.client.ask(-1)["Command.Stopped"] == "FALSE"
        wire.sendall(b'<RobotStop Id="5" Brake="1"></RobotStop>')
        EkiClient(wire, STOP_END).document()
    robot.truth.time.advance(5.0)
    state = robot.client.ask(-2)
    assert (state["Command.Stopped"], state["Error.Code"]) == ("TRUE", "9")
    assert state["Command.Finished_Id"] == "0"
    assert axes_of(state)[0] > FAR[0] + 1
    assert robot.client.ask(-3, RELEASE)["Command.Finished_Id"] == "1"


def test_the_override_is_lowered_and_given_back(robot: Robot) -> None:
    robot.client.send(-1, LOWER, more=7)
    lowered = robot.client.answer(-1)
    assert (lowered["Status.Ov_Pro"], lowered["Override.Old"]) == ("7", "100")
    back = robot.client.ask(-2, GIVE_BACK)
    assert (back["Status.Ov_Pro"], back["Override.Old"]) == ("100", "0")


def test_a_halted_program_still_has_its_state_told(robot: Robot) -> None:
    robot.client.ask(1, MOVE, FAR)
    robot.faults.set("robot.deselected")
    for number in range(-10, 0):
        state = robot.client.ask(number)
    assert state["Status.Pro_State1"] == "#P_FREE"
    assert state["Command.Finished_Id"] == "0"


def test_a_former_answer_may_come_again(robot: Robot) -> None:
    robot.client.ask(-5)
    robot.faults.set("robot.glued_reply")
    robot.client.send(-6, ASK)
    assert values(robot.client.document())["Command.Id"] == "-5"
    assert robot.client.answer(-6)


def test_a_value_that_is_left_out_shifts_all_later_ones() -> None:
    queues = Queues(RECEIVED)
    queues.add(b'<RobotCommand Id="1" Type="1"><Pos A1="10"/></RobotCommand>')
    queues.add(b'<RobotCommand Id="2"><Pos A1="20"/></RobotCommand>')
    queues.add(b'<RobotCommand Id="3" Type="5"><Pos A1="30"/></RobotCommand>')
    taken = [queues.take(), queues.take(), queues.take()]
    assert [(each["Id"], each.get("Type")) for each in taken] == [
        ("1", "1"),
        ("2", "5"),
        ("3", None),
    ]


def test_a_command_with_a_value_missing_is_none(robot: Robot) -> None:
    """The last command's value would take its place; a former type of 1 is a motion."""
    robot.client.go(1, NEAR)
    robot.client.wire.sendall(b'<RobotCommand Id="2" Life="9"><Pos E1="0"/></RobotCommand>')
    with pytest.raises((EOFError, ConnectionError)):
        robot.client.answer(2)
    assert robot.server.controller.read("HC_SEQ") == "1"


STOP = b'<RobotStop Id="%d" Brake="%d"></RobotStop>'


@pytest.mark.parametrize("sent", [STOP % (5, 1), STOP % (0, 0) + STOP % (5, 1), STOP % (5, 1) * 40])
def test_a_stop_brakes_though_its_client_has_gone(robot: Robot, sent: bytes) -> None:
    """The program looks once in a cycle; by then a PC that dies has closed its connection."""
    robot.faults.set("robot.frozen")
    robot.client.ask(1, MOVE, FAR)
    with connected(robot.server.stop_port) as wire:
        wire.sendall(sent)
    until(lambda: robot.server.controller.read("HC_STOP") == "TRUE")
    assert robot.server.controller.read("HC_ERR") == "9"  # the timer, later, sets 8


def test_a_stop_without_a_number_and_with_another_value_brakes(robot: Robot) -> None:
    with connected(robot.server.stop_port) as wire:
        wire.sendall(b'<RobotStop Brake="2"></RobotStop>')
        EkiClient(wire, STOP_END).document()
    assert robot.server.controller.read("HC_STOP") == "TRUE"


def test_a_motion_whose_client_has_gone_brakes(robot: Robot) -> None:
    robot.faults.set("robot.frozen")
    robot.client.ask(1, MOVE, FAR)
    robot.client.wire.shutdown(socket.SHUT_RDWR)
    until(lambda: robot.server.controller.read("HC_STOP") == "TRUE")
    assert robot.server.controller.read("HC_ERR") == "9"


def test_a_client_that_goes_after_its_motion_stops_nothing(robot: Robot) -> None:
    robot.client.go(1, NEAR)
    robot.client.wire.shutdown(socket.SHUT_RDWR)
    until(lambda: opens(robot))
    assert robot.server.controller.read("HC_STOP") == "FALSE"


def test_a_full_queue_closes_the_connection() -> None:
    queues = Queues(RECEIVED)
    for _ in range(Queues.LENGTH):
        queues.add(b'<RobotCommand Id="1"/>')
    with pytest.raises(Overflow):
        queues.add(b'<RobotCommand Id="1"/>')
    with pytest.raises(KrlError):
        queues.add(b"<RobotCommand")


def test_a_motion_brakes_when_no_command_comes(device_time: DeviceTime, robot: Robot) -> None:
    robot.faults.set("robot.frozen")  # it never arrives
    robot.client.ask(1, MOVE, FAR)
    for number in (-1, -2):
        device_time.at_s += 1.4
        assert robot.client.ask(number)["Command.Stopped"] == "FALSE"
    device_time.at_s += 1.6
    until(lambda: robot.server.controller.read("HC_ERR") == "8")
    assert robot.client.ask(-3)["Command.Stopped"] == "TRUE"
