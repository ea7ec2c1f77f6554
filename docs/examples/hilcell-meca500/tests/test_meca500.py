"""The driver against the simulated controller over the wire; programs. The kit judges the rest."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hilcell_meca500 import wire
from hilcell_meca500.simulated import MecaServer, serve

from fakes.faults import Faults
from fakes.site import Site
from fakes.time import CellTime
from fakes.truth.cell_truth import CellTruth
from hilcell.calibration.tool_point import tip_of_program
from hilcell.cell.devices import driver_options
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.clock import WallClock
from hilcell.compensation.programs import Places, StationProgram, load_program, program_writer
from hilcell.compensation.targets import Stamp
from hilcell.geometry.kinematics import forward
from hilcell.ports import DeviceError, Robot

CELL = load_cell("paper", {"robot.driver": "meca500"})
SAFE_RAD = np.radians(CELL.robot.safe_deg)
PROGRAM = """// holes of panel 7
SetWrf(0, 0, 0, 0, 0, 0)
SetTrf(98, 0, 127, 0, 0, 0)
SetBlending(0)
MovePose(1730.0, 400.0, 900.0, 0, 75, 0)   // above
MoveLin(1780.0, 400.00001, 900, 10, 75, -20)
Delay(0.5) /* MoveLin(1, 2, 3, 4, 5, 6) */
"""


@pytest.fixture
def faults() -> Faults:
    return Faults()


@pytest.fixture
def server(faults: Faults) -> Iterator[MecaServer]:
    time = CellTime(10.0)
    found = serve(Site(CELL, CellTruth(CELL, 1, time, faults), faults, time), 0)
    with contextlib.closing(found):
        found.start()
        yield found


def robot_at(server: MecaServer, **changed: object) -> Robot:
    kind, options = driver_options(CELL, "robot", server.address)
    built: Robot = kind(msgspec.structs.replace(options, **changed), WallClock(threading.Event()))
    return built


@pytest.fixture
def robot(server: MecaServer) -> Iterator[Robot]:
    with contextlib.closing(robot_at(server)) as found:
        yield found


def test_the_pose_is_that_of_the_reflector(robot: Robot) -> None:
    (identity,) = robot.connect()
    assert (identity.model, identity.maker) == ("Meca500 SIMULATED", "Mecademic")
    reading = robot.move_to(SAFE_RAD, 100.0)
    assert reading.still
    np.testing.assert_allclose(reading.pose, forward(CELL.robot.arm(), SAFE_RAD), atol=0.02)


@pytest.mark.parametrize(
    ("state", "value", "code"),
    [
        ("activated", False, "HC-B13"),
        ("homed", False, "MX-B01"),
        ("simulates", True, "MX-B02"),
        ("error", True, "MX-B03"),
    ],
)
def test_a_robot_that_is_not_ready_is_refused(
    server: MecaServer, robot: Robot, state: str, value: bool, code: str
) -> None:
    setattr(server.controller, state, value)
    with pytest.raises(DeviceError) as caught:
        robot.connect()
    assert caught.value.code == code
    server.restore()
    robot.connect()


@pytest.mark.parametrize(
    ("fault", "value", "code"),
    [
        ("robot.e_stop", True, "HC-B10"),
        ("robot.softlimit", True, "HC-B20"),
        ("robot.stops_short", 0.1, "HC-B24"),
        ("robot.vanish", True, "HC-B02"),
    ],
)
def test_a_motion_that_fails_raises_its_alarm(
    robot: Robot, faults: Faults, fault: str, value: float, code: str
) -> None:
    robot.connect()
    faults.set(fault, value)
    with pytest.raises(DeviceError) as caught:
        robot.move_to(SAFE_RAD, 10.0)
    assert caught.value.code == code


def test_a_robot_that_somebody_else_controls_is_left_alone(
    server: MecaServer, robot: Robot
) -> None:
    robot.connect()
    with contextlib.closing(robot_at(server)) as other, pytest.raises(DeviceError) as caught:
        other.connect()
    assert caught.value.code == "MX-B04"
    robot.read()


def test_the_simulated_controller_answers_as_the_manual_says(server: MecaServer) -> None:
    port = server.address["port"]
    assert isinstance(port, int)
    with socket.create_connection(("127.0.0.1", port)) as link, link.makefile("rb") as answers:
        link.sendall(b"SyncCmdQueue(123)\0GetStatusRobot()\0getfwversion\0Nonsense()\0")
        found = b""
        while found.count(b"\0") < 5:
            found += answers.read(1)
    greeting, *rest = found.decode().rstrip("\0").split("\0")
    assert greeting.startswith("[3000]")
    assert rest[:3] == ["[2097][123]", "[2007][1,1,0,0,0,1,1]", "[2081][v11.3.4]"]
    assert rest[3].startswith("[1001]")


def test_a_late_answer_is_not_the_next_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wire, "ANSWER_S", 0.1)  # of silence: the peer answers the second question
    with socket.create_server(("127.0.0.1", 0)) as server:
        asking = threading.Thread(target=_answer_late, args=(server,))
        asking.start()
        line = wire.Wire("127.0.0.1", server.getsockname()[1], lambda: None)
        with contextlib.closing(line):
            with pytest.raises(DeviceError):
                line.ask("GetRobotSerial()", 2083)
            monkeypatch.setattr(wire, "ANSWER_S", 600.0)
            assert line.ask("GetRobotSerial()", 2083) == "second"
        asking.join()


def _answer_late(server: socket.socket) -> None:
    """Answer the first question together with the second one."""
    with server.accept()[0] as client:
        client.sendall(b"[3000][Connected]\0")
        received = b""
        while received.count(b"GetRobotSerial") < 2:
            received += client.recv(4096)
        numbers = [b"[2097][%d]\0[2083][%s]\0" % each for each in ((1, b"first"), (2, b"second"))]
        client.sendall(b"".join(numbers))
        client.recv(1)


def test_only_the_targets_of_a_program_change(tmp_path: Path) -> None:
    source = tmp_path / "panel.MXPROG"
    source.write_text(PROGRAM)
    program = load_program(source)
    assert program is not None
    values = program.values()
    np.testing.assert_allclose(values[0], [1730, 400, 900, 0, 75, 0], atol=1e-9)
    (text,) = program.with_positions(values, "stamp").values()
    found = text.decode().splitlines()
    assert found[0] == "// stamp"
    assert found[1:5] == PROGRAM.splitlines()[:4]
    assert found[5] == "MovePose(1730.0000, 400.0000, 900.0000, 0.0000, 75.0000, 0.0000)   // above"
    assert found[6] == "MoveLin(1780.0000, 400.00001, 900.0000, 10.0000, 75.0000, -20.0000)"
    assert program.tool is not None
    assert program.tool.where == "panel.MXPROG line 3"
    assert tip_of_program(CELL, "", program.tool, None, source.name).name == "reflector"
    (tmp_path / "other.mxprog").write_text(PROGRAM.replace("98", "97"))
    other = load_program(tmp_path / "other.mxprog")
    assert other is not None
    assert other.tool is not None
    with pytest.raises(SettingsError, match="line 3"):
        tip_of_program(CELL, "", other.tool, None, source.name)


@pytest.mark.parametrize(
    "line",
    [
        "MoveLinRelTrf(0, 0, 5, 0, 0, 0)",
        "MoveJoints(0, 0, 0, 0, 0, 0)",
        "SetBlending(100)",
        "SetWrf(0, 0, 0, 0, 0, 0)",
        "SetTrf(1, 2, 3, 4, 5, 6)",
        "MoveLin(1, 2, 3)",
        "MoveLin(1, 2, 3, 4, 5, x)",
        "}",
    ],
)
def test_a_program_that_cannot_be_corrected_is_refused_by_its_line(
    tmp_path: Path, line: str
) -> None:
    source = tmp_path / "panel.mxprog"
    source.write_text(f"{PROGRAM}{line}\n")
    with pytest.raises(SettingsError) as caught:
        load_program(source)
    (problem,) = caught.value.problems
    assert problem.startswith("panel.mxprog line 8: ")
    source.write_text("MoveLin(1, 2, 3, 4, 5, 6)\n")  # the robot blends past this target
    with pytest.raises(SettingsError, match="line 1: MoveLin"):
        load_program(source)


def test_the_program_of_a_station_is_written_in_joints() -> None:
    at = Places(np.zeros((1, 6)), np.radians([[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]]), np.array([6]))
    below = Places(np.zeros((1, 6)), np.zeros((1, 6)), np.array([6]))
    values = [np.array([[x, 0.0, 900.0, 0.0, 75.0, 0.0]]) for x in (1800.0, 1700.0)]
    at, off = (Places(each, at.joints_rad, at.status) for each in values)
    none = Places(np.zeros((0, 6)), np.zeros((0, 6)), np.zeros(0, dtype=int))
    base, tool = np.array([0.0, 0.0, 50.0, 0.0, 0.0, 0.0]), np.zeros(6)
    program = StationProgram(
        "S 1100",
        ["H1"],
        at,
        off,
        below,
        [none, none],
        base,
        tool,
        "reflector",
        None,
        CELL.robot.safe_deg,
        CELL.robot.arm(),
        30.0,
        {},
        ["care"],
    )
    write = program_writer("meca500")
    assert write is not None
    (name,), (data,) = zip(*write(program, Stamp("run", "S 1100", "now")).items(), strict=True)
    assert name == "S_1100.mxprog"
    lines = data.decode().splitlines()
    assert lines[0].startswith("// hilcell: corrected by run")
    joints = lines.index("MoveJoints(1.000000, 2.000000, 3.000000, 4.000000, 5.000000, 6.000000)")
    assert lines[joints + 1] == "MoveLin(1800.0000, 0.0000, 950.0000, 0.0000, 75.0000, 0.0000)"
    assert lines[joints + 3] == "MoveLin(1700.0000, 0.0000, 950.0000, 0.0000, 75.0000, 0.0000)"
