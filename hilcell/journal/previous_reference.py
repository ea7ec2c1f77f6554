"""Floor, base and stations as the run of the cell's current calibration measured them."""

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
    """Return them; None without such a run, or where the cell file has moved the floor nests.

    ``machine_seed`` is a simulated machine's, where it is known.
    """
    rows = read_index(runs)
    name = current_of(rows, cell.name, cell.serial, cell.simulation is not None, machine_seed)
    if not name:
        return None
    log = read_log(runs / name)
    _refuse_other_order(name, log.cell, cell)
    found, first = _Measured(log, cell).floor(name), measured_by(rows, name)
    if found is None or first == name:
        return found
    origin = _Measured(read_log(runs / first), cell).floor(first)
    return found if origin is None else _with_frames(found, origin, runs / name / CALIBRATION, cell)


class _Calibration(msgspec.Struct):
    """The part of a calibration file that says where an update has found the base."""

    provenance: Provenance
    stations: dict[str, StationEntry]


def _with_frames(
    found: PreviousReference, origin: PreviousReference, updated: Path, cell: Cell
) -> PreviousReference:
    """Return floor nests with the frames of the run that measured them, and the base as the
    calibration file ``updated`` has it; without a base where that cannot be read.
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
        run=found.run,
        nests_mm=found.nests_mm,
        temperature_c=found.temperature_c,
        base=base,
        frames_c=origin.temperature_c,
    )


@dataclass(frozen=True, eq=False)
class _Measured:
    """The log of an earlier run, seen from the cell as it is now."""

    log: Log
    cell: Cell

    def floor(self, name: str) -> PreviousReference | None:
        """Return what the run ``name`` measured, as far as the cell still has it."""
        log, then = self.log, self.log.cell
        nests = {point.id.nest: point for point in log.select("world") if point.id.number is None}
        if then.layout.floor != self.cell.layout.floor or len(nests) != len(then.layout.floor):
            return None
        kept = self._same_robot() and then.grid == self.cell.grid
        clouds = repeated_visits(log) if kept else []  # of places that the cell still has
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
        """Return the base as circles gave it; None where the grid has another station now."""
        then, frame = self.log.cell, self.log.frames.get("base")
        if not isinstance(frame, MeasuredBase) or then.reference != self.cell.reference:
            return None
        return Frame(matrix=frame.matrix, covariance=frame.covariance)

    def _stations(self) -> dict[str, Frame]:
        """Return the slide at the stations, and with the nests, that the cell still has."""
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
        """Whether both have one robot, whatever is stated of its repeatability."""
        now = self.cell.robot
        return msgspec.structs.replace(self.log.cell.robot, rp_mm=now.rp_mm) == now


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
        expected=f"{wanted}, each at its place, as in run {run}",
        act="put names and order of layout.floor back, or revoke that run's calibration",
        fields={"run": run, "nests": [nest.name for nest in spans[1]]},
    )
