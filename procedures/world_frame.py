"""{W} is constructed from three nests on the floor (section 5.1), the tracker's anchor."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np

from hilcell.cell.file import Cell
from hilcell.geometry.frames import apply, inverse, three_point_frame
from hilcell.journal.log import Log, positions_mm
from hilcell.journal.point_id import PointId
from hilcell.ports import Array, DeviceError
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Step
from procedures.durations import floor_points, step
from procedures.plan import check_range

CONTROL_LIMIT_MM = 0.1


class WorldFrame:
    """Measures the floor nests; on resume it proves first that the tracker has not moved."""

    name = "world-frame"
    needs = "reflectors in the floor nests"
    moves = "nothing"
    measures = "three floor nests, averaged"
    yields = "the tracker in {W}"

    def plan(self, cell: Cell, seed: int) -> Step:
        """Refuse nests out of the tracker's range."""
        check_range(cell, np.array([nest.xyz_mm for nest in cell.layout.floor]), "floor nests")
        return step(self.name, len(cell.layout.floor), [floor_points(cell)])

    def perform(self, session: CellSession) -> None:
        """Measure the nests and build the frame, or check the frame that the journal holds."""
        if "world" in session.log.frames:
            check_control_points(session)
        else:
            self._construct(session)
        session.reach("frame_world")

    def _construct(self, session: CellSession) -> None:
        nests = session.cell.layout.floor
        points = [session.floor_point(PointId("world", nest=nest.name), nest) for nest in nests]
        measured_mm = positions_mm(points)
        check_places(session.cell, measured_mm)
        check_distances(session.cell, measured_mm)
        session.frame("world", world_from_tracker(session.cell, measured_mm))

    def result(self, log: Log) -> dict[str, Any]:
        """Return the tracker in {W}."""
        return {"tracker": {"T_W_L": log.matrix("world").tolist()}}


def world_from_tracker(cell: Cell, measured_mm: Array) -> Array:
    """Return T_W_L (4, 4): the three first floor nests span {W} after eqs 14-16."""
    nominal_mm = np.array([nest.xyz_mm for nest in cell.layout.floor])
    return three_point_frame(*nominal_mm[:3]) @ inverse(three_point_frame(*measured_mm[:3]))


def check_places(cell: Cell, measured_mm: Array) -> None:
    """Refuse nests that were seen outside the tracker's search for them.

    Distances do not tell that two nests changed places in a symmetric triangle; places do.
    """
    nests, limit_mm = cell.layout.floor, cell.tracker.find_radius_mm
    nominal_mm = np.array([nest.xyz_mm for nest in nests])
    expected_mm = apply(inverse(cell.tracker.pose.matrix()), nominal_mm)
    off_mm = np.linalg.norm(measured_mm[:, None] - expected_mm[None], axis=-1)
    for nest, row_mm, found_mm in zip(nests, off_mm, np.diag(off_mm), strict=True):
        if found_mm <= limit_mm:
            continue
        near = zip(nests, row_mm, strict=True)
        at = [other.name for other, each_mm in near if each_mm <= limit_mm]
        where = f", where {at[0]} is expected" if at else ""
        raise DeviceError(
            "HC-T32",
            "Tracker",
            "world frame",
            f"{nest.name} was seen {found_mm:.1f} mm from its expected place{where}",
            wanted=f"<= {limit_mm:.1f} mm (tracker.find_radius_mm)",
            act="nests swapped, or the tracker does not stand as tracker.pose says; check, then "
            "resume",
            fields={
                "nest": nest.name,
                "off_mm": float(found_mm),
                "limit_mm": limit_mm,
                "seen_at": at[:1],
            },
        )


def check_distances(cell: Cell, measured_mm: Array) -> None:
    """Refuse nests whose distances are not those of the cell file: swapped, lifted, wrong unit."""
    nests = cell.layout.floor
    limit_mm = 2 * cell.layout.nest_tolerance_mm
    for i, j in combinations(range(len(nests)), 2):
        wanted_mm = float(np.linalg.norm(nests[i].xyz_mm - nests[j].xyz_mm))
        found_mm = float(np.linalg.norm(measured_mm[i] - measured_mm[j]))
        if not abs(found_mm - wanted_mm) <= limit_mm:
            raise DeviceError(
                "HC-T32",
                "Tracker",
                "world frame",
                f"{nests[i].name} to {nests[j].name} is {found_mm:.2f} mm",
                wanted=f"{wanted_mm:.2f} +-{limit_mm:.1f} mm",
                act="nests swapped, a reflector not seated, or wrong units; check, then resume",
                fields={
                    "nests": [nests[i].name, nests[j].name],
                    "distance_mm": found_mm,
                    "wanted_mm": wanted_mm,
                    "limit_mm": limit_mm,
                },
            )


def check_control_points(session: CellSession) -> None:
    """Measure the floor nests again and refuse to go on when the tracker has moved."""
    T_W_L = session.log.matrix("world")
    for nest in session.cell.layout.floor:
        before = session.log.point(PointId("world", nest=nest.name))
        turn = sum(point.id.nest == nest.name for point in session.log.points.values())
        id = PointId("control", session=session.log.session, turn=turn, nest=nest.name)
        now = session.floor_point(id, nest)
        moved_mm = np.diff(apply(T_W_L, positions_mm([before, now])), axis=0)[0]
        off_mm = float(np.linalg.norm(moved_mm))
        if not off_mm <= CONTROL_LIMIT_MM:
            raise DeviceError(
                "HC-T33",
                "Tracker",
                f"control point {nest.name}",
                f"moved by {off_mm:.3f} mm",
                wanted=f"<= {CONTROL_LIMIT_MM:.2f} mm",
                act="tracker or nest was bumped: two set-ups are never mixed; start a new run",
                fields={"nest": nest.name, "moved_mm": off_mm, "limit_mm": CONTROL_LIMIT_MM},
            )
