"""All promises, and one driver put through those of its port."""

from __future__ import annotations

from collections.abc import Mapping

from hilcell.cell.devices import TABLES
from hilcell.cell.file import Cell, load_cell
from hilcell.conformance import connecting, rail, robot, tracker, wire_faults
from hilcell.conformance.trial import Promise
from hilcell.conformance.verdicts import PORTS, Port

PROMISES: tuple[Promise, ...] = (
    *connecting.PROMISES,
    *rail.PROMISES,
    *robot.PROMISES,
    *tracker.PROMISES,
    *wire_faults.PROMISES,
)


PORT_OF: dict[str, Port] = {
    group: port for port in PORTS for table, group in TABLES if table == port
}


def driver_cell(where: str, port: Port, driver: str, sets: Mapping[str, str]) -> Cell:
    """Return a cell with a driver at one port."""
    stated = load_cell(where, sets)
    if getattr(stated, port).driver == driver:
        return stated
    return load_cell(where, {f"{port}.driver": driver, **sets})


def promises_of(port: Port) -> list[Promise]:
    """Return the promises of a port, in the order in which they are judged."""
    return [promise for promise in PROMISES if port in promise.ports]
