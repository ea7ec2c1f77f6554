"""Which frame comes back better: the robot's base or the station's (section 4.2, Fig 8)?

Six slide points are measured apart from those that build the frames; at every station they are
expressed in the base frame built there and in the station frame built there. Both should see
them where they were at the reference.
"""

from __future__ import annotations

from operator import itemgetter

import numpy as np

from hilcell.calibration.frames import frame_of_sweeps
from hilcell.cell.file import Cell, Station
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.statistics import f_quantile, lengths_mm, rms
from hilcell.journal.log import Log, positions_mm
from hilcell.model.frame import Frame
from hilcell.model.plan import Step
from hilcell.model.point import PointId
from hilcell.model.results import FramesRepeated
from hilcell.ports import Array, HilcellError
from hilcell.present.table import Column, Table
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Result
from hilcell.typed import typed
from procedures.base_frame import (
    check_circles,
    points_on_arc,
    sweep,
    sweeps,
)
from procedures.durations import closing, leg, readings, step
from procedures.plan import other_stations

SIX = 6
MORE_READINGS = 4  # than for a frame, so that the points' own noise does not hide the frames'
FREEDOMS = 6  # of one frame: its errors move all six points together
CONFIDENCE = 0.95


class FrameRepeatability:
    """Builds the base frame at every station and measures six slide points again."""

    name = "frame-repeatability"
    needs = "the stations framed"
    moves = "the slide from station to station, axes 1 and 6 at each"
    measures = "circles of axes 1 and 6, six slide points at every station"
    yields = "how much better the station frame repeats, with an interval"

    def plan(self, cell: Cell, seed: int) -> Step:
        """Refuse a cell with one station: frames are compared between stations."""
        if len(cell.station) < 2:
            raise HilcellError(
                "one station, wanted two or more: frames are compared between them",
                code="HC-C10",
            )
        here, spans = other_stations(cell)[-1], []  # where the last step left the slide
        six = readings(cell, SIX, MORE_READINGS * cell.nest_samples)
        for station in cell.station:
            check_circles(cell, station)
            spans += [*leg(cell, here, station), six, sweeps(cell), *closing(cell)]
            here = station
        return step(self.name, len(cell.station) * (2 * points_on_arc(cell) + SIX), spans)

    def perform(self, session: CellSession) -> None:
        """Visit every station."""
        for station in session.cell.station:
            if f"base.{station.name}" not in session.log.frames:
                self._frame(session, station)

    def _frame(self, session: CellSession, station: Station) -> None:
        samples = MORE_READINGS * session.cell.nest_samples
        for nest in session.cell.layout.slide[-SIX:]:
            id = PointId("six", station=station.name, nest=nest.name)
            session.slide_point(id, station, nest, samples=samples)
        for axis in (1, 6):
            for number, joints in enumerate(sweep(session.cell, axis)):
                id = PointId("frames", station=station.name, axis=axis, number=number)
                session.flange_point(id, station, joints)
        session.close_step()
        circles = [session.log.select("frames", station.name, axis=axis) for axis in (1, 6)]
        T_W_B = frame_of_sweeps(session.cell, session.log, *circles)[0]
        keys = [point.key for point in (*circles[0], *circles[1])]
        session.frame(f"base.{station.name}", Frame(matrix=T_W_B.tolist(), points=keys))

    def result(self, log: Log) -> Result:
        """Return the distances in both frames, and the ratio of their root mean squares.

        Its interval is that of an F distribution with six degrees of freedom for every station
        compared.
        """
        base, station = moved_mm(log, "base"), moved_mm(log, "station")
        rms_mm = {"base": rms([*base.values()]), "station": rms([*station.values()])}
        ratio, freedoms = rms_mm["base"] / rms_mm["station"], FREEDOMS * len(base)
        spread = float(np.sqrt(f_quantile(0.5 + CONFIDENCE / 2, freedoms, freedoms)))
        found = FramesRepeated(
            base=base,
            station=station,
            rms_mm=rms_mm,
            ratio=ratio,
            ratio_interval=(ratio / spread, ratio * spread),
        )
        return {"frame_repeatability": found}


def moved_mm(log: Log, kind: str) -> dict[str, list[float]]:
    """Return by station how far the six points are from their places at the reference (mm), seen
    in its ``kind`` of frame: "base" or "station".
    """
    reference_mm = seen_from(log, kind, log.cell.station_named(log.cell.grid.station))
    return {
        station.name: lengths_mm(seen_from(log, kind, station) - reference_mm).tolist()
        for station in other_stations(log.cell)
    }


def seen_from(log: Log, kind: str, station: Station) -> Array:
    """Return the six points (6, 3) in the base or station frame of ``station``."""
    world_mm = apply(log.matrix("world"), positions_mm(log.select("six", station.name)))
    return apply(inverse(log.matrix(f"{kind}.{station.name}")), world_mm)


def frame_repeatability_table(result: Result) -> Table:
    """Return the distances in both frames, point by point, and the ratio."""
    found = typed(result["frame_repeatability"], FramesRepeated)
    rows: list[tuple[str, float | None, float | None]] = [
        (f"{station}, point {n + 1}", base_mm, station_mm)
        for station, in_base_mm in found.base.items()
        for n, (base_mm, station_mm) in enumerate(
            zip(in_base_mm, found.station[station], strict=True)
        )
    ]
    low, high = found.ratio_interval
    rows.append(("rms", found.rms_mm["base"], found.rms_mm["station"]))
    rows.append((f"ratio {found.ratio:.1f} (95 %: {low:.1f} .. {high:.1f})", None, None))
    return Table(
        [
            Column("moved against the reference", itemgetter(0)),
            Column("base frame", itemgetter(1), "mm", ".4f"),
            Column("station frame", itemgetter(2), "mm", ".4f"),
        ],
        rows,
    )
