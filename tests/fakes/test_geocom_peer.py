"""The total station against an independent client of the protocol, over TCP and a serial line."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from types import SimpleNamespace

import geocompy.communication
import geocompy.geo
import numpy as np
import pytest
from geocompy.communication import Connection, open_serial, open_socket
from geocompy.geo import GeoCom
from geocompy.geo.gctypes import GeoComCode

from fakes.faults import Faults
from fakes.leica.geocom_server import GeocomDevice, GeocomServer
from fakes.site import Site
from fakes.time import CellTime
from fakes.truth.cell_truth import CellTruth
from hilcell.cell.file import Cell
from tests.fakes.conftest import station_cell


@pytest.fixture
def truth(cell: Cell) -> CellTruth:
    return CellTruth(cell, 1, CellTime(math.inf), Faults())


@pytest.fixture(params=["socket", "serial"])
def station(
    truth: CellTruth, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Iterator[GeoCom]:
    monkeypatch.setattr(geocompy.geo, "sleep", lambda _s: None)
    monkeypatch.setattr(geocompy, "communication", SimpleNamespace(sleep=lambda _s: None))
    line = request.param == "serial"
    faults = Faults()
    server = GeocomServer(Site(station_cell(serial=line), truth, faults, truth.time))
    with contextlib.closing(server):
        server.start()
        channel = str(server.address["channel"])
        wire: Connection
        if line:
            wire = open_serial(channel, speed=115200, timeout=600)
        else:
            wire = open_socket("127.0.0.1", int(channel.rpartition(":")[2]), "tcp", timeout=600)
        with contextlib.closing(wire):
            yield GeoCom(wire)


def test_a_measurement_from_first_to_last(station: GeoCom, truth: CellTruth) -> None:
    assert station.csv.get_serial_number().params == GeocomDevice.SERIAL
    assert station.csv.get_instrument_name().params == "TS60 (simulated)"
    assert station.csv.get_firmware_version().params == (8, 50, 0)
    assert station.com.set_double_precision(15).error == GeoComCode.OK
    station.precision = 15
    assert station.aus.switch_user_atr(True).error == GeoComCode.OK
    assert station.aus.get_user_atr_state().params is True
    assert station.tmc.set_atmospheric_corrections(1e-6, 1009.0, 23.0, 23.0).error == GeoComCode.OK
    assert station.tmc.get_atmospheric_corrections().params == (1e-6, 1009.0, 23.0, 23.0)
    assert station.tmc.set_prism_correction(0.0).error == GeoComCode.OK
    x, y, z = at_mm = truth.tracker.reflectors()["F2"]
    hz, v = -math.atan2(y, x) % math.tau, math.atan2(math.hypot(x, y), z)
    assert station.aut.turn_to(hz, v).error == GeoComCode.OK
    assert station.aut.fine_adjust(0.01, 0.01).error == GeoComCode.OK
    assert station.tmc.do_measurement().error == GeoComCode.OK
    found = station.tmc.get_simple_measurement()
    assert found.params is not None
    hz_found, v_found, distance_m = found.params
    assert float(hz_found) == pytest.approx(hz, abs=3e-5)
    assert float(v_found) == pytest.approx(v, abs=3e-5)
    assert 1000 * distance_m == pytest.approx(float(np.linalg.norm(at_mm)), abs=0.06)
    coordinate = station.tmc.get_coordinate().params
    assert coordinate is not None
    east, north, height = map(float, coordinate[0])
    np.testing.assert_allclose([1000 * north, -1000 * east, 1000 * height], at_mm, atol=0.06)
    assert station.tmc.get_face().params is not None
    assert station.tmc.get_angle_inclination().params is not None


def test_no_target_and_nothing_to_abort(station: GeoCom) -> None:
    station.aus.switch_user_atr(True)
    assert station.aut.fine_adjust(1e-6, 1e-6).error == GeoComCode.AUT_NO_TARGET
    assert station.abort().error == GeoComCode.OK
    assert station.com.nullprocess().error == GeoComCode.OK
