"""A station held by the strip, and the proof that it comes back (section 4.3, Figs 9-10)."""

from __future__ import annotations

from operator import itemgetter

import numpy as np

from hilcell.cell.file import Cell
from hilcell.geometry.statistics import from_mean_mm, repeatability_mm
from hilcell.journal.log import Log, positions_mm
from hilcell.model.plan import Span, Step
from hilcell.model.point import PointId
from hilcell.model.results import ActResult
from hilcell.model.verdicts import StripRepeats
from hilcell.ports import Array
from hilcell.present.table import Column, Table
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Result
from hilcell.typed import typed
from procedures.plan import approach_s, closing, first_hold, measure_s, rail_move_s, step

APPROACH_MM = 150.0
STRIP_LIMIT_MM = 0.035
HOWS = ("plain", "strip")


class HoldStation:
    """Brings the slide to the grid's station by the closed loop of the strip."""

    name = "hold-station"
    needs = "a referenced drive"
    moves = "the slide, with the robot at its safe pose"
    measures = "the strip, one slide nest"
    yields = "a held station"

    def plan(self, cell: Cell, seed: int) -> Step:
        """Return the step."""
        station = cell.reference
        return step(self.name, 0, first_hold(cell, station))

    def perform(self, session: CellSession) -> None:
        """Hold the station once; a later act that needs it holds it itself."""
        if not session.reached("station_held"):
            session.hold_station(session.cell.reference)
            session.reach("hold_station")

    def result(self, log: Log) -> Result:
        """Return nothing: the station's figures come with its frame."""
        return {}


class Approaches(ActResult, frozen=True, kw_only=True):
    """Range along the rail, RP of ISO 9283, and the mean from above less that from below, mm."""

    range_mm: float
    rp_mm: float
    backlash_mm: float | None = None


class OneSide(ActResult, frozen=True, kw_only=True):
    """Approaches from below, by the drive alone and by the strip."""

    plain: Approaches
    strip: Approaches


class StationRepeated(ActResult, frozen=True, kw_only=True):
    """Approaches from random sides, ``repeats`` of each kind, and from one side."""

    repeats: int
    plain: Approaches
    strip: Approaches
    one_side: OneSide


class StationRepeatability:
    """Approaches one station many times, by the drive alone and by the strip.

    First always from below, then from a random side: the difference is the direction's effect.
    """

    name = "station-repeatability"
    needs = "the world frame, a reflector on the slide"
    moves = "the slide to and fro around the grid's station"
    measures = "one slide nest after each approach"
    yields = "range, repeatability and backlash without and with the strip"

    def plan(self, cell: Cell, seed: int) -> Step:
        """Return the step."""
        station = cell.reference
        away_s = rail_move_s(cell, APPROACH_MM)
        by_strip_s = approach_s(cell, station.rail_mm - APPROACH_MM, station)
        each_s = away_s + measure_s(cell, cell.nest_samples)
        visits = 2 * cell.survey.repeats
        plain = Span("plain approach", visits, visits * (each_s + away_s))
        by_strip = Span("strip approach", visits, visits * (each_s + by_strip_s))
        points = len(HOWS) * visits
        return step(self.name, points, [plain, by_strip, *closing(cell, points=points)])

    def perform(self, session: CellSession) -> None:
        """Approach, measure, go away, come back."""
        repeats = session.cell.survey.repeats
        ways = {"one_side": [-1] * repeats, "random": random_sides(session.seed, repeats)}
        for how in HOWS:
            for way, sides in ways.items():
                for number, side in enumerate(sides):
                    self._visit(session, how, way, number, side)
        session.close_step()
        found_mm = approaches(session.log, "strip", "random").range_mm
        limit_mm = STRIP_LIMIT_MM
        holds = found_mm <= limit_mm
        judged = StripRepeats(holds=holds, found_mm=found_mm, limit_mm=limit_mm)
        session.judge("station-repeatability", judged)

    def _visit(self, session: CellSession, how: str, way: str, number: int, side: int) -> None:
        id = PointId("repeat", how=how, way=way, number=number, side=side)
        if session.log.find(id):
            return
        station = session.cell.reference
        session.rail_to(station.rail_mm + side * APPROACH_MM)
        if how == "strip":
            session.hold_station(station, again=True)
        else:
            session.rail_to(station.rail_mm)
        session.slide_now(id, session.cell.layout.slide[0].name)

    def result(self, log: Log) -> Result:
        """Return range, ISO 9283 RP and the effect of the side, along the rail."""
        found = StationRepeated(
            repeats=log.cell.survey.repeats,
            plain=approaches(log, "plain", "random"),
            strip=approaches(log, "strip", "random"),
            one_side=OneSide(
                plain=approaches(log, "plain", "one_side"),
                strip=approaches(log, "strip", "one_side"),
            ),
        )
        return {"station_repeatability": found}


def random_sides(seed: int, repeats: int) -> list[int]:
    """Return the sides of the approaches, -1 from below, half of each, in random order."""
    sides = [1 if number % 2 else -1 for number in range(repeats)]
    return [int(side) for side in np.random.default_rng([seed, 9283]).permutation(sides)]


def approaches(log: Log, how: str, way: str) -> Approaches:
    """Return the figures of one kind of approach."""
    points = log.select("repeat", how=how, way=way)
    points_mm = positions_mm(points)
    along_mm = along_rail(log, points_mm)
    above = np.array([point.id.side > 0 for point in points])
    lost_mm = float(along_mm[above].mean() - along_mm[~above].mean()) if above.any() else None
    return Approaches(
        range_mm=float(np.ptp(along_mm)),
        rp_mm=repeatability_mm(from_mean_mm(points_mm)),
        backlash_mm=lost_mm,
    )


def along_rail(log: Log, points_mm: Array) -> Array:
    """Return (N,) coordinates along the rail's nominal direction of raw points (N, 3)."""
    rotation = log.matrix("world")[:3, :3]
    along: Array = points_mm @ rotation.T @ np.array(log.cell.layout.rail_direction)
    return along


def approach_table(result: Result) -> Table:
    """Return range, RP and backlash of the slide without and with the strip."""
    found = typed(result["station_repeatability"], StationRepeated)
    below, random = "from below", "from random sides"
    rows = [
        (f"plain, {below}", found.one_side.plain),
        (f"plain, {random}", found.plain),
        (f"strip, {below}", found.one_side.strip),
        (f"strip, {random}", found.strip),
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
