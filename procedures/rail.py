"""The slide on its rail: survey, hold at a station by the strip, and repeatability.

Survey in both directions with the robot parked (section 2, Fig 1). A station is held by the closed
loop of the strip, and approached repeatedly (section 4.3, Figs 9-10).
"""

from __future__ import annotations

from operator import itemgetter

import numpy as np

from hilcell.cell.file import Cell
from hilcell.cell.uncertainty import COVERAGE_FACTOR
from hilcell.decoding import typed
from hilcell.geometry.frames import apply, rigid_fit, to_rotvec, unit
from hilcell.geometry.statistics import from_mean_mm, repeatability_mm, slope, variance_of_mean
from hilcell.journal.log import Log, positions_mm
from hilcell.model.plan import PlannedStep, Span
from hilcell.model.point import PointId
from hilcell.model.results import StepResult, SurveyedRail, WithU
from hilcell.model.verdicts import Backlash, StripRepeats
from hilcell.ports import Array
from hilcell.present.table import Column, Table
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Result, Step
from hilcell.run.prompts import FLANGE
from procedures.plan import approach_s, closing, first_hold, measure_s, rail_move_s

# -- the survey -----------------------------------------------------------------------------------

FORTH, BACK = "forth", "back"


class RailSurvey:
    """Moves in equal steps by the drive alone; measures the flange and all nests at every stop."""

    name = "rail-survey"
    needs = "the world frame, reflectors on the flange and in the slide nests"
    moves = "the slide from end to end and back, the robot parked"
    measures = "the flange reflector and the slide nests at every stop"
    yields = "the error both ways, backlash, scale, straightness, yaw, pitch and roll"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        stops = 2 * len(self.steps_mm(cell))
        points = stops * (1 + len(cell.layout.slide))
        seconds = points * measure_s(cell, cell.nest_samples)
        seconds += rail_move_s(cell, cell.survey.from_mm - cell.rail.travel_min_mm)
        seconds += (stops - 2) * rail_move_s(cell, cell.survey.step_mm) + rail_move_s(cell, 0.0)
        survey = Span("survey", points, seconds)
        return PlannedStep.of_spans(self.name, points, [survey, *closing(cell, points=points)])

    def perform(self, session: CellSession) -> None:
        steps = self.steps_mm(session.cell)
        for way, order in ((FORTH, steps), (BACK, steps[::-1])):
            for number, position_mm in enumerate(order):
                self._stop(session, way, number, float(position_mm))
        session.close_step()
        if "backlash" in session.log.verdicts:
            return
        found = self.surveyed(session.log).backlash_mm
        found_mm, limit_mm = abs(found.value), session.cell.rail.max_backlash_mm
        holds = found_mm - COVERAGE_FACTOR * found.u <= limit_mm
        session.judge("backlash", Backlash(holds=holds, found_mm=found_mm, limit_mm=limit_mm))

    def _stop(self, session: CellSession, way: str, number: int, position_mm: float) -> None:
        names = (FLANGE, *(nest.name for nest in session.cell.layout.slide))
        ids = [PointId("survey", direction=way, number=number, nest=name) for name in names]
        if all(session.log.find(id) for id in ids):
            return
        session.rail_to(position_mm)
        for id in ids:
            session.slide_now(id, id.nest)

    def result(self, log: Log) -> Result:
        return {"rail_survey": self.surveyed(log)}

    @staticmethod
    def table(result: Result) -> Table:
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

    @staticmethod
    def surveyed(log: Log) -> SurveyedRail:
        """Return error curves, backlash, scale, straightness, angles; uncertainties k = 1."""
        nominal_mm = RailSurvey.steps_mm(log.cell)
        forth_mm = path_mm(log, FORTH, FLANGE)
        back_mm = path_mm(log, BACK, FLANGE)[::-1]
        axis: Array = np.linalg.svd(forth_mm - forth_mm.mean(axis=0))[2][0]
        along = axis * np.sign(axis @ np.array(log.cell.layout.rail_direction))  # of the best line
        origin_mm = forth_mm[0] - nominal_mm[0] * along
        error_forth = (forth_mm - origin_mm) @ along - nominal_mm
        error_back = (back_mm - origin_mm) @ along - nominal_mm
        # Both ends were not approached from the direction of travel.
        lost_mm = (error_back - error_forth)[1:-1]
        scale, u_scale = slope(nominal_mm, error_forth)
        off_mm, (level, upright) = forth_mm - forth_mm.mean(axis=0), RailSurvey._across_axes(along)
        return SurveyedRail(
            curve={
                FORTH: np.column_stack([nominal_mm, error_forth]).tolist(),
                BACK: np.column_stack([nominal_mm, error_back]).tolist(),
            },
            max_error_mm=float(np.abs([error_forth, error_back]).max()),
            backlash_mm=WithU(
                value=float(lost_mm.mean()), u=float(np.sqrt(variance_of_mean(lost_mm)))
            ),
            scale_ppm=WithU(value=scale * 1e6, u=u_scale * 1e6),
            straightness_mm={
                "horizontal": float(np.ptp(off_mm @ level)),
                "vertical": float(np.ptp(off_mm @ upright)),
            },
            angles_mrad=RailSurvey._angles_mrad(log, along),
        )

    @staticmethod
    def _angles_mrad(log: Log, along: Array) -> dict[str, list[float]]:
        """Return the slide's roll, pitch and yaw (N,) against its first stop, by all nests."""
        nests = [path_mm(log, FORTH, nest.name) for nest in log.cell.layout.slide]
        stops_mm = np.stack(nests, axis=1)
        fits = [rigid_fit(stops_mm[0], stop_mm) for stop_mm in stops_mm]
        turns = np.array([to_rotvec(fit.T[:3, :3]) for fit in fits]) * 1e3
        level, upright = RailSurvey._across_axes(along)
        axes = {"roll": along, "pitch": level, "yaw": upright}
        return {name: (turns @ axis).tolist() for name, axis in axes.items()}

    @staticmethod
    def _across_axes(along: Array) -> tuple[Array, Array]:
        """Return the horizontal and the vertical direction (3,) across the rail."""
        level = unit(np.cross(along, [0.0, 0.0, 1.0]))
        return level, np.cross(level, along)

    @staticmethod
    def steps_mm(cell: Cell) -> Array:
        """Return the nominal positions (N,) of the survey."""
        table = cell.survey
        count = round((table.to_mm - table.from_mm) / table.step_mm) + 1
        return np.linspace(table.from_mm, table.to_mm, count)


def path_mm(log: Log, way: str, name: str) -> Array:
    """Return one reflector's positions (N, 3) in {W} in the order of the stops."""
    points = [point for point in log.select("survey", direction=way) if point.id.nest == name]
    return apply(log.matrix("world"), positions_mm(points))


# -- stations -------------------------------------------------------------------------------------

METHODS = ("plain", "strip")


class HoldStation(Step):
    """Brings the slide to the grid's station by the closed loop of the strip."""

    name = "hold-station"
    needs = "a referenced drive"
    moves = "the slide, with the robot at its safe pose"
    measures = "the strip, one slide nest"
    yields = "a held station"

    def announced(self, cell: Cell) -> str:
        if not cell.has_rail:
            return "nothing"
        station = cell.reference
        return f"the slide to {station.name}, {station.strip_mm:.0f} mm of the strip; robot parked"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        return PlannedStep.of_spans(self.name, 0, first_hold(cell, cell.reference))

    def perform(self, session: CellSession) -> None:
        """Hold the station once; later steps hold it themselves."""
        if not session.reached("station_held"):
            session.hold_station(session.cell.reference)
            session.reach("hold_station")


class Approaches(StepResult, frozen=True, kw_only=True):
    """Range along the rail, RP of ISO 9283, and the mean from above less that from below, mm."""

    range_mm: float
    rp_mm: float
    backlash_mm: float | None = None


class OneSide(StepResult, frozen=True, kw_only=True):
    """Approaches from below, by the drive alone and by the strip."""

    plain: Approaches
    strip: Approaches


class StationRepeated(StepResult, frozen=True, kw_only=True):
    """Approaches from random sides, ``repeats`` of each kind, and from one side."""

    repeats: int
    plain: Approaches
    strip: Approaches
    one_side: OneSide


class StationRepeatability:
    """Approaches one station many times, by the drive alone and by the strip. First always from
    below, then from a random side: the difference is the direction's effect.
    """

    APPROACH_MM = 150.0

    name = "station-repeatability"
    needs = "the world frame, a reflector on the slide"
    moves = "the slide to and fro around the grid's station"
    measures = "one slide nest after each approach"
    yields = "range, repeatability and backlash without and with the strip"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        station = cell.reference
        away_s = rail_move_s(cell, self.APPROACH_MM)
        by_strip_s = approach_s(cell, station.rail_mm - self.APPROACH_MM, station)
        each_s = away_s + measure_s(cell, cell.nest_samples)
        visits = 2 * cell.survey.repeats
        plain = Span("plain approach", visits, visits * (each_s + away_s))
        by_strip = Span("strip approach", visits, visits * (each_s + by_strip_s))
        points = len(METHODS) * visits
        return PlannedStep.of_spans(
            self.name, points, [plain, by_strip, *closing(cell, points=points)]
        )

    def perform(self, session: CellSession) -> None:
        repeats = session.cell.survey.repeats
        ways = {"one_side": [-1] * repeats, "random": self.sides(session.seed, repeats)}
        for how in METHODS:
            for way, sides in ways.items():
                for number, side in enumerate(sides):
                    self._visit(session, how, way, number, side)
        session.close_step()
        found_mm, limit_mm = self.approaches(session.log, "strip", "random").range_mm, 0.035
        judged = StripRepeats(holds=found_mm <= limit_mm, found_mm=found_mm, limit_mm=limit_mm)
        session.judge("station-repeatability", judged)

    def _visit(self, session: CellSession, how: str, way: str, number: int, side: int) -> None:
        id = PointId("repeat", how=how, direction=way, number=number, side=side)
        if session.log.find(id):
            return
        station = session.cell.reference
        session.rail_to(station.rail_mm + side * self.APPROACH_MM)
        if how == "strip":
            session.hold_station(station, again=True)
        else:
            session.rail_to(station.rail_mm)
        session.slide_now(id, session.cell.layout.slide[0].name)

    def result(self, log: Log) -> Result:
        below, random = (
            {how: self.approaches(log, how, way) for how in METHODS}
            for way in ("one_side", "random")
        )
        found = StationRepeated(
            repeats=log.cell.survey.repeats, **random, one_side=OneSide(**below)
        )
        return {"station_repeatability": found}

    @staticmethod
    def table(result: Result) -> Table:
        """Return range, RP and backlash of the slide without and with the strip."""
        found = typed(result["station_repeatability"], StationRepeated)
        rows = [
            ("plain, from below", found.one_side.plain),
            ("plain, from random sides", found.plain),
            ("strip, from below", found.one_side.strip),
            ("strip, from random sides", found.strip),
        ]
        return Table(
            [
                Column("approach", itemgetter(0)),
                Column("range", lambda row: row[1].range_mm, "mm", ".4f"),
                Column("RP", lambda row: row[1].rp_mm, "mm", ".4f"),
                Column("backlash", lambda row: row[1].backlash_mm, "mm", ".4f"),
            ],
            rows,
        )

    @staticmethod
    def sides(seed: int, repeats: int) -> list[int]:
        """Return the sides of the approaches, -1 from below, half of each, in random order."""
        sides = [1 if number % 2 else -1 for number in range(repeats)]
        return [int(side) for side in np.random.default_rng([seed, 9283]).permutation(sides)]

    @staticmethod
    def approaches(log: Log, how: str, way: str) -> Approaches:
        points = log.select("repeat", how=how, direction=way)
        points_mm, R = positions_mm(points), log.matrix("world")[:3, :3]
        along_mm = points_mm @ R.T @ np.array(log.cell.layout.rail_direction)
        above = np.array([point.id.side > 0 for point in points])
        lost_mm = float(along_mm[above].mean() - along_mm[~above].mean()) if above.any() else None
        return Approaches(
            range_mm=float(np.ptp(along_mm)),
            rp_mm=repeatability_mm(from_mean_mm(points_mm)),
            backlash_mm=lost_mm,
        )
