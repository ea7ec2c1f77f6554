"""The bridge's lines, written from the public client's documented forms, not from the driver."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from fakes.faults import Faults
from fakes.t2sa_server import T2saDevice, T2saServer, read_points, target_fan, write
from fakes.time import CellTime
from fakes.truth.cell_truth import CellTruth
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError
from hilcell.geometry.kinematics import Array
from tests.fakes.conftest import simulated_site
from tests.fakes.wires import connected

RESULT = re.compile(
    r"ACK-300 Single Point Measurement A;G;(\S+) result (\S+),(\S+),(\S+) "
    r"01/05/2026 \d\d:\d\d:\d\d AM"
)


@dataclass
class Client:
    write: Callable[[bytes], object]
    readline: Callable[[], bytes]

    def ask(self, line: str) -> str:
        self.write(line.encode() + b"\r\n")
        return self.readline().decode().removesuffix("\r\n")

    def measure(self, name: str) -> Array:
        found = RESULT.fullmatch(self.ask(f"!MEAS_SINGLE_POINT:A;G;{name}"))
        assert found is not None
        assert found[1] == name
        return np.array([float(each) for each in found.groups()[1:]])


@dataclass
class Bridge:
    truth: CellTruth
    faults: Faults
    time: CellTime
    points: dict[str, Array]
    server: T2saServer

    @contextlib.contextmanager
    def client(self) -> Iterator[Client]:
        with connected(int(str(self.server.address["port"]))) as wire, wire.makefile("rb") as file:
            yield Client(wire.sendall, file.readline)


@contextlib.contextmanager
def running(cell: Cell, folder: Path, speed: float = math.inf) -> Iterator[Bridge]:
    site, truth = simulated_site(cell)
    at_mm = truth.tracker.reflectors()
    points = {"NEAR": 0.8 * at_mm["F1"] + [0, 30, 0], "AWAY": -at_mm["F1"], "F2": at_mm["F2"]}
    write(folder / "points.csv", points)
    options = {"points": str(folder / "points.csv"), "collection": "A", "group": "G"}
    tracker = msgspec.structs.replace(cell.tracker, options=options)
    cell = msgspec.structs.replace(cell, tracker=tracker)
    server = T2saServer(replace(site, cell=cell, time=CellTime(speed)))
    with contextlib.closing(server):
        server.start()
        yield Bridge(truth, site.faults, site.time, points, server)


@pytest.fixture
def bridge(cell: Cell, tmp_path: Path) -> Iterator[Bridge]:
    with running(cell, tmp_path) as found:
        yield found


@pytest.fixture
def client(bridge: Bridge) -> Iterator[Client]:
    with bridge.client() as client:
        assert client.ask("!LST:1") == "ACK-300 Tracker Interface Started: True"
        bridge.time.advance(T2saDevice.WARM_UP_S)
        yield client


def test_golden_lines(client: Client, bridge: Bridge) -> None:
    x, y, z = bridge.points["F2"]
    for request, reply in (
        ("?STAT", "ACK-300 Instrument is connected (simulated)"),
        ("?LSTA", "ACK-300 LON"),
        ("!SET_SIM:0", "ACK-300 Set 0"),
        ("!SET_SIM:1", "ERR-337 Failed to set simulation mode."),
        ("SET_POWER_LOCK:1", "ACK-300 READY"),
        ("SET_POWER_LOCK:x", "ERR-200 Command rejected."),
        ("!SET_STATION_LOCK:1", "ACK-300 READY"),
        (
            "!SINGLE_POINT_MEAS_PROFILE:Single Pt. To SA",
            "ACK-300 Single Point Measurement Profile set to Single Pt. To SA",
        ),
        ("!SINGLE_POINT_MEAS_PROFILE:x", "ERR-307 Requested measurement profile does not exist."),
        ("!SET_WORKING_FRAME:x", "ERR-314 Working frame not set, not found."),
        ("!HALT", "ACK-300 READY"),
        ("!LST:9", "ERR-200 Command rejected."),
        ("hello", "ERR-200 Command rejected."),
        ("!MEAS_SINGLE_POINT:A;X;F2", "ERR-306 Did not find or set point group and target name."),
        ("?POINT_POS:A;G;F9", "ERR-306 Did not find or set point group and target name."),
        ("!MEAS_SINGLE_POINT:A;G;AWAY", "ERR-305 Measurement of point failed."),
    ):
        assert client.ask(request) == reply
    found = client.ask("?POINT_POS:A;G;F2")
    assert f"Single Point Measurement A;G;F2 result {x:.6f},{y:.6f},{z:.6f} " in found


def test_the_laser_warms_up(bridge: Bridge) -> None:
    with bridge.client() as client:
        assert client.ask("?LSTA") == "ACK-300 LOFF"
        client.ask("!LST:1")
        assert client.ask("?LSTA") == f"ACK-300 WARM, {T2saDevice.WARM_UP_S:.2f} seconds"
        assert client.ask("!MEAS_SINGLE_POINT:A;G;F2") == "ERR-338 Instrument is not ready."
        bridge.time.advance(T2saDevice.WARM_UP_S)
        client.measure("F2")


def test_a_point_only_sets_the_direction(client: Client, bridge: Bridge) -> None:
    at_mm = bridge.truth.tracker.reflectors()
    np.testing.assert_allclose(client.measure("NEAR"), at_mm["F1"], atol=0.06)
    np.testing.assert_allclose(client.measure("F2"), at_mm["F2"], atol=0.06)
    assert not np.array_equal(client.measure("F2"), client.measure("F2"))
    client.ask("SET_POWER_LOCK:0")  # without the camera it must stand nearly in the beam
    assert client.ask("!MEAS_SINGLE_POINT:A;G;NEAR").startswith("ERR-305")
    client.measure("F2")


def test_a_late_result_and_one_in_pieces(client: Client, bridge: Bridge) -> None:
    bridge.faults.set("tracker.late_result")
    client.write(b"!MEAS_SINGLE_POINT:A;G;F2\r\n?LSTA\r\n")
    assert b"Single Point" in client.readline()
    assert client.readline() == b"ACK-300 LON\r\n"
    bridge.faults.set("tracker.split_packet")
    client.measure("F2")


@pytest.mark.parametrize("own", [True, False])
def test_a_halt_overtakes_a_measurement(cell: Cell, tmp_path: Path, own: bool) -> None:
    slow = 0.01  # a measurement takes a minute
    with (
        running(cell, tmp_path, slow) as bridge,
        bridge.client() as client,
        bridge.client() as other,
    ):
        client.ask("!LST:1")
        bridge.time.advance(T2saDevice.WARM_UP_S)
        client.write(b"!MEAS_SINGLE_POINT:A;G;F2\r\n")
        while not (said := other.ask("?LSTA")).startswith("ERR-201"):
            assert said == "ACK-300 LON"
        client.write(b"?STAT\r\n")
        assert client.readline().startswith(b"ERR-201")
        (client if own else other).write(b"!HALT\r\n")
        assert client.readline().startswith(b"ERR-330")
        assert (client if own else other).readline() == b"ACK-300 READY\r\n"
        assert other.ask("?STAT").startswith("ACK-300")


def test_the_list_of_a_site_is_what_the_bridge_has(cell: Cell, tmp_path: Path) -> None:
    site, _ = simulated_site(cell)
    server = T2saServer(site)
    listed = Path(str(server.address["points"]))
    points = read_points(listed)
    assert len(points) > 1000
    np.testing.assert_allclose(points["H000001"], target_fan(cell)["H000001"], atol=1e-9)
    server.close()
    assert not listed.exists()
    own = tmp_path / "own.csv"
    write(own, {"P1": np.array([1.0, 2.0, 3.0])})
    tracker = msgspec.structs.replace(cell.tracker, options={"points": str(own)})
    site = replace(site, cell=msgspec.structs.replace(cell, tracker=tracker))
    server = T2saServer(site)
    assert "points" not in server.address
    server.close()
    assert own.exists()
    own.write_text("P1,1,two,3\n", "ascii")
    with pytest.raises(SettingsError):
        T2saServer(site)
