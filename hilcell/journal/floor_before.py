"""Floor, base and stations as the run of the cell's current calibration measured them."""

from __future__ import annotations

from pathlib import Path

from hilcell.cell.file import Cell
from hilcell.journal.index import read_index
from hilcell.journal.log import FloorBefore, FrameBefore, Log
from hilcell.journal.runs import read_log
from hilcell.journal.standing import current_of


def floor_before(runs: Path, cell: Cell, machine_seed: int | None) -> FloorBefore | None:
    """Return them; None without such a run, or where the cell file has moved the floor nests.

    ``machine_seed`` is a simulated machine's, where it is known.
    """
    name = current_of(
        read_index(runs), cell.name, cell.serial, cell.simulation is not None, machine_seed
    )
    return measured_before(name, read_log(runs / name), cell) if name else None


def measured_before(name: str, log: Log, cell: Cell) -> FloorBefore | None:
    """Return them as the run ``name`` measured them, as far as ``cell`` still has them."""
    nests = {point.id.nest: point for point in log.select("world") if point.id.number is None}
    if log.cell.layout.floor != cell.layout.floor or len(nests) != len(cell.layout.floor):
        return None
    air_c = [point.temperature_c for point in nests.values() if point.temperature_c is not None]
    then = log.cell
    return FloorBefore(
        name,
        {nest: point.xyz_mm for nest, point in nests.items()},
        sum(air_c) / len(air_c) if air_c else None,
        _base_before(log, cell),
        then.robot == cell.robot and then.base_frame == cell.base_frame,
        _stations_before(log, cell),
    )


def _base_before(log: Log, cell: Cell) -> FrameBefore | None:
    """Return the base as circles gave it; None where the grid has another station now."""
    then, frame = log.cell, log.frames.get("base", {})
    station = then.station_named(then.grid.station)
    if "circle_rms_mm" not in frame or station != cell.station_named(cell.grid.station):
        return None
    return FrameBefore(frame["matrix"], frame["covariance"])


def _stations_before(log: Log, cell: Cell) -> dict[str, FrameBefore]:
    """Return the slide at the stations, and with the nests, that the cell still has."""
    if log.cell.layout.slide != cell.layout.slide:
        return {}
    frames = {
        station.name: log.frames.get(f"station.{station.name}", {})
        for station in cell.station
        if station in log.cell.station
    }
    return {
        name: FrameBefore(frame["matrix"], frame["covariance"])
        for name, frame in frames.items()
        if "covariance" in frame
    }
