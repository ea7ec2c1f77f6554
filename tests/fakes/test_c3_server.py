from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
import py_openshowvar
import pytest

from fakes.kuka.c3_server import C3Server
from hilcell.cell.file import Cell, load_cell
from tests.fakes.conftest import Served, served
from tests.fakes.rail_bench import until
from tests.fakes.wires import C3Client, connected, exactly, quiet

NEAR = [5.0, -85.0, 95.0, 0.0, -30.0, 10.0]
FAR = [-60.0, -60.0, 60.0, 30.0, -60.0, 90.0]


Robot = Served[C3Server, C3Client]


@pytest.fixture
def robot(cell: Cell) -> Iterator[Robot]:
    with served(C3Server, C3Client, cell) as robot:
        yield robot


def numbers(text: str) -> list[float]:
    return [float(found) for found in re.findall(r"[A-Z]\d? (-?[\d.]+)", text)]


@pytest.mark.parametrize(
    ("request_hex", "reply_hex"),
    [
        ("0100000e00000b24414343555f5354415445", "0100001000000a234348415247455f4f4b000101"),
        ("0100000e010007244f565f50524f00023335", "010000080100023335000101"),
        ("0002000b000008244d4f44455f4f50", "00020009000003234558000101"),
    ],
)
def test_golden_bytes(robot: Robot, request_hex: str, reply_hex: str) -> None:
    robot.client.wire.sendall(bytes.fromhex(request_hex))
    reply = exactly(robot.client.wire, len(reply_hex) // 2)
    assert reply.hex() == reply_hex


def test_position_request_of_the_page(robot: Robot) -> None:
    robot.client.wire.sendall(bytes.fromhex("0001000b00000824504f535f414354"))
    head = exactly(robot.client.wire, 7)
    assert head[:2] == b"\x00\x01"
    text = exactly(robot.client.wire, int.from_bytes(head[5:7], "big")).decode()
    assert re.match(r"\{E6POS: X [-\d.]+, Y [-\d.]+, Z [-\d.]+, A [-\d.]+, B [-\d.]+, C ", text)
    assert numbers(text)[:3] == pytest.approx([1895.18069, 0.0, 1996.12951], abs=1.1e-3)
    assert numbers(text)[3:5] == pytest.approx([0.0, 60.0], abs=1.2e-4)
    assert exactly(robot.client.wire, 3) == b"\x00\x01\x01"


def test_a_controller_has_its_own_tool_limits_and_program() -> None:
    """What was entered at the controller is not what the cell file has: its pose follows."""
    limits = "[[-185, 185], [-140, -5], [-120, 155], [-350, 350], [-122, 122], [-350, 350]]"
    entries = {
        "tool_off_mm": "[0.0, 0.0, 20.0]",
        "limits_deg": limits,
        "slide_limits_mm": "[-20.0, 3020.0]",
        "program": "3",
    }
    settings = {f"simulation.sizes.controller.{key}": text for key, text in entries.items()}
    places = {}
    for cell in (load_cell("paper"), load_cell("paper", settings)):
        with served(C3Server, C3Client, cell) as robot:
            read = robot.client.read
            places[read("HC_VER")] = np.array(numbers(read("$POS_ACT"))[:3])
            tool, ends = read("$TOOL"), (read("$SOFTN_END[2]"), read("$SOFTP_END[7]"))
            assert tool == read("TOOL_DATA[1]")
            robot.client.write("$TIMER[10]", "-1500")
            assert int(read("$TIMER[10]")) >= -1500
    assert numbers(tool) == [98.0, 0.0, 147.0, 0.0, 0.0, 0.0]
    assert ends == ("-140.00000", "3020.00000")
    assert np.linalg.norm(places["3"] - places["4"]) == pytest.approx(20.0, abs=0.01)


def test_split_and_glued_requests(robot: Robot) -> None:
    ask = bytes.fromhex("0002000b000008244d4f44455f4f50")
    for byte in ask:
        robot.client.wire.sendall(bytes([byte]))
    assert exactly(robot.client.wire, 13).hex() == "00020009000003234558000101"
    robot.client.wire.sendall(ask * 5)
    assert exactly(robot.client.wire, 65) == bytes.fromhex("00020009000003234558000101") * 5


def test_independent_client_reads_and_writes(robot: Robot) -> None:
    peer = py_openshowvar.openshowvar("127.0.0.1", robot.server.port)
    try:
        assert peer.read("$MODE_OP", debug=False) == b"#EX"
        assert peer.write("$OV_PRO", "42", debug=False) == b"42"
        assert peer.read("$OV_PRO", debug=False) == b"42"
        assert peer.read("$NO_SUCH", debug=False) is None
    finally:
        peer.close()


def test_a_real_written_to_the_override_reads_as_an_int(robot: Robot) -> None:
    for text in ("35.0", "3.5E1", " 35.4 "):
        robot.client.write("$OV_PRO", text)
        assert robot.client.read("$OV_PRO") == "35"


def test_a_fault_leaves_the_exchange_as_it_is(robot: Robot) -> None:
    before = robot.client.read("$AXIS_ACT")
    robot.faults.set("robot.stale_position", count=0)
    robot.client.go(1, NEAR)
    assert robot.client.read("$AXIS_ACT") == before
    robot.faults.set("robot.split_reply")
    assert robot.client.read("$MODE_OP") == "#EX"


def test_unknown_variables_and_bad_values_fail(robot: Robot) -> None:
    assert robot.client.request(0, "$NO_SUCH")[1] == b"\x00\x01\x00"
    for name, text in (
        *(("HC_TGT", text) for text in ("{A1 nan}", "{A1 inf}", "{A1 1,5}", "{E6POS: A1 1}", "{}")),
        ("HC_VEL", "fast"),
        ("$MODE_OP", "#T1"),
        ("$OV_PRO", "101"),
        ("$OV_PRO", "1e400"),
        ("$OV_PRO", "nan"),
    ):
        assert robot.client.request(1, name, text)[1] == b"\x00\x01\x00"


def test_motion_by_handshake(robot: Robot) -> None:
    assert robot.client.read("HC_VER") == "4"
    assert robot.client.go(1, NEAR) >= 2  # it takes a few polls
    assert robot.client.read("HC_ERR") == "0"
    assert numbers(robot.client.read("$AXIS_ACT"))[:6] == pytest.approx(NEAR, abs=1.2e-4)
    x, y = numbers(robot.client.read("$POS_ACT"))[:2]
    assert np.degrees(np.arctan2(-y, x)) == pytest.approx(5.0, abs=1.0)  # A1 turns clockwise
    assert robot.truth.time.now_s() > 0.2


def looks(robot: Robot, count: int = 6) -> list[list[float]]:
    return [
        numbers(robot.client.read(which))[:6]
        for _ in range(count)
        for which in ("$AXIS_ACT", "$POS_ACT")
    ]


def test_a_robot_at_rest_flickers_in_its_last_digits(robot: Robot) -> None:
    robot.client.go(1, NEAR)
    found = looks(robot)
    axes, poses = np.array(found[::2]), np.array(found[1::2])
    assert np.all(np.abs(axes - NEAR) <= 1.1e-4)
    assert np.all(np.ptp(axes, axis=0) > 1e-5)
    assert np.all(np.ptp(poses, axis=0) < [2.1e-3] * 3 + [2.2e-4] * 3)
    assert np.all(np.ptp(poses[:, :3], axis=0) > 1e-4)


def test_the_flicker_is_the_same_however_often_was_asked_before(robot: Robot) -> None:
    robot.client.go(1, NEAR)
    first = looks(robot)
    for _ in range(5):
        robot.client.read("$POS_ACT")
    robot.client.read("HC_ACK")
    assert looks(robot) == first
    robot.client.go(2, FAR)
    robot.client.go(3, NEAR)
    assert looks(robot) != first  # it has landed otherwise


def test_stopping_takes_a_connection_of_its_own(robot: Robot) -> None:
    robot.client.start(1, FAR)
    robot.client.read("$AXIS_ACT")
    with connected(robot.server.port) as wire:
        C3Client(wire).write("HC_STOP", "TRUE")
    robot.truth.time.advance(5.0)
    stopped = robot.client.read("$AXIS_ACT")
    assert robot.client.read("HC_ERR") == "9"
    assert robot.client.read("HC_ACK") == "0"
    robot.truth.time.advance(5.0)
    assert robot.client.read("$AXIS_ACT") == stopped
    assert numbers(stopped)[0] > FAR[0] + 1
    robot.client.write("HC_STOP", "FALSE")
    assert robot.client.read("HC_ACK") == "1"
    robot.client.go(2, NEAR)
    assert robot.client.read("HC_ERR") == "0"


def test_commands_sent_while_stopped_are_not_carried_out(robot: Robot) -> None:
    robot.client.write("HC_STOP", "TRUE")
    robot.client.start(1, FAR)
    before = robot.client.read("$AXIS_ACT")
    robot.client.write("HC_STOP", "FALSE")
    assert robot.client.read("HC_ACK") == "1"
    assert robot.client.read("HC_ERR") == "9"
    assert robot.client.read("$AXIS_ACT") == before


def test_limits_and_unknown_commands_show_in_hc_err(robot: Robot) -> None:
    robot.client.go(1, [0.0, 0.0, 90.0, 0.0, 0.0, 0.0])
    assert robot.client.read("HC_ERR") == "2"
    robot.client.write("HC_CMD", "7")
    robot.client.write("HC_SEQ", "2")
    assert robot.client.read("HC_ACK") == "2"
    assert robot.client.read("HC_ERR") == "1"


@pytest.mark.parametrize("fault", ["robot.ack_previous", "robot.frozen"])
def test_a_restored_program_keeps_nothing_of_a_fault(robot: Robot, fault: str) -> None:
    robot.faults.set(fault)
    robot.client.start(1, FAR)
    robot.client.read("HC_ACK")
    robot.server.controller.restore()
    robot.faults.set("robot.softlimit")
    robot.client.go(2, NEAR)
    assert robot.client.read("HC_ERR") == "2"


@pytest.mark.parametrize(("fault", "value"), [("late_reply", 3600.0), ("half_open", True)])
def test_while_one_connection_gets_no_answer_others_do(
    robot: Robot, fault: str, value: float
) -> None:
    robot.faults.set(f"robot.{fault}", value)
    robot.client.send(0, "$MODE_OP")
    until(lambda: not robot.faults.any_armed)
    with connected(robot.server.port) as wire:
        assert C3Client(wire).read("$MODE_OP") == "#EX"
    assert quiet(robot.client.wire)


def test_idle_clients_are_closed(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(C3Server, "IDLE_S", 0.05)
    with connected(robot.server.port) as wire, pytest.raises(EOFError):
        exactly(wire, 1)


def test_unknown_types_are_not_answered(robot: Robot) -> None:
    robot.client.wire.sendall(bytes.fromhex("000900040500012a"))
    assert robot.client.read("$MODE_OP") == "#EX"  # the first reply is this one's


def test_what_became_due_is_done_before_an_answer(robot: Robot) -> None:
    done: list[str] = []
    robot.truth.time.follow(lambda: done.append("a sample"))
    assert robot.client.read("$MODE_OP") == "#EX"
    assert done == ["a sample"]
