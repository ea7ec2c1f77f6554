"""The rail is surveyed there and back with the robot parked (section 2, Fig 1)."""

from __future__ import annotations

from operator import itemgetter

import numpy as np

from hilcell.cell.file import Cell
from hilcell.geometry.frames import apply, rigid_fit, to_rotvec, unit
from hilcell.geometry.statistics import slope, variance_of_mean
from hilcell.journal.log import Log, positions_mm
from hilcell.model.plan import Span, Step
from hilcell.model.point import PointId
from hilcell.model.results import SurveyedRail, WithU
from hilcell.model.verdicts import Backlash
from hilcell.ports import Array
from hilcell.present.table import Column, Table
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Result
from hilcell.run.prompts import FLANGE
from hilcell.typed import typed
from procedures.plan import closing, measure_s, rail_move_s, step

FORTH, BACK = "forth", "back"
COVERAGE = 2.0  # k


class RailSurvey:
    """Moves in equal steps by the drive alone; measures the flange and all nests at every stop."""

    name = "rail-survey"
    needs = "the world frame, reflectors on the flange and in the slide nests"
    moves = "the slide from end to end and back, the robot parked"
    measures = "the flange reflector and the slide nests at every stop"
    yields = "the error both ways, backlash, scale, straightness, yaw, pitch and roll"

    def plan(self, cell: Cell, seed: int) -> Step:
        """Return the step."""
        stops = 2 * len(steps_mm(cell))
        points = stops * (1 + len(cell.layout.slide))
        seconds = points * measure_s(cell, cell.nest_samples)
        seconds += rail_move_s(cell, cell.survey.from_mm - cell.rail.travel_min_mm)
        seconds += (stops - 2) * rail_move_s(cell, cell.survey.step_mm) + rail_move_s(cell, 0.0)
        survey = Span("survey", points, seconds)
        return step(self.name, points, [survey, *closing(cell, points=points)])

    def perform(self, session: CellSession) -> None:
        """Go forth and back; judge the backlash."""
        steps = steps_mm(session.cell)
        for way, order in ((FORTH, steps), (BACK, steps[::-1])):
            for number, position_mm in enumerate(order):
                self._stop(session, way, number, float(position_mm))
        session.close_step()
        if "backlash" in session.log.verdicts:
            return
        found = surveyed(session.log).backlash_mm
        found_mm, limit_mm = abs(found.value), session.cell.rail.max_backlash_mm
        holds = found_mm - COVERAGE * found.u <= limit_mm
        session.judge("backlash", Backlash(holds=holds, found_mm=found_mm, limit_mm=limit_mm))

    def _stop(self, session: CellSession, way: str, number: int, position_mm: float) -> None:
        names = (FLANGE, *(nest.name for nest in session.cell.layout.slide))
        ids = [PointId("survey", way=way, number=number, nest=name) for name in names]
        if all(session.log.find(id) for id in ids):
            return
        session.rail_to(position_mm)
        for id in ids:
            session.slide_now(id, id.nest)

    def result(self, log: Log) -> Result:
        """Return the survey's figures."""
        return {"rail_survey": surveyed(log)}


def steps_mm(cell: Cell) -> Array:
    """Return the nominal positions (N,) of the survey."""
    table = cell.survey
    count = round((table.to_mm - table.from_mm) / table.step_mm) + 1
    return np.linspace(table.from_mm, table.to_mm, count)


def surveyed(log: Log) -> SurveyedRail:
    """Return error curves, backlash, scale, straightness and angles, with uncertainties k = 1."""
    nominal_mm = steps_mm(log.cell)
    forth_mm = path_mm(log, FORTH, FLANGE)
    back_mm = path_mm(log, BACK, FLANGE)[::-1]
    along = rail_axis(log, forth_mm)
    origin_mm = forth_mm[0] - nominal_mm[0] * along
    error_forth = (forth_mm - origin_mm) @ along - nominal_mm
    error_back = (back_mm - origin_mm) @ along - nominal_mm
    # At both ends the slide was not reached from its way's side.
    lost_mm = (error_back - error_forth)[1:-1]
    scale, u_scale = slope(nominal_mm, error_forth)
    return SurveyedRail(
        curve={
            FORTH: np.column_stack([nominal_mm, error_forth]).tolist(),
            BACK: np.column_stack([nominal_mm, error_back]).tolist(),
        },
        max_error_mm=float(np.abs([error_forth, error_back]).max()),
        backlash_mm=WithU(value=float(lost_mm.mean()), u=float(np.sqrt(variance_of_mean(lost_mm)))),
        scale_ppm=WithU(value=scale * 1e6, u=u_scale * 1e6),
        straightness_mm=straightness_mm(forth_mm, along),
        angles_mrad=angles_mrad(log, along),
    )


def path_mm(log: Log, way: str, name: str) -> Array:
    """Return one reflector's positions (N, 3) in {W} in the order of the stops."""
    points = [point for point in log.select("survey", way=way) if point.id.nest == name]
    return apply(log.matrix("world"), positions_mm(points))


def rail_axis(log: Log, points_mm: Array) -> Array:
    """Return the direction (3,) of the best line through points (N, 3), along the rail's sense."""
    axis: Array = np.linalg.svd(points_mm - points_mm.mean(axis=0))[2][0]
    along: Array = axis * np.sign(axis @ np.array(log.cell.layout.rail_direction))
    return along


def across_axes(along: Array) -> tuple[Array, Array]:
    """Return the horizontal and the vertical direction (3,) across the rail."""
    level = unit(np.cross(along, [0.0, 0.0, 1.0]))
    return level, np.cross(level, along)


def straightness_mm(points_mm: Array, along: Array) -> dict[str, float]:
    """Return peak to peak of the path (N, 3) across its best line."""
    off_mm = points_mm - points_mm.mean(axis=0)
    level, upright = across_axes(along)
    return {
        "horizontal": float(np.ptp(off_mm @ level)),
        "vertical": float(np.ptp(off_mm @ upright)),
    }


def angles_mrad(log: Log, along: Array) -> dict[str, list[float]]:
    """Return the slide's roll, pitch and yaw (N,) against its first stop, from all its nests."""
    nests = [path_mm(log, FORTH, nest.name) for nest in log.cell.layout.slide]
    stops_mm = np.stack(nests, axis=1)
    turns = np.array([turn_rad(stops_mm[0], stop_mm) for stop_mm in stops_mm]) * 1e3
    level, upright = across_axes(along)
    axes = {"roll": along, "pitch": level, "yaw": upright}
    return {name: (turns @ axis).tolist() for name, axis in axes.items()}


def turn_rad(before_mm: Array, after_mm: Array) -> Array:
    """Return the rotation vector (3,) between two sightings of the same points (N, 3)."""
    return to_rotvec(rigid_fit(before_mm, after_mm).T[:3, :3])


def survey_table(result: Result) -> Table:
    """Return the survey's figures for a person to read."""
    survey = typed(result["rail_survey"], SurveyedRail)
    backlash, scale = survey.backlash_mm, survey.scale_ppm
    rows: list[tuple[str, float, float | None, str]] = [
        ("largest error", survey.max_error_mm, None, "mm"),
        ("backlash", backlash.value, backlash.u, "mm"),
        ("scale", scale.value, scale.u, "ppm"),
    ]
    for name, value in survey.straightness_mm.items():
        rows.append((f"straightness, {name}", value, None, "mm"))
    for name, turns in survey.angles_mrad.items():
        rows.append((f"{name}, peak to peak", float(np.ptp(turns)), None, "mrad"))
    return Table(
        [
            Column("figure", itemgetter(0)),
            Column("value", itemgetter(1), form=".4f"),
            Column("u (k = 1)", itemgetter(2), form=".4f"),
            Column("unit", itemgetter(3)),
        ],
        rows,
    )
