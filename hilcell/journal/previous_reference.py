"""Floor, base and stations as measured by the run of the cell's current calibration."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from hilcell.cell.file import Cell
from hilcell.decoding import decoded
from hilcell.journal.calibration_status import current_of, measured_by
from hilcell.journal.index import read_index
from hilcell.journal.log import Log, repeated_visits
from hilcell.journal.runs import CALIBRATION, read_log
from hilcell.model.calibration import Provenance, StationEntry
from hilcell.model.frame import Frame, MeasuredBase
from hilcell.model.plan import PreviousReference
from hilcell.ports import DeviceError

FLOOR_NESTS = 3  # that span {W}, the first ones


def floor_before(runs: Path, cell: Cell, machine_seed: int | None) -> PreviousReference | None:
    """Return them; None without such a run, or where the cell file has moved the floor nests."""
    rows = read_index(runs)
    name = current_of(rows, cell.name, cell.serial, cell.simulation is not None, machine_seed)
    if not name:
        return None
    log = read_log(runs / name)
    _refuse_other_order(name, log.cell, cell)
    floor, first = _Measured(log, cell).floor(name), measured_by(rows, name)
    if floor is None or first == name:
        return floor
    origin = _Measured(read_log(runs / first), cell).floor(first)
    return floor if origin is None else _with_frames(floor, origin, runs / name / CALIBRATION, cell)


class _Calibration(msgspec.Struct):
    """The part of a calibration file with the base of an update."""

    provenance: Provenance
    stations: dict[str, StationEntry]


def _with_frames(
    floor: PreviousReference, origin: PreviousReference, updated: Path, cell: Cell
) -> PreviousReference:
    """Return floor nests with the frames of their run and the base of the calibration file
    ``updated``; without a base if that is unreadable.
    """
    base = None
    with suppress(OSError, msgspec.DecodeError, KeyError):
        after = decoded(updated.read_bytes(), _Calibration)
        if origin.base is not None:
            T = np.array(after.stations[cell.grid.station].T_W_B)
            covariance, turn = origin.base.C, np.kron(np.eye(2), T[:3, :3])  # with the axes of {B}
            for update in after.provenance.updates:
                if update.what == "base":
                    covariance += turn @ np.array(update.covariance) @ turn.T
            base = Frame(matrix=T.tolist(), covariance=covariance.tolist())
    return msgspec.structs.replace(
        origin,
        run=floor.run,
        nests_mm=floor.nests_mm,
        temperature_c=floor.temperature_c,
        base=base,
        frames_c=origin.temperature_c,
    )


@dataclass(frozen=True, eq=False)
class _Measured:
    """The log of an earlier run, compared with the present cell."""

    log: Log
    cell: Cell

    def floor(self, name: str) -> PreviousReference | None:
        """Return the measurements of the run ``name`` that still apply to the cell."""
        log, then = self.log, self.log.cell
        nests = {point.id.nest: point for point in log.select("world") if point.id.number is None}
        if then.layout.floor != self.cell.layout.floor or len(nests) != len(then.layout.floor):
            return None
        same_grid = self._same_robot() and then.grid == self.cell.grid
        clouds = repeated_visits(log) if same_grid else []
        air_c = [each.temperature_c for each in nests.values() if each.temperature_c is not None]
        return PreviousReference(
            name,
            {nest: point.xyz_mm for nest, point in nests.items()},
            sum(air_c) / len(air_c) if air_c else None,
            self._base(),
            self._same_robot() and then.base_frame == self.cell.base_frame,
            self._stations(),
            visits_mm=[[point.xyz_mm for point in visits] for visits in clouds],
        )

    def _base(self) -> Frame | None:
        """Return the base from circles; None if the grid's station has changed."""
        then, frame = self.log.cell, self.log.frames.get("base")
        if not isinstance(frame, MeasuredBase) or then.reference != self.cell.reference:
            return None
        return Frame(matrix=frame.matrix, covariance=frame.covariance)

    def _stations(self) -> dict[str, Frame]:
        """Return the slide at the stations that the cell still has, if its nests are the same."""
        if self.log.cell.layout.slide != self.cell.layout.slide:
            return {}
        return {
            station.name: Frame(matrix=frame.matrix, covariance=frame.covariance)
            for station in self.cell.station
            if station in self.log.cell.station
            and (frame := self.log.frames.get(f"station.{station.name}")) is not None
            and frame.covariance
        }

    def _same_robot(self) -> bool:
        now = self.cell.robot
        return msgspec.structs.replace(self.log.cell.robot, rp_mm=now.rp_mm) == now


def _refuse_other_order(run: str, then: Cell, now: Cell) -> None:
    """Refuse renamed nests, and an order that spans {W} by other nests, at the same places.

    Distances do not show it, and {W} would shift by the nests' deviations from their places.
    """
    before, after = then.layout.floor, now.layout.floor
    places = [
        sorted((nest.x_mm, nest.y_mm, nest.z_mm) for nest in nests) for nests in (before, after)
    ]
    named = [{nest.name: nest for nest in nests} for nests in (before, after)]
    spans = [nests[:FLOOR_NESTS] for nests in (before, after)]
    if places[0] != places[1] or (named[0] == named[1] and spans[0] == spans[1]):
        return
    expected, actual = (", ".join(nest.name for nest in nests) for nests in spans)
    raise DeviceError(
        "HC-T32",
        "Tracker",
        "world frame",
        f"the cell file spans {{W}} by {actual}, at places that had other names or another order",
        expected=f"{expected}, each at its place, as in run {run}",
        act="put names and order of layout.floor back, or revoke that run's calibration",
        fields={"run": run, "nests": [nest.name for nest in spans[1]]},
    )
