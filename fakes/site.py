"""Simulated devices, found by entry points: their place in the cell and their few duties.

The device that speaks the wire of a driver is found by the driver's name, in
``hilcell.simulated_rails``, ``hilcell.simulated_robots`` and ``hilcell.simulated_trackers``: a
function ``serve(site, port)`` that opens its port and returns the device, not yet started.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from fakes.canopen.rail_device import RailDevice
from fakes.faults import Faults
from fakes.time import CellTime
from fakes.truth.cell_truth import CellTruth, ReplayTruth
from fakes.truth.rail_truth import RailTruth
from hilcell.cell.devices import GROUPS, load_entry
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError


@dataclass(frozen=True, slots=True)
class Site:
    """One simulated cell: its truth, its faults and its time."""

    cell: Cell
    truth: CellTruth | ReplayTruth
    faults: Faults
    time: CellTime
    rail_device: RailDevice = field(default_factory=RailDevice)

    def slide(self) -> RailTruth:
        """Return the rail; raises `SettingsError` for a cell without one."""
        if isinstance(self.truth.rail, RailTruth):
            return self.truth.rail
        raise SettingsError("rail", ["this cell has no slide to simulate"])


class SimulatedDevice(Protocol):
    """A device on its wire."""

    @property
    def address(self) -> dict[str, object]:
        """Return where it listens, as options of the driver."""

    def start(self) -> None:
        """Begin to serve."""

    def restore(self) -> None:
        """Undo the effects of faults, as an operator at the device would."""

    def close(self) -> None:
        """Stop serving."""


Serve = Callable[[Site, int], SimulatedDevice]


def device_servers(cell: Cell) -> dict[str, Serve]:
    """Return what serves each device of a cell, by table; a cell without a rail has no rail server.

    Raises `SettingsError` for drivers without a simulation.
    """
    found: dict[str, Serve] = {}
    problems: list[str] = []
    for table, group in GROUPS.items():
        driver = getattr(cell, table).driver
        if table == "rail" and not cell.has_rail:
            continue
        try:
            found[table] = load_entry(f"simulated_{group}", driver)
        except SettingsError as error:
            problems += [
                f"{table}.driver: nothing simulates its wire: simulated device {each}"
                for each in error.problems
            ]
    if problems:
        raise SettingsError("simulation", problems)
    return found
