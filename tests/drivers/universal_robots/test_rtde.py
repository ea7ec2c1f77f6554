"""RTDE: packages, and states from a controller that a test plays."""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import threading
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pytest

from drivers import supervision
from drivers.device_errors import ProtocolError
from drivers.universal_robots import rtde
from drivers.universal_robots import rtde as ur_link
from drivers.universal_robots.rtde import (
    ECHO,
    INPUTS,
    OUTPUTS,
    Kind,
    Order,
    Packages,
    Recipe,
    UrLink,
    UrState,
    encode,
)
from hilcell.ports import DeviceError, DeviceRefused
from tests.drivers.peers import Server, refusal, wire_time
from tests.fakes.rail_bench import until

RECIPE = Recipe(1, ("timestamp", "actual_q", "robot_mode"), ("DOUBLE", "VECTOR6D", "INT32"))
DATA = struct.pack(">B7di", 1, 12.5, *range(6), 7)


def test_golden_bytes() -> None:
    assert rtde.encode(Kind.VERSION, struct.pack(">H", rtde.VERSION)).hex() == "0005560002"
    (answer,) = Packages().feed(bytes.fromhex("00045601"))
    assert answer == (Kind.VERSION, b"\x01")
    assert rtde.encode(Kind.START).hex() == "000353"
    rate = struct.pack(">d", 125.0)
    outputs = Recipe.request(Kind.OUTPUTS, ("timestamp", "actual_q"), rate)
    assert outputs == b"\x00\x1d\x4f\x40\x5f\x40\x00\x00\x00\x00\x00timestamp,actual_q"


def test_packages_are_put_together_however_they_come() -> None:
    wire = rtde.encode(Kind.DATA, DATA) + rtde.encode(Kind.PAUSE, b"\x01")
    expected = [(Kind.DATA, DATA), (Kind.PAUSE, b"\x01")]
    assert list(Packages().feed(wire)) == expected
    for cut in range(1, len(wire)):
        packages = Packages()
        assert [*packages.feed(wire[:cut]), *packages.feed(wire[cut:])] == expected


@pytest.mark.parametrize(
    "name", ["actual_q", "actual_qd", "actual_TCP_pose", "output_double_register_29"]
)
def test_a_number_that_no_robot_has_is_refused(name: str) -> None:
    values: dict[str, rtde.Numbers] = {
        each: (0.5,) * (6 if each.startswith("actual") else 1) for each in OUTPUTS
    }
    UrState.checked(values, 0.0, 0.0)
    huge = (*values[name][1:], -1e200)
    with pytest.raises(ProtocolError, match=name):
        UrState.checked(values | {name: huge}, 0.0, 0.0)


@pytest.mark.parametrize("size", [0, 2, 4097, 65535])
def test_an_impossible_size_is_refused(size: int) -> None:
    with pytest.raises(ProtocolError, match=str(size)):
        list(Packages().feed(struct.pack(">HB", size, Kind.DATA)))


def test_data_by_recipe() -> None:
    values = RECIPE.decode(DATA)
    assert values == {"timestamp": (12.5,), "actual_q": (0, 1, 2, 3, 4, 5), "robot_mode": (7,)}
    assert RECIPE.encode(values) == rtde.encode(Kind.DATA, DATA)


@pytest.mark.parametrize("bad", ["nan", "inf", "-inf"])
def test_a_number_that_is_none_is_refused(bad: str) -> None:
    with pytest.raises(ProtocolError, match="timestamp"):
        RECIPE.decode(struct.pack(">B7di", 1, float(bad), *range(6), 7))


@pytest.mark.parametrize("payload", [b"", DATA[:-1], DATA + b"\0", b"\2" + DATA[1:]])
def test_data_of_another_recipe_is_refused(payload: bytes) -> None:
    with pytest.raises(ProtocolError):
        RECIPE.decode(payload)


def test_fields_that_the_controller_lacks_or_another_client_uses() -> None:
    recipe = Recipe.from_answer(("a", "b", "c"), b"\x01DOUBLE,NOT_FOUND,IN_USE")
    assert (recipe.lacking("NOT_FOUND"), recipe.lacking("IN_USE")) == (["b"], ["c"])
    for types in (b"\x01DOUBLE", b""):
        with pytest.raises(ProtocolError):
            Recipe.from_answer(("a", "b"), types)


def test_states_are_in_mm_and_rad() -> None:
    numbers: dict[str, rtde.Numbers] = dict.fromkeys(OUTPUTS, (0.0,))
    numbers["actual_TCP_pose"] = (0.5, -0.25, 1.0, 0.0, 0.0, 3.141592653589793)
    numbers["output_double_register_24"] = (0.09,)
    state = UrState.checked(numbers, 1.0, 2.0)
    assert state.pose[:3, 3].tolist() == [500.0, -250.0, 1000.0]
    assert state.pose[0].tolist()[:2] == pytest.approx([-1.0, 0.0], abs=1e-12)
    assert state.tool[0] == pytest.approx(90.0)


def test_each_value_of_a_state_is_that_of_its_field() -> None:
    numbers: dict[str, rtde.Numbers] = {name: (float(n),) for n, name in enumerate(OUTPUTS)}
    numbers |= {"actual_q": (0.1,) * 6, "actual_qd": (0.2,) * 6, "actual_TCP_pose": (0.3,) * 6}
    state = UrState.checked(numbers, 1.0, 2.0)
    values = {
        "timestamp": state.timestamp_s,
        "robot_mode": state.robot_mode,
        "safety_status": state.safety_status,
        "runtime_state": state.runtime_state,
        "target_speed_fraction": state.speed_fraction,
        "output_int_register_24": state.acknowledged,
        "output_int_register_25": state.error,
        "output_int_register_26": state.session,
        "output_int_register_27": state.count,
        ECHO: state.echo,
    }
    assert values == {name: numbers[name][0] for name in values}
    places = (state.joints_rad, state.speeds_rad_s, state.tcp)
    assert [each.tolist() for each in places] == [[0.1] * 6, [0.2] * 6, [0.3] * 6]


def test_registers_of_the_script() -> None:
    values = Order(7, np.arange(6.0), 0.25, stop=True).registers(3)
    assert tuple(values) == INPUTS
    assert [values[name][0] for name in INPUTS] == [7, 1, 3, 1, *range(6), 0.25]


SIX = {"actual_q", "actual_qd", "actual_TCP_pose"}
TYPES = ["VECTOR6D" if name in SIX else "DOUBLE" for name in OUTPUTS]
ECHOED = OUTPUTS.index(ECHO) - len(OUTPUTS)  # its place among the numbers of a state
QUESTION = struct.Struct(">Bi")
INTEGERS = struct.Struct(">B4i")
RATE_HZ = 125.0


class Controller:
    """Answers the set-up, and sends a state and ``besides``, when ``due`` returns.

    ``wrong`` is a package that it answers with instead of the right one of the same type.
    """

    def __init__(
        self,
        types: Sequence[str] = TYPES,
        due: Callable[[], object] = lambda: None,
        besides: bytes = b"",
        wrong: bytes = b"",
    ) -> None:
        self.types, self.due, self._besides, self._wrong = types, due, besides, wrong
        self.number, self.sent, self.question, self.takes = 1, 0, 0, True
        self.written: list[tuple[int, ...]] = []  # sequence, command, life, stop

    def serve(self, wire: socket.socket) -> None:
        packages = Packages()
        while data := wire.recv(65536):
            for kind, payload in packages.feed(data):
                asked = payload.split(b",")
                answer = {
                    Kind.CONTROLLER_VERSION: bytes(16),
                    Kind.OUTPUTS: b"\1" + ",".join(self.types).encode(),
                    Kind.INPUTS: b"\2" + b",".join(
                        b"INT32" if b"_int_" in each else b"DOUBLE" for each in asked
                    ),
                }.get(Kind(kind), b"\1")  # fmt: skip
                right = encode(Kind(kind), answer)
                wire.sendall(self._wrong if self._wrong[2:3] == right[2:3] else right)
                if kind == Kind.START:
                    self._send_states(wire, packages)

    def _send_states(self, wire: socket.socket, packages: Packages) -> None:
        while True:
            while self.takes and select.select([wire], [], [], 0.0)[0]:
                if not (data := wire.recv(65536)):
                    return
                for _, payload in packages.feed(data):
                    if len(payload) == QUESTION.size:
                        self.question = QUESTION.unpack(payload)[1]
                    else:
                        self.written.append(INTEGERS.unpack_from(payload)[1:])
            question = float(self.question)
            self.due()
            values = [float(self.sent), *[0.0] * (len(OUTPUTS) + 3 * 5 - 1)]
            values[ECHOED] = question
            payload = struct.pack(f">B{len(values)}d", self.number, *values)
            wire.sendall(encode(Kind.DATA, payload) + self._besides)
            self.sent += 1


@contextlib.contextmanager
def link_to(controller: Controller, check: Callable[[], None] = lambda: None) -> Iterator[UrLink]:
    with Server(controller.serve) as server:
        link = UrLink("127.0.0.1", server.port, RATE_HZ, check)
        try:
            yield link
        finally:
            link.close()


def test_a_state_that_was_in_transit_is_no_fresh_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """States that left before the question came do not have its number, however many they are."""
    monkeypatch.setattr(ur_link.UrLink, "IDLE_S", 1e3)
    controller, paced = Controller(), threading.Event()
    controller.due = lambda: paced.wait(0.002)
    with link_to(controller) as link:
        link.fresh()
        controller.takes = False
        asked, states = threading.Event(), list[float]()

        def ask() -> None:
            asked.set()
            states.append(link.fresh().timestamp_s)

        asking = threading.Thread(target=ask)
        asking.start()
        asked.wait()
        sent = controller.sent
        until(lambda: controller.sent > sent + 20)
        assert not states
        late, controller.takes = controller.sent, True
        asking.join()
        assert states[0] >= late


def test_a_controller_that_takes_no_question_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    time = wire_time(monkeypatch, supervision)
    controller, paced = Controller(), threading.Event()
    controller.due = lambda: paced.wait(0.002)
    with link_to(controller) as link:
        controller.takes = False
        time.silence(0.05)
        assert refusal(link.fresh).code == "HC-B02"


def test_no_later_write_takes_the_end_of_the_script_back() -> None:
    controller = Controller()
    with link_to(controller) as link:
        link.write(Order(4, np.zeros(6), 0.1))
        link.end_script(815)
        link.write(Order(5, np.zeros(6), 0.1))
        link.fresh()
    assert [stop for *_, stop in controller.written] == [0, 815, 815]


def test_the_end_of_the_script_gives_no_sign_of_life() -> None:
    controller = Controller()
    with link_to(controller) as link:
        link.write(Order(4, np.zeros(6), 0.1))
        for _ in range(3):
            link.end_script(815)
        link.fresh()
    assert controller.written == [(4, 1, 1, 0), *[(4, 1, 1, 815)] * 3]


def test_states_that_are_not_read_block_no_controller(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ur_link.UrLink, "IDLE_S", 1e-4)
    controller = Controller(besides=16 * encode(Kind.TEXT, bytes(4000)))
    with link_to(controller) as link:
        until(lambda: controller.sent > 300)
        assert link.next().timestamp_s > 0.0


def test_a_failure_between_two_reads_is_not_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ur_link.UrLink, "IDLE_S", 0.01)
    controller, paced = Controller(), threading.Event()
    controller.due = lambda: paced.wait(0.002)
    with link_to(controller) as link:
        link.next()
        controller.number = 2  # of another recipe
        sent = controller.sent
        until(lambda: controller.sent > sent + 50)
        controller.number = 1
        for _ in range(2):
            assert refusal(link.fresh).code == "HC-B26"


@pytest.mark.parametrize(
    ("name", "kind"), [("actual_q", "DOUBLE"), ("timestamp", "VECTOR6D"), ("timestamp", "STRING")]
)
def test_a_field_of_another_type_is_refused(name: str, kind: str) -> None:
    types = [kind if each == name else usual for each, usual in zip(OUTPUTS, TYPES, strict=True)]
    with pytest.raises(DeviceRefused, match=name) as found, link_to(Controller(types)):
        pass
    assert found.value.code == "HC-B69"


@pytest.mark.parametrize(
    ("wrong", "found"),
    [
        ("000356", "an answer of 0 bytes, expected 1"),
        ("0005560101", "an answer of 2 bytes, expected 1"),
        ("000353", "an answer of 0 bytes, expected 1"),
        ("0005530101", "an answer of 2 bytes, expected 1"),
        ("000376", "a controller version of 0 bytes, expected 16"),
        ("001276" + "00000005" * 3 + "000000", "a controller version of 15 bytes, expected 16"),
        ("001476" + "00000005" * 4 + "00", "a controller version of 17 bytes, expected 16"),
    ],
)
def test_an_answer_of_impossible_length_is_that_of_no_controller(wrong: str, found: str) -> None:
    """To VERSION, START and the question for the controller's version."""
    controller = Controller(wrong=bytes.fromhex(wrong))
    with pytest.raises(DeviceError, match=found) as caught, link_to(controller):
        pass
    assert caught.value.code == "HC-B02"


def test_an_answer_that_has_come_already_is_read_before_the_wire_is() -> None:
    asked = list[int]()

    def serve(wire: socket.socket) -> None:
        wire.sendall(encode(Kind.VERSION, b"\1") + encode(Kind.CONTROLLER_VERSION, bytes(16)))
        wire.shutdown(socket.SHUT_WR)
        packages = Packages()
        while data := wire.recv(65536):
            asked.extend(kind for kind, _ in packages.feed(data))

    with Server(serve) as server, pytest.raises(DeviceError, match="closed the connection"):
        UrLink("127.0.0.1", server.port, RATE_HZ, lambda: None)
    assert asked == [Kind.VERSION, Kind.CONTROLLER_VERSION, Kind.OUTPUTS]
