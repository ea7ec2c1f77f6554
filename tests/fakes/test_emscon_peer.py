"""The emScon server against an independent client of the protocol."""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Iterator
from types import SimpleNamespace

import CESAPI.command
import CESAPI.connection
import numpy as np
import pytest
from CESAPI.command import CommandSync
from CESAPI.connection import Connection
from CESAPI.packet import ES_LU_Millimeter, StationaryModeDataT, SystemUnitsDataT

from fakes.faults import Faults
from fakes.leica.emscon_server import EmsconDevice, EmsconServer
from fakes.site import Site
from fakes.time import CellTime
from fakes.truth.cell_truth import CellTruth
from hilcell.cell.file import Cell

pytestmark = pytest.mark.waits


@pytest.fixture
def truth(cell: Cell) -> CellTruth:
    return CellTruth(cell, 1, CellTime(math.inf), Faults())


@pytest.fixture
def command(cell: Cell, truth: CellTruth, monkeypatch: pytest.MonkeyPatch) -> Iterator[CommandSync]:
    soon = SimpleNamespace(  # in place of 0.2 s, and of a limit that a busy PC passes
        sleep=lambda _s: threading.Event().wait(0.002), time=lambda: 0.0
    )
    for module in (CESAPI.command, CESAPI.connection):
        monkeypatch.setattr(module, "time", soon)
    server = EmsconServer(Site(cell, truth, Faults(), truth.time))
    with contextlib.closing(server):
        server.start()
        connection = Connection()
        connection.connect("127.0.0.1", server.port)
        try:
            yield CommandSync(connection)
        finally:
            connection.disconnect()


def test_a_measurement_from_first_to_last(command: CommandSync, truth: CellTruth) -> None:
    assert command.GetSystemStatus().lTrackerSerialNumber == EmsconDevice.SERIAL
    command.Initialize()
    units = SystemUnitsDataT()
    units.lenUnitType = ES_LU_Millimeter
    command.SetUnits(units)
    assert command.GetUnits().unitsSettings.lenUnitType == ES_LU_Millimeter
    command.SetCoordinateSystemType(0)
    stationary = StationaryModeDataT()
    stationary.lMeasTime, stationary.bUseADM = 1000, 1
    command.SetStationaryModeParams(stationary)
    command.SetReflector(3)
    assert command.GetReflector().iInternalReflectorId == 3
    at = truth.tracker.reflectors()["F2"]
    command.GoPosition(1, *at)
    result = command.StartMeasurement()
    np.testing.assert_allclose((result.dVal1, result.dVal2, result.dVal3), at, atol=0.06)
    assert 0 < result.dStdTotal < 0.05
    assert 22 <= result.dTemperature <= 24
    with pytest.raises(Exception, match="status 4"):
        command.SetReflector(77)
