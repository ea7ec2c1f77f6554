"""A controller of Universal Robots before its first run: settings, abilities and address."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from drivers.device_errors import ProtocolError
from drivers.universal_robots.first_contact import settings_of, sub_packages
from drivers.universal_robots.robot_rtde import UrRtdeRobot
from fakes.universal_robots.server import UrServer
from hilcell.cell.file import load_cell
from hilcell.clock import WallClock
from hilcell.ports import Discovers, Inspects, StatesSettings
from tests.drivers.peers import refusal
from tests.drivers.universal_robots.test_robot_rtde import MODEL, OLD, panel
from tests.fakes.conftest import simulated_site

LIMITS_DEG = [(-180.0, 190.0), (-200.0, 10.0), (-160.0, 160.0)] + [(-360.0, 360.0)] * 3
ENTRIES = {
    "simulation.sizes.controller.tool_off_mm": "[1.0, 0.0, -20.0]",
    "simulation.sizes.controller.limits_deg": str([list(each) for each in LIMITS_DEG]),
}
LAB = load_cell("lab")


@pytest.fixture
def server() -> Iterator[UrServer]:
    site, _ = simulated_site(load_cell("lab", ENTRIES))
    with contextlib.closing(UrServer(site)) as server:
        server.start()
        yield server


def robot_at(address: dict[str, Any]) -> UrRtdeRobot:
    robot = LAB.robot
    options = UrRtdeRobot.Options(smr_mm=robot.smr_mm, joint=robot.joint, **address)
    return UrRtdeRobot(options, WallClock(threading.Event()))


def test_settings_are_stated_where_a_run_is_refused(server: UrServer) -> None:
    robot = robot_at(server.address)
    states: StatesSettings = robot
    found = states.settings()
    assert found.serial is not None
    assert "SIMULATED" in str(found.model)
    assert found.joint_limits_rad is not None
    assert found.tool is not None
    np.testing.assert_allclose(np.degrees(found.joint_limits_rad), LIMITS_DEG)
    np.testing.assert_allclose(found.tool[:3, 3], np.array(LAB.robot.smr_mm) + [1.0, 0.0, -20.0])
    np.testing.assert_allclose(found.tool[:3, :3], np.eye(3), atol=1e-12)
    assert refusal(robot.connect).code == "HC-B06"


def test_an_inspection_is_a_table_and_writes_no_register(server: UrServer) -> None:
    inspects: Inspects = robot_at(server.address)
    before = dict(server.controller.inputs)
    rows = {each.feature: each for each in inspects.inspect()}
    assert {each.state for each in rows.values()} == {"has"}
    assert {"get robot model", "joint limits", "actual_q", "input_int_register_28"} <= set(rows)
    with server.writer:
        rows = {each.feature: each for each in inspects.inspect()}
    assert rows["input_int_register_24"].state == "read only"
    assert rows["actual_q"].state == "has"
    assert server.controller.inputs == before


def test_a_host_is_a_candidate_by_its_dashboard(server: UrServer) -> None:
    kind: type[Discovers] = UrRtdeRobot
    (found,) = kind.discover(server.address)
    (identity,) = found.identities
    assert found.options == server.address | {"model": identity.model, "serial": identity.serial}
    assert kind.discover({}) == []


def test_a_panel_that_is_old_or_absent_is_described(server: UrServer) -> None:
    """PolyScope 5.4 has no such questions, PolyScope X no dashboard server."""
    with panel(OLD | MODEL) as port:
        (old,) = UrRtdeRobot.discover({"host": "127.0.0.1", "dashboard_port": port})
    with socket.create_server(("127.0.0.1", 0)) as listener:
        closed = listener.getsockname()[1]
    (other,) = UrRtdeRobot.discover(server.address | {"dashboard_port": closed})
    assert old.identities == other.identities == []
    assert {"3.12", "5.6"} <= set(old.title.replace(",", "").split())
    assert "PolyScope X" in other.title
    nowhere = {"host": "127.0.0.1", "dashboard_port": closed, "rtde_port": closed}
    assert UrRtdeRobot.discover(nowhere) == []


def test_states_of_the_secondary_client() -> None:
    """Sizes of the maker's page: Cartesian Info 101 bytes, Configuration Data 445."""
    limits = struct.pack(">12d", *[-1.0, 2.0] * 6)
    cartesian = struct.pack(">iB12d", 101, 4, *[9.0] * 6, 0.1, 0.0, 0.2, 0.0, 0.0, np.pi)
    configuration = struct.pack(">iB", 445, 6) + limits + bytes(344)
    limits_rad, tool = settings_of(sub_packages(cartesian + configuration))
    assert limits_rad is not None
    assert tool is not None
    assert limits_rad.tolist() == [[-1.0, 2.0]] * 6
    np.testing.assert_allclose(
        tool[:3], [[-1, 0, 0, 100], [0, -1, 0, 0], [0, 0, 1, 200]], atol=1e-12
    )
    assert settings_of(sub_packages(b"")) == (None, None)
    assert settings_of(sub_packages(cartesian[:5].replace(b"e", b"\x05"))) == (None, None)
    with pytest.raises(ProtocolError):
        settings_of({6: struct.pack(">12d", *[float("nan")] * 12)})
    for wrong in (cartesian[:-1], struct.pack(">iB", 0, 4), b"\0\0"):
        with pytest.raises(ProtocolError):
            sub_packages(wrong)
