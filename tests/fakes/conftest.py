from __future__ import annotations

import math
import socket
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import Generic, TypeVar

import pytest

from fakes.faults import Faults
from fakes.site import Site
from fakes.time import CellTime
from fakes.truth.cell_truth import CellTruth
from fakes.wires import Server
from hilcell.cell.file import Cell, load_cell
from hilcell.geometry.kinematics import Array
from tests.fakes.rail_bench import Bus, on_bus
from tests.fakes.wires import connected

S = TypeVar("S", bound=Server)
C = TypeVar("C")


class DeviceTime:
    """The real time of a simulated controller, which the test drives."""

    def __init__(self) -> None:
        self.at_s = 0.0

    def now_s(self) -> float:
        return self.at_s


def station_cell(*, serial: bool, prism_mm: float = 0.0) -> Cell:
    """Return the paper's cell with a total station, on a serial line or on TCP."""
    channel = "/dev/ttyUSB0" if serial else "socket://127.0.0.1:1212"
    return load_cell(
        "paper",
        {
            "tracker.driver": "leica-geocom",
            "tracker.options.channel": channel,
            "tracker.options.prism_constant_mm": str(prism_mm),
        },
    )


@pytest.fixture(scope="session")
def cell() -> Cell:
    return load_cell("paper")


def simulated_site(cell: Cell, speed: float = math.inf) -> tuple[Site, CellTruth]:
    """Return a cell without faults, paced at ``speed`` or stepped, and its truth."""
    faults, time = Faults(), CellTime(speed)
    truth = CellTruth(cell, 1, time, faults)
    return Site(cell, truth, faults, time), truth


@dataclass
class Served(Generic[S, C]):
    """A device behind its wire, with a client of it."""

    truth: CellTruth
    faults: Faults
    server: S
    client: C

    def at(self, name: str) -> Array:
        """Return the place (3,) of a reflector, in the tracker's frame."""
        return self.truth.tracker.reflectors()[name]


@contextmanager
def served(
    serve: Callable[[Site], S],
    client: Callable[[socket.socket], C],
    cell: Cell,
    speed: float = math.inf,
) -> Iterator[Served[S, C]]:
    """Serve a device of a fresh cell, and connect to it."""
    site, truth = simulated_site(cell, speed)
    server = serve(site)
    with closing(server):
        server.start()
        with connected(int(str(server.address["port"]))) as wire:
            yield Served(truth, site.faults, server, client(wire))
        server.restore()  # timers end


@pytest.fixture
def bus() -> Iterator[Bus]:
    with on_bus() as bus:
        yield bus


@pytest.fixture
def device_time(monkeypatch: pytest.MonkeyPatch) -> DeviceTime:
    """Return the time of the life timers that are made later."""
    time = DeviceTime()
    monkeypatch.setattr("fakes.time.DeviceTime", lambda: time)
    return time
