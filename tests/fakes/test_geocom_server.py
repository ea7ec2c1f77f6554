"""The total station on a socket and on a pseudo terminal: its lines, and an independent client."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from types import SimpleNamespace

import geocompy.communication
import geocompy.geo
import numpy as np
import pytest
import serial
from geocompy.communication import Connection, open_serial, open_socket
from geocompy.geo import GeoCom
from geocompy.geo.gctypes import GeoComCode

from fakes.faults import Faults
from fakes.leica.geocom_server import GeocomDevice, GeocomServer
from fakes.truth.cell_truth import CellTruth
from hilcell.cell.file import Cell
from hilcell.geometry.kinematics import Array
from tests.fakes.conftest import simulated_site, station_cell
from tests.fakes.wires import connected


@dataclass
class Station:
    truth: CellTruth
    faults: Faults
    channel: str
    write: Callable[[bytes], object]
    readline: Callable[[], bytes]
    number: int = 0

    def ask(self, rpc: int, *parameters: float) -> tuple[int, list[float]]:
        self.number += 1
        self.write(f"%R1Q,{rpc},{self.number}:{','.join(map(str, parameters))}\r\n".encode())
        head, _, rest = self.readline().decode().strip().partition(":")
        assert head == f"%R1P,0,{self.number}"
        code, *values = rest.split(",")
        return int(code), [float(value) for value in values]

    def ready(self) -> None:
        for rpc, *values in ((107, 15), (18005, 1), (2028, 658e-9, 1009.0, 23.0, 23.0)):
            assert self.ask(int(rpc), *values)[0] == 0

    def aim(self, at_mm: Array) -> int:
        """Turn to a place (3,) and aim: Hz turns clockwise seen from above."""
        x, y, z = at_mm
        hz, v = -math.atan2(y, x) % math.tau, math.atan2(math.hypot(x, y), z)
        assert self.ask(9027, hz, v, 0, 0, 0)[0] == 0
        return self.ask(9037, 0.02, 0.02, 0)[0]

    def measure(self) -> tuple[int, list[float]]:
        assert self.ask(2008, 3, 1)[0] == 0
        assert self.ask(2008, 1, 1)[0] == 0
        return self.ask(2108, 5000, 1)

    def at(self, name: str) -> Array:
        return self.truth.tracker.reflectors()[name]


@contextlib.contextmanager
def running(cell: Cell, line: bool, prism_m: float = 0.0) -> Iterator[Station]:
    site, truth = simulated_site(cell)
    of_station = replace(site, cell=station_cell(serial=line, prism_mm=1000 * prism_m))
    server = GeocomServer(of_station)
    with contextlib.closing(server), contextlib.ExitStack() as stack:
        server.start()
        channel = str(server.address["channel"])
        if line:
            port = stack.enter_context(serial.Serial(channel, 115200, timeout=None))
            yield Station(truth, site.faults, channel, port.write, port.readline)
        else:
            wire = stack.enter_context(connected(int(channel.rpartition(":")[2])))
            file = stack.enter_context(wire.makefile("rb"))
            yield Station(truth, site.faults, channel, wire.sendall, file.readline)


@pytest.fixture
def station(cell: Cell) -> Iterator[Station]:
    with running(cell, line=False) as found:
        yield found


@pytest.fixture(params=["socket", "serial"])
def either(cell: Cell, request: pytest.FixtureRequest) -> Iterator[Station]:
    with running(cell, request.param == "serial") as found:
        yield found


def test_golden_lines(either: Station) -> None:
    for request, reply in (
        (b"\n\r\n%R1Q,0,0:\r\n", b"%R1P,0,0:0\r\n"),  # empty lines are not answered
        (b"%R1Q,2008,7:1,1\r\n", b"%R1P,0,7:0\r\n"),
        (b"%R1Q,18005,8:1\r\n", b"%R1P,0,8:0\r\n"),
        (b"%R1Q,9037,9:0.001,0.001,0\r\n", b"%R1P,0,9:8710\r\n"),
        (b"%R1Q,5003,1:\r\n", f"%R1P,0,1:0,{GeocomDevice.SERIAL}\r\n".encode()),
        (b"%R1Q,5004:\r\n", b'%R1P,0,0:0,"TS60 (simulated)"\r\n'),
        (b"%R1Q,4,2:\r\n", b"%R1P,3081,2:0\r\n".replace(b":0", b":5")),
        (b"hello\r\n", b"%R1P,3080,0:0\r\n"),
        (b"c\r\n", b"?\r\n"),
        (b"%R1Q,2024,3:nan\r\n", b"%R1P,0,3:2\r\n"),
        (b"%R1Q,2024,3:\r\n", b"%R1P,0,3:2\r\n"),
    ):
        either.write(request)
        assert either.readline() == reply


def test_few_decimal_places_are_sent_until_more_are_asked_for(station: Station) -> None:
    assert station.ask(108) == (0, [4])
    station.write(b"%R1Q,2029,9:\r\n")
    assert station.readline() == b"%R1P,0,9:0,0.0000,1013.2500,12.0000,12.0000\r\n"


def test_the_last_distance_is_kept_until_it_is_cleared(station: Station) -> None:
    station.ready()
    station.aim(station.at("F1"))
    kept = station.measure()
    station.aim(station.at("F2"))
    assert station.ask(2108, 100, 1) == kept
    assert station.ask(2008, 3, 1)[0] == 0
    code, (_, _, distance_m) = station.ask(2108, 100, 1)
    assert (code, distance_m) == (1285, 0.0)  # angles only


def test_nothing_is_measured_without_a_target(station: Station) -> None:
    station.ready()
    assert station.aim(station.at("F1") + [0.0, 0.0, 400.0]) == 8710
    assert station.measure()[0] == 1285
    assert station.ask(18005, 0)[0] == 0
    assert station.ask(9037, 0.1, 0.1, 0)[0] == 8714


def test_air_and_prism_act_on_the_distance(cell: Cell) -> None:
    with running(cell, line=False, prism_m=0.0344) as station:
        station.ready()
        station.aim(station.at("F1"))
        true_m = float(np.linalg.norm(station.at("F1"))) / 1000
        assert station.measure()[1][2] == pytest.approx(true_m - 0.0344, abs=5e-5)
        assert station.ask(2024, 0.0344)[0] == 0
        assert station.measure()[1][2] == pytest.approx(true_m, abs=5e-5)
        assert station.ask(2028, 658e-9, 709.0, 23.0, 23.0)[0] == 0
        assert station.measure()[1][2] == pytest.approx(true_m * (1 + 80e-6), abs=5e-5)


def test_the_other_face_shows_the_same_place(station: Station) -> None:
    station.ready()
    station.aim(station.at("F1"))
    _, (hz, v, distance_m) = station.measure()
    assert station.ask(9028, 0, 0, 0)[0] == 0
    assert station.ask(2026) == (0, [1])
    _, (other_hz, other_v, other_m) = station.measure()
    assert (hz + math.pi - other_hz) % math.tau == pytest.approx(0, abs=1e-4)
    assert math.tau - v == pytest.approx(other_v, abs=1e-4)
    assert other_m == pytest.approx(distance_m, abs=1e-4)


def test_requests_together_and_an_answer_in_pieces(either: Station) -> None:
    either.ready()
    either.aim(either.at("F1"))
    either.faults.set("tracker.split_packet")
    either.write(b"%R1Q,2008,69:1,1\r\n%R1Q,2108,70:5000,1\r\n")
    assert either.readline() == b"%R1P,0,69:0\r\n"
    assert either.readline().startswith(b"%R1P,0,70:0,")


def test_a_late_result_comes_with_the_next_one(station: Station) -> None:
    station.ready()
    station.aim(station.at("F1"))
    station.faults.set("tracker.late_result")
    station.write(b"%R1Q,2108,70:100,1\r\n%R1Q,0,71:\r\n%R1Q,2108,72:100,1\r\n")
    heads = [station.readline().partition(b":")[0] for _ in range(3)]
    assert heads == [b"%R1P,0,71", b"%R1P,0,70", b"%R1P,0,72"]


def test_a_motion_is_aborted(cell: Cell) -> None:
    server = GeocomServer(simulated_site(cell, 0.01)[0])  # a motion takes minutes
    with contextlib.closing(server):
        server.start()
        port = int(str(server.address["channel"]).rpartition(":")[2])
        with connected(port) as wire, wire.makefile("rb") as lines:
            wire.sendall(b"%R1Q,9027,1:0.0,1.5,0,0,0\r\n")
            wire.sendall(b"c\r\n")
            assert lines.readline() == b"?\r\n"
            assert lines.readline() == b"%R1P,0,1:8\r\n"


@pytest.fixture
def peer(either: Station, monkeypatch: pytest.MonkeyPatch) -> Iterator[GeoCom]:
    monkeypatch.setattr(geocompy.geo, "sleep", lambda _s: None)
    monkeypatch.setattr(geocompy, "communication", SimpleNamespace(sleep=lambda _s: None))
    if "://" in either.channel:
        host, _, port = either.channel.rpartition("/")[2].partition(":")
        wire: Connection = open_socket(host, int(port), "tcp", timeout=600)
    else:
        wire = open_serial(either.channel, speed=115200, timeout=600)
    with contextlib.closing(wire):
        yield GeoCom(wire)


def test_a_measurement_from_first_to_last(peer: GeoCom, either: Station) -> None:
    assert peer.csv.get_serial_number().params == GeocomDevice.SERIAL
    assert peer.csv.get_instrument_name().params == "TS60 (simulated)"
    assert peer.csv.get_firmware_version().params == (8, 50, 0)
    assert peer.com.set_double_precision(15).error == GeoComCode.OK
    peer.precision = 15
    assert peer.aus.switch_user_atr(True).error == GeoComCode.OK
    assert peer.aus.get_user_atr_state().params is True
    assert peer.tmc.set_atmospheric_corrections(1e-6, 1009.0, 23.0, 23.0).error == GeoComCode.OK
    assert peer.tmc.get_atmospheric_corrections().params == (1e-6, 1009.0, 23.0, 23.0)
    assert peer.tmc.set_prism_correction(0.0).error == GeoComCode.OK
    x, y, z = at_mm = either.at("F2")
    hz, v = -math.atan2(y, x) % math.tau, math.atan2(math.hypot(x, y), z)
    assert peer.aut.turn_to(hz, v).error == GeoComCode.OK
    assert peer.aut.fine_adjust(0.01, 0.01).error == GeoComCode.OK
    assert peer.tmc.do_measurement().error == GeoComCode.OK
    found = peer.tmc.get_simple_measurement()
    assert found.params is not None
    hz_found, v_found, distance_m = found.params
    assert float(hz_found) == pytest.approx(hz, abs=3e-5)
    assert float(v_found) == pytest.approx(v, abs=3e-5)
    assert 1000 * distance_m == pytest.approx(float(np.linalg.norm(at_mm)), abs=0.06)
    coordinate = peer.tmc.get_coordinate().params
    assert coordinate is not None
    east, north, height = map(float, coordinate[0])
    np.testing.assert_allclose([1000 * north, -1000 * east, 1000 * height], at_mm, atol=0.06)
    assert peer.tmc.get_face().params is not None
    assert peer.tmc.get_angle_inclination().params is not None


def test_no_target_and_nothing_to_abort(peer: GeoCom) -> None:
    peer.aus.switch_user_atr(True)
    assert peer.aut.fine_adjust(1e-6, 1e-6).error == GeoComCode.AUT_NO_TARGET
    assert peer.abort().error == GeoComCode.OK
    assert peer.com.nullprocess().error == GeoComCode.OK


def test_a_person_turns_the_telescope_to_one_nest_after_another(station: Station) -> None:
    station.ready()
    layout = station.truth.cell.layout
    fixed = {nest.name for nest in layout.fixed_nests}
    nests = {*fixed, "flange", *(nest.name for nest in layout.slide)}
    assert station.aim(station.at("P1")) == 0
    order = []
    for _ in range(2 * len(nests)):
        assert station.ask(6002, 0)[0] == 0
        assert station.ask(9037, 0.02, 0.02, 0)[0] == 8710  # not on the target of before
        while station.ask(9037, 0.02, 0.02, 0)[0] == 8710:
            pass
        hz, v, distance_m = station.measure()[1]
        at_mm = (
            1000
            * distance_m
            * np.array([math.sin(v) * math.cos(hz), -math.sin(v) * math.sin(hz), math.cos(v)])
        )
        off_mm = {name: np.linalg.norm(at_mm - station.at(name)) for name in nests}
        order.append(min(off_mm, key=off_mm.__getitem__))
        assert off_mm[order[-1]] < 5.0
    assert set(order[: len(fixed)]) == fixed
    assert set(order[: len(nests)]) == nests
    assert order[len(nests) :] == order[: len(nests)]
