"""A simulated controller of Universal Robots against bytes of the page, and against ur-rtde."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from fakes import wires
from fakes.site import Site
from fakes.universal_robots import server as ur_server
from fakes.universal_robots.server import UrServer
from hilcell.cell.file import load_cell
from tests.fakes.conftest import DeviceTime, simulated_site
from tests.fakes.rail_bench import until
from tests.fakes.wires import REGISTERS, RtdeClient, connected, exactly

LAB = load_cell("lab")
HOME = np.radians(LAB.robot.home_deg)
SCRIPT = "def hilcell():\n  write_output_integer_register(26, 77)\n  sync()\nend\n"


@dataclass
class Robot:
    site: Site
    server: UrServer

    def port(self, name: str) -> int:
        port = self.server.address[f"{name}_port"]
        assert isinstance(port, int)
        return port

    def ask(self, *commands: str) -> list[str]:
        with connected(self.port("dashboard")) as wire, wire.makefile("rb") as lines:
            assert lines.readline() == b"Connected: Universal Robots Dashboard Server\n"
            answers = []
            for command in commands:
                wire.sendall(f"{command}\n".encode())
                answers.append(lines.readline().decode().strip())
            return answers


@contextlib.contextmanager
def serving(port: int = 0, speed: float = 50.0) -> Iterator[Robot]:
    site, _ = simulated_site(LAB, speed)
    server = ur_server.serve(site, port)
    with contextlib.closing(server):
        server.start()
        yield Robot(site, server)


@pytest.fixture
def robot() -> Iterator[Robot]:
    with serving() as robot:
        yield robot


def test_golden_bytes(robot: Robot) -> None:
    with connected(robot.port("rtde")) as wire:
        for byte in bytes.fromhex("0005560002"):  # however it is split
            wire.sendall(bytes([byte]))
        assert exactly(wire, 4).hex() == "00045601"


def test_the_program_moves_and_acknowledges(robot: Robot) -> None:
    target = [*(HOME + 0.1)]
    with connected(robot.port("rtde")) as wire, connected(robot.port("script")) as script:
        client = RtdeClient(wire)
        client.begin()
        client.write(4, 1, target)
        # Two ports have no order: the registers come first here.
        until(lambda: robot.server.controller.inputs["input_int_register_24"] == 4)
        assert client.state()[-2] == 0  # no program plays
        script.sendall(SCRIPT[:20].encode())
        script.sendall(SCRIPT[20:].encode())
        while client.state()[-2] != 4:  # an old command is acknowledged, not carried out
            pass
        assert np.abs(np.array(client.state()[2:8]) - HOME).max() < 1e-4
        client.write(5, 2, target)
        while (state := client.state())[-2] != 5:
            pass
        assert state[-1] == 0
        assert np.abs(np.array(state[2:8]) - target).max() < 1e-4


def test_without_a_sign_of_life_a_motion_is_braked(device_time: DeviceTime, robot: Robot) -> None:
    with connected(robot.port("rtde")) as wire, connected(robot.port("script")) as script:
        client = RtdeClient(wire)
        client.begin()
        script.sendall(SCRIPT.encode())
        until(lambda: robot.ask("running") == ["Program running: true"])
        robot.site.faults.set("robot.frozen")
        client.write(1, 1, [*(HOME + 1.0)])
        while (state := client.state())[-2] != 1:
            device_time.at_s += 0.1
        assert state[-1] == 8


def test_one_client_writes_at_a_time(robot: Robot) -> None:
    with connected(robot.port("rtde")) as other:
        client = RtdeClient(other)

        def types() -> set[bytes]:
            return set(client.ask(73, ",".join(REGISTERS).encode())[1:].split(b","))

        with connected(robot.port("rtde")) as wire:
            RtdeClient(wire).begin()
            assert types() == {b"IN_USE"}
        until(lambda: types() == {b"INT32", b"DOUBLE"})  # the first has gone


def test_local_control_takes_no_program(robot: Robot) -> None:
    robot.site.faults.set("robot.mode_t1")
    assert robot.ask("is in remote control", "stop") == ["false", "Failed to execute: stop"]
    with connected(robot.port("script")) as script:
        script.sendall(SCRIPT.encode())
        assert robot.ask("running") == ["Program running: false"]


PEER = """
import json, sys, dashboard_client, rtde_receive
host, port = sys.argv[1], int(sys.argv[2])
names = ["timestamp", "actual_q", "actual_qd", "actual_TCP_pose", "robot_mode", "safety_mode"]
peer = rtde_receive.RTDEReceiveInterface(host, 125.0, [*names, "runtime_state"])
found = {"joints": peer.getActualQ(), "pose": peer.getActualTCPPose()}
found["states"] = [peer.getRobotMode(), peer.getSafetyMode(), peer.getRuntimeState()]
peer.disconnect()
panel = dashboard_client.DashboardClient(host, port)
panel.connect()
found["panel"] = [panel.robotmode(), panel.safetystatus(), panel.isInRemoteControl()]
found["panel"] += [panel.getRobotModel(), panel.getSerialNumber()]
panel.stop()
panel.disconnect()
print(json.dumps(found))
"""


@pytest.mark.skipif(sys.version_info >= (3, 13), reason="ur-rtde has no wheel for it")
@pytest.mark.process
def test_ur_rtde_reads_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The peer knows one port: an address of its own keeps other tests from it."""
    number = os.getpid()
    host = f"127.{number // 65536 % 200 + 1}.{number // 256 % 256}.{number % 256}"
    monkeypatch.setattr(wires, "HOST", host)
    with serving(30004, speed=1.0) as robot:
        words = (sys.executable, "-c", PEER, host, str(robot.port("dashboard")))
        done = subprocess.run(words, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    assert np.abs(np.array(found["joints"]) - HOME).max() < 1e-4
    assert found["states"] == [7, 1, 1]
    assert 0.3 < found["pose"][0] < 1.0
    assert found["panel"] == [
        "Robotmode: RUNNING",
        "Safetystatus: NORMAL",
        True,
        "UR10e SIMULATED",
        "20225500147",
    ]
