"""Devices of a cell, found through entry points and built from the cell file's tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any

import msgspec

from hilcell.cell import Cell
from hilcell.ports import Clock, DeviceError, Identity, Rail, Robot, SimulatedCell, Tracker
from hilcell.settings import SettingsError, convert

TABLES = (("rail", "rails"), ("robot", "robots"), ("tracker", "trackers"))


def load_entry(group: str, name: str) -> Any:
    """Return what the entry point ``name`` of ``hilcell.<group>`` names."""
    found = {entry.name: entry for entry in entry_points(group=f"hilcell.{group}")}
    if name not in found:
        known = ", ".join(sorted(found)) or "none; is the package installed?"
        raise SettingsError(group, [f"{name!r} is not installed; installed: {known}"])
    try:
        return found[name].load()
    except ImportError as error:
        raise SettingsError(group, [f"{name!r} cannot be loaded: {error}"]) from error


@dataclass(frozen=True, slots=True)
class Devices:
    """The three devices of a cell."""

    rail: Rail
    robot: Robot
    tracker: Tracker

    def named(self) -> dict[str, Rail | Robot | Tracker]:
        """Return the devices by name, in the order in which they are opened."""
        return {"Rail": self.rail, "Robot": self.robot, "Tracker": self.tracker}


def build_devices(
    cell: Cell, addresses: Mapping[str, Mapping[str, object]], clock: Clock
) -> Devices:
    """Build the drivers, unopened, with ``addresses`` in place of the options' own."""
    built: dict[str, Any] = {}
    for table, group in TABLES:
        kind, options = driver_options(cell, table, group, addresses.get(table, {}))
        built[table] = kind(options, clock)
    return Devices(**built)


def driver_options(
    cell: Cell, table: str, group: str, addresses: Mapping[str, object]
) -> tuple[Callable[..., Any], msgspec.Struct]:
    """Return a driver class and its checked options.

    The cell's own values of the same names (travel, speed, tool point, reflector) are handed on,
    so that they stand in the file once.
    """
    shared = getattr(cell, table)
    kind = load_entry(group, shared.driver)
    wanted = {field.name for field in msgspec.structs.fields(kind.Options)}
    values = {name: value for name, value in msgspec.to_builtins(shared).items() if name in wanted}
    return kind, convert(values | shared.options | dict(addresses), kind.Options, table)


def check_options(cell: Cell) -> None:
    """Check the options of all three drivers, and that the simulator is installed.

    Raises `SettingsError` with all problems.
    """
    problems: list[str] = []
    for table, group in TABLES:
        try:
            driver_options(cell, table, group, {})
        except SettingsError as error:
            problems += [f"{table}.options: {line}" for line in error.problems]
    if cell.simulation is not None:
        try:
            load_entry("simulators", cell.simulation.simulator)
        except SettingsError as error:
            problems += [f"simulation.simulator: {line}" for line in error.problems]
    if problems:
        raise SettingsError(cell.name, problems)


def start_simulation(
    cell: Cell, *, seed: int, speed: float, faults: str = "", truth: bool = False
) -> SimulatedCell | None:
    """Start the simulated cell beside the engine, where the cell file asks for one.

    ``seed`` is its machine's. No run sets ``truth``: whoever asks for it starts the cell himself.
    """
    if cell.simulation is None:
        return None
    simulator = load_entry("simulators", cell.simulation.simulator)
    simulated: SimulatedCell = simulator(cell, seed=seed, speed=speed, faults=faults, truth=truth)
    return simulated


class ConnectFailed(DeviceError):
    """Some devices could not be connected; the message lists all of them as a tree."""

    def __init__(self, failures: Mapping[str, Exception]) -> None:
        self.failures = dict(failures)
        names = ", ".join(failures)
        tree = "\n".join(f"  {name}\n    {error}" for name, error in failures.items())
        super().__init__("Cell", "connect", f"{names} failed\n{tree}")


def connect_all(devices: Devices) -> list[Identity]:
    """Open every device and return the identities; raises `ConnectFailed` naming all failures."""
    identities: list[Identity] = []
    failures: dict[str, Exception] = {}
    for name, device in devices.named().items():
        try:
            identities += device.connect()
        except DeviceError as error:
            failures[name] = error
    if failures:
        raise ConnectFailed(failures)
    return identities
