"""A controller of KUKA before its first run: its settings, abilities and address, by both wires."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest

from hilcell.geometry.frames import from_zyx
from hilcell.ports import Discovers, Inspects, StatesSettings
from tests.drivers.kuka.eki_peer import EkiPeer
from tests.drivers.kuka.kuka_bed import BedRobot as C3Robot
from tests.drivers.kuka.kuka_peer import KukaPeer
from tests.drivers.kuka.test_robot_eki import BedRobot as EkiRobot
from tests.drivers.peers import Bed, Server, WireTime, refusal

LIMITS_DEG = [(-185.0, 185.0), (-140.0, -5.0), (-120.0, 155.0)] + [(-350.0, 350.0)] * 3
ENDS = {
    f"${end}_END[{axis}]": str(limits[side])
    for axis, limits in enumerate([*LIMITS_DEG, (-20.5, 3020.0)], start=1)
    for side, end in enumerate(("SOFTN", "SOFTP"))
}
AnyBed = Bed[Any, Any]
TURNED = "{FRAME: X 98.5, Y -1.0, Z 147.0, A 90.0, B 0.0, C 10.0}"


@pytest.fixture(params=["c3", "eki"])
def bed(time: WireTime, request: pytest.FixtureRequest) -> Iterator[AnyBed]:
    peer, robot = (KukaPeer, C3Robot) if request.param == "c3" else (EkiPeer, EkiRobot)
    with peer(**ENDS) as controller, closing(Bed(controller, time, robot)) as bed:
        yield bed


def test_a_controller_states_its_settings_before_it_is_fit_to_run(
    bed: AnyBed,
) -> None:
    """A wrong tool and an E-stop refuse a run, not this; nothing is written."""
    bed.peer.variables |= {"$TOOL": TURNED, "$ALARM_STOP": "FALSE", "$EX_AX_NUM": "1"}
    robot = bed.make()
    states: StatesSettings = robot
    found = states.settings()
    assert (found.model, found.serial) == ("#KR210R2700_2 C4 FLR", "472911")
    assert found.axis_limits_mm == (-20.5, 3020.0)
    assert found.joint_limits_rad is not None
    np.testing.assert_allclose(np.degrees(found.joint_limits_rad), LIMITS_DEG)
    assert found.tool is not None
    np.testing.assert_allclose(found.tool[:3, 3], [98.5, -1.0, 147.0])
    np.testing.assert_allclose(found.tool[:3, :3], from_zyx((90.0, 0.0, 10.0)))
    assert not [each for each in bed.peer.requests if each.startswith("write")]
    refusal(robot.read)  # not connected


def test_a_connected_robot_states_its_settings_without_a_slide(
    bed: AnyBed,
) -> None:
    robot = bed.connect()
    assert robot.settings().axis_limits_mm is None
    assert robot.read().still


@pytest.mark.parametrize(
    ("lacks", "state", "note"),
    [
        ("", "has", "#EX"),
        ("HC_VER", "has not", "version 3, expected 4"),
        ("$AXIS_ACT_MEAS", "has", "0.0"),
    ],
)
def test_an_inspection_is_a_table_and_writes_nothing(
    bed: AnyBed, lacks: str, state: str, note: str
) -> None:
    bed.peer.measures = True
    if lacks == "HC_VER":
        bed.peer.variables["HC_VER"] = "3"
    inspects: Inspects = bed.make()
    rows = {each.feature: each for each in inspects.inspect()}
    found = rows[lacks or "$MODE_OP"]
    assert found.state == state
    assert note in found.note
    others = {each.state for name, each in rows.items() if name not in (lacks, *OPTIONAL)}
    assert others == {"has"}
    assert not [each for each in bed.peer.requests if each.startswith("write")]


OPTIONAL = ("$AXIS_JUS[7]", "TOOL_DATA[1]", "$TIMER[10]")


def test_a_controller_without_the_program_lacks_it(time: WireTime) -> None:
    with KukaPeer() as peer, closing(Bed(peer, time, C3Robot)) as bed:
        for name in [each for each in peer.variables if each.startswith("HC_")]:
            del peer.variables[name]
        rows = bed.make().inspect()
        mandatory = [each for each in rows if each.needed == "mandatory"]
        lacking = {each.feature for each in mandatory if each.state == "has not"}
    assert {"HC_VER", "HC_STOP", "HC_TGT"} <= lacking
    assert not lacking & {"$MODE_OP", "$AXIS_ACT", "$TOOL"}
    assert all("hilcell.src" in each.note for each in rows if each.feature == "HC_VER")


def test_a_host_that_answers_is_a_candidate(bed: AnyBed) -> None:
    kind, port = type(bed.make()), bed.peer.server.port
    assert issubclass(kind, Discovers)
    (found,) = kind.discover({"host": "127.0.0.1", "port": port})
    expected = {"host": "127.0.0.1", "port": port, "serial": 472911}
    assert found.options == expected | {"model": "#KR210R2700_2 C4 FLR"}
    assert found.identities[0].serial == "472911"
    assert f"127.0.0.1:{port}" in found.title
    assert kind.discover({}) == []


def test_no_candidate_where_nothing_listens_and_a_word_where_another_does(
    bed: AnyBed,
) -> None:
    kind = type(bed.make())
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    assert kind.discover({"host": "127.0.0.1", "port": port}) == []
    with Server(lambda wire: wire.sendall(b"220 mail\r\n</RobotState>" * 9)) as other:
        (found,) = kind.discover({"host": "127.0.0.1", "port": other.port})
    assert found.identities == []
    assert "does not answer" in found.title
