"""The floor nests as the run of the cell's current calibration measured them."""

from __future__ import annotations

from pathlib import Path

from hilcell.cell.file import Cell
from hilcell.journal.index import read_index
from hilcell.journal.log import BaseBefore, FloorBefore, Log
from hilcell.journal.runs import read_log
from hilcell.journal.standing import current_of


def floor_before(runs: Path, cell: Cell, machine_seed: int | None) -> FloorBefore | None:
    """Return them, tracker's frame; None without such a run, or where the cell file has moved them.

    ``machine_seed`` is a simulated machine's, where it is known.
    """
    name = current_of(
        read_index(runs), cell.name, cell.serial, cell.simulation is not None, machine_seed
    )
    if not name:
        return None
    log = read_log(runs / name)
    nests = {point.id.nest: point for point in log.select("world") if point.id.number is None}
    if log.cell.layout.floor != cell.layout.floor or len(nests) != len(cell.layout.floor):
        return None
    air_c = [point.temperature_c for point in nests.values() if point.temperature_c is not None]
    return FloorBefore(
        name,
        {nest: point.xyz_mm for nest, point in nests.items()},
        sum(air_c) / len(air_c) if air_c else None,
        _base_before(log, cell),
    )


def _base_before(log: Log, cell: Cell) -> BaseBefore | None:
    """Return the base as circles gave it; None where another robot, place or sweep gave others."""
    then, frame = log.cell, log.frames.get("base", {})
    station = then.station_named(then.grid.station)
    alike = station == cell.station_named(cell.grid.station) and then.robot == cell.robot
    if "circle_rms_mm" not in frame or not alike or then.base_frame != cell.base_frame:
        return None
    return BaseBefore(frame["matrix"], frame["covariance"])
