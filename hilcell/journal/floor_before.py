"""Floor, base and stations as the run of the cell's current calibration measured them."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import msgspec
import numpy as np

from hilcell.cell.file import Cell
from hilcell.journal.index import read_index
from hilcell.journal.log import Log, repeated_visits
from hilcell.journal.runs import CALIBRATION, read_log
from hilcell.journal.standing import current_of, measured_by
from hilcell.model.calibration import Provenance, StationEntry
from hilcell.model.frame import Frame, MeasuredBase
from hilcell.model.plan import FloorBefore
from hilcell.ports import DeviceError
from hilcell.typed import decoded

FLOOR_NESTS = 3  # that span {W}, the first ones


def floor_before(runs: Path, cell: Cell, machine_seed: int | None) -> FloorBefore | None:
    """Return them; None without such a run, or where the cell file has moved the floor nests.

    ``machine_seed`` is a simulated machine's, where it is known.
    """
    rows = read_index(runs)
    name = current_of(rows, cell.name, cell.serial, cell.simulation is not None, machine_seed)
    if not name:
        return None
    log = read_log(runs / name)
    _refuse_other_order(name, log.cell, cell)
    found, first = measured_before(name, log, cell), measured_by(rows, name)
    if found is None or first == name:
        return found
    origin = measured_before(first, read_log(runs / first), cell)
    return found if origin is None else _with_frames(found, origin, runs / name / CALIBRATION, cell)


class _Calibration(msgspec.Struct):
    """The part of a calibration file that says where an update has found the base."""

    provenance: Provenance
    stations: dict[str, StationEntry]


def _with_frames(found: FloorBefore, origin: FloorBefore, updated: Path, cell: Cell) -> FloorBefore:
    """Return floor nests with the frames of the run that measured them, and the base as the
    calibration file ``updated`` has it; without a base where that cannot be read.
    """
    base = None
    with suppress(OSError, msgspec.DecodeError, KeyError):
        after = decoded(updated.read_bytes(), _Calibration)
        base = _moved_base(origin.base, after, cell.grid.station)
    return msgspec.structs.replace(
        origin,
        run=found.run,
        nests_mm=found.nests_mm,
        temperature_c=found.temperature_c,
        base=base,
        frames_c=origin.temperature_c,
    )


def _moved_base(base: Frame | None, after: _Calibration, station: str) -> Frame | None:
    """Return the base where updates have found it; their covariances have the axes of {B}."""
    if base is None:
        return None
    T = np.array(after.stations[station].T_W_B)
    covariance, turn = base.C, np.kron(np.eye(2), T[:3, :3])
    for update in after.provenance.updates:
        if update.what == "base":
            covariance += turn @ np.array(update.covariance) @ turn.T
    return Frame(matrix=T.tolist(), covariance=covariance.tolist())


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
        _same_robot(then, cell) and then.base_frame == cell.base_frame,
        _stations_before(log, cell),
        visits_mm=_visits_before(log, cell),
    )


def _refuse_other_order(run: str, then: Cell, now: Cell) -> None:
    """Refuse the same places under other names, or in an order that spans {W} by other nests.

    Distances of nests do not show it, and {W} lies elsewhere, by as much as nests are beside their
    places.
    """
    before, after = then.layout.floor, now.layout.floor
    places = [
        sorted((nest.x_mm, nest.y_mm, nest.z_mm) for nest in nests) for nests in (before, after)
    ]
    named = [{nest.name: nest for nest in nests} for nests in (before, after)]
    spans = [nests[:FLOOR_NESTS] for nests in (before, after)]
    if places[0] != places[1] or (named[0] == named[1] and spans[0] == spans[1]):
        return
    wanted, found = (", ".join(nest.name for nest in nests) for nests in spans)
    raise DeviceError(
        "HC-T32",
        "Tracker",
        "world frame",
        f"the cell file spans {{W}} by {found}, at places that had other names or another order",
        wanted=f"{wanted}, each at its place, as in run {run}",
        act="put names and order of layout.floor back, or revoke that run's calibration",
        fields={"run": run, "nests": [nest.name for nest in spans[1]]},
    )


def _base_before(log: Log, cell: Cell) -> Frame | None:
    """Return the base as circles gave it; None where the grid has another station now."""
    then, frame = log.cell, log.frames.get("base")
    station = then.station_named(then.grid.station)
    if not isinstance(frame, MeasuredBase) or station != cell.station_named(cell.grid.station):
        return None
    return Frame(matrix=frame.matrix, covariance=frame.covariance)


def _stations_before(log: Log, cell: Cell) -> dict[str, Frame]:
    """Return the slide at the stations, and with the nests, that the cell still has."""
    if log.cell.layout.slide != cell.layout.slide:
        return {}
    frames = {
        station.name: log.frames.get(f"station.{station.name}")
        for station in cell.station
        if station in log.cell.station
    }
    return {
        name: Frame(matrix=frame.matrix, covariance=frame.covariance)
        for name, frame in frames.items()
        if frame is not None and frame.covariance
    }


def _same_robot(then: Cell, now: Cell) -> bool:
    """Whether both have one robot, whatever is stated of its repeatability."""
    return msgspec.structs.replace(then.robot, rp_mm=now.robot.rp_mm) == now.robot


def _visits_before(log: Log, cell: Cell) -> list[list[tuple[float, float, float]]]:
    """Return clouds of places that the robot visited repeatedly, where the cell still has them."""
    if not (_same_robot(log.cell, cell) and log.cell.grid == cell.grid):
        return []
    return [[point.xyz_mm for point in visits] for visits in repeated_visits(log)]
