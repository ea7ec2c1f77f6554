"""A whole simulated cell in one process: plant, simulated devices, control channel."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from msgspec import Struct

from fakes.control import ControlServer, truth_of
from fakes.faults import Faults, load_faults
from fakes.site import SimulatedDevice, Site, servers_of
from fakes.time import PlantTime
from fakes.truth.plant import Plant
from fakes.truth.replay_plant import ReplayPlant
from hilcell.cell.file import Cell
from hilcell.cell.settings import convert
from hilcell.errors import HilcellError, with_place

DUTIES = ("address", "start", "restore", "close")


class Ports(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The TCP ports to listen on; 0 is one that the system chooses."""

    rail: int = 0
    robot: int = 0
    tracker: int = 0
    control: int = 0


class Order(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The wanted simulated cell; ``seed`` is the machine's, ``speed`` None is stepped time."""

    cell: dict[str, Any]
    seed: int = 1
    speed: float | None = None
    faults: str = ""
    truth: bool = False
    ports: Ports = Ports()


class Host:
    """Runs one simulated cell; raises `HilcellError` where the order is not sound."""

    def __init__(self, order: Order) -> None:
        self._order, ports = order, order.ports
        self._ended = threading.Event()
        cell = convert(order.cell, Cell, "simulated cell")
        faults = load_faults(order.faults)
        time = PlantTime(math.inf if order.speed is None else order.speed)
        plant = _plant(cell, order, time, faults)
        site = Site(cell, plant, faults, time)
        self._devices: dict[str, SimulatedDevice] = {}
        with ExitStack() as made:  # what was made before one that is broken is closed again
            for table, serve in servers_of(cell).items():
                device = _served(table, partial(serve, site, getattr(ports, table)))
                made.callback(device.close)
                self._devices[table] = device
            made.pop_all()
        self._control = ControlServer(
            time,
            faults,
            addresses=self.addresses,
            truth=lambda asked: _truth(plant, asked, order),
            seat=plant.seat,
            restore=self._restore,
            quit_=self.end,
            port=ports.control,
        )

    def addresses(self) -> dict[str, Any]:
        """Return where everything listens, and how time passes."""
        found = {table: device.address for table, device in self._devices.items()}
        return found | {"control": self._control.address, "speed": self._order.speed}

    def run(self) -> None:
        """Serve until `end`."""
        with ExitStack() as stack:
            servers: list[SimulatedDevice | ControlServer] = [
                *self._devices.values(),
                self._control,
            ]
            for server in servers:
                stack.callback(server.close)
                server.start()
            self._ended.wait()

    def _restore(self) -> None:
        for device in self._devices.values():
            device.restore()

    def end(self) -> None:
        """End the simulated cell; may come from any thread."""
        self._ended.set()


def _served(table: str, serve: Callable[[], SimulatedDevice]) -> SimulatedDevice:
    """Return a simulated device; raises `HilcellError` where a package's one is broken."""
    try:
        device = serve()
        lacking = [name for name in DUTIES if not hasattr(device, name)]
    except HilcellError:
        raise
    except Exception as error:
        raise HilcellError(f"simulated {table}: {with_place(error)}") from error
    if lacking:
        what = f"{type(device).__name__} has no {', '.join(lacking)}"
        raise HilcellError(f"simulated {table}: {what}; see fakes.site.SimulatedDevice")
    return device


def _truth(plant: Plant | ReplayPlant, asked: dict[str, Any], order: Order) -> dict[str, Any]:
    if not order.truth:
        raise HilcellError(
            "this simulated cell keeps its truth: start it with `hilcell sim --truth`"
        )
    return truth_of(plant, asked) if isinstance(plant, Plant) else {}


def _plant(cell: Cell, order: Order, time: PlantTime, faults: Faults) -> Plant | ReplayPlant:
    if cell.simulation is not None and cell.simulation.data:
        return ReplayPlant(cell, Path(cell.simulation.data), time, faults)
    return Plant(cell, order.seed, time, faults)
