"""The tracker's field check, without a motion of robot or slide: axes, scale, drift, reflectors."""

from __future__ import annotations

import math
from collections.abc import Iterator
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from hilcell.calibration.tracker_check import (
    DIRECTIONS,
    front_id,
    judged_axes,
    judged_drift,
    seen_direction,
)
from hilcell.cell.devices import abilities
from hilcell.cell.file import Cell
from hilcell.cell.layout import Nest
from hilcell.decoding import typed
from hilcell.geometry.frames import apply, inverse
from hilcell.journal.log import Log
from hilcell.model.outcome import Figure
from hilcell.model.plan import PlannedStep, Span
from hilcell.model.point import BACK, STEADY, PointId
from hilcell.model.verdicts import (
    AxesJudged,
    DriftJudged,
    InstrumentChecked,
    MeasuredLength,
    MeasuredReflector,
)
from hilcell.ports import HilcellError
from hilcell.present.table import Column, Table
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Procedure, Result
from procedures.plan import measure_s
from procedures.reflectors import Reflectors
from procedures.world_frame import ONE_FACE, UNSEEN, WorldFrame


class SeenNest(NamedTuple):
    """A nest and its distance from the tracker as the cell file has both."""

    nest: Nest
    range_mm: float


def nests_by_range(cell: Cell) -> list[SeenNest]:
    """Return the nearest, a middle and the farthest nest within the tracker's range.

    Raises `HilcellError` where there are fewer.
    """
    nests = cell.layout.fixed_nests
    places_mm = apply(
        inverse(cell.tracker.pose.matrix()), np.array([nest.xyz_mm for nest in nests])
    )
    low_mm, high_mm = cell.tracker.min_range_mm, cell.tracker.max_range_mm
    every = map(SeenNest, nests, np.linalg.norm(places_mm, axis=1).tolist())
    seen = sorted(
        (each for each in every if low_mm <= each.range_mm <= high_mm), key=attrgetter("range_mm")
    )
    fewest = 3
    if len(seen) < fewest:
        names = ", ".join(each.nest.name for each in seen) or "none"
        raise HilcellError(
            f"expected 3 nests on floor and bars at {low_mm:g} to {high_mm:g} mm from the tracker, "
            f"got {names}; move the tracker or correct tracker.pose",
            code="HC-C10",
        )
    near, *between, far = seen
    middle_mm = math.sqrt(near.range_mm * far.range_mm)
    middle = min(between, key=lambda each: abs(math.log(each.range_mm / middle_mm)))
    return [near, middle, far]


class Nests(WorldFrame):
    """The tracker in {W}, and the certified lengths; the drive needs no reference."""

    name = "nests"
    needs = "reflectors in the floor nests, and on bars of known length"

    def perform(self, session: CellSession) -> None:
        session.reach("connect")
        session.frame_world()
        self.check_lengths(session)

    def result(self, log: Log) -> Result:
        return {**super().result(log), "length_directions": directions(log)}


def directions(log: Log) -> dict[str, list[str]]:
    """Return the certified lengths by the direction in which the tracker sees them."""
    cell, found = log.cell, dict[str, list[str]]()
    at_mm = {nest.name: nest.xyz_mm for nest in cell.layout.fixed_nests}
    T_L_W = inverse(log.matrix("world") if "world" in log.frames else cell.tracker.pose.matrix())
    for each in cell.layout.length:
        ends_mm = apply(T_L_W, np.array([at_mm[name] for name in each.nests]))
        found.setdefault(seen_direction(ends_mm), []).append(" to ".join(each.nests))
    return found


class Axes:
    """Three nests, each in the first, the second and again in the first face."""

    name = "axes"
    needs = "a tracker that turns over"
    moves = "nothing but the tracker's head"
    measures = "a near, a middle and a far nest in both faces"
    yields = "collimation, transit tilt and index of the tracker, and the two-face errors"

    SAMPLES, FACE_S = 20, 4.0  # to turn over and point
    LEAST_SPAN = 1.5  # of the farthest range to the nearest

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        chosen = nests_by_range(cell)
        if reason := one_face(cell):
            return PlannedStep(self.name, 0, 0.0, note=reason)
        seconds = 2.0 * (self.FACE_S + measure_s(cell, self.SAMPLES)) + cell.tracker.pointing_s
        span = Span("both faces", 3 * len(chosen), seconds * len(chosen))
        near, _, far = chosen
        warning = ""
        if not far.range_mm >= self.LEAST_SPAN * near.range_mm:
            warning = (
                f"all nests are {near.range_mm:.0f} to {far.range_mm:.0f} mm away, expected the "
                f"farthest {self.LEAST_SPAN:g} times as far as the nearest: errors that grow with "
                "the range are not separable from those that do not; add a nest on the floor"
            )
        return PlannedStep(self.name, 0, span.duration_s, (span,), warning=warning)

    def perform(self, session: CellSession) -> None:
        cell, log = session.cell, session.log
        if one_face(cell) or log.verdict(AxesJudged) is not None:
            return
        for nest, _ in nests_by_range(cell):
            before, after = (front_id(nest.name, number) for number in (0, 1))
            session.fixed_nest_point(before, nest, self.SAMPLES // 2)
            session.fixed_nest_point(PointId(BACK, nest=nest.name), nest, self.SAMPLES, back=True)
            session.fixed_nest_point(after, nest, self.SAMPLES // 2)
        judged = judged_axes(log)
        if judged is not None:
            session.judge(AxesJudged.keys[0], judged)

    def result(self, log: Log) -> Result:
        judged = log.verdict(AxesJudged)
        return {} if judged is None else {"tracker_axes": judged}


def one_face(cell: Cell) -> str:
    """Return what is not seen in one face, "" where the tracker has two."""
    return "" if abilities(cell)["tracker_turns_over"] else f"{ONE_FACE}: {UNSEEN}"


class Drift:
    """The farthest nest for ten minutes, every half one."""

    name = "drift"
    needs = "a reflector in the farthest nest, that nobody passes"
    moves = "nothing"
    measures = "the farthest nest, every 30 s for 10 minutes"
    yields = "the trend of its place, and the range"

    POINTS, EVERY_S, SAMPLES = 21, 30.0, 10

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        nests_by_range(cell)
        seconds = (self.POINTS - 1) * self.EVERY_S + measure_s(cell, self.SAMPLES)
        return PlannedStep.of_spans(self.name, 0, [Span("drift", self.POINTS, seconds)])

    def perform(self, session: CellSession) -> None:
        """Measure and judge, once; a series that another session began starts again."""
        log, clock, (*_, far) = session.log, session.clock, nests_by_range(session.cell)
        if log.verdict(DriftJudged) is not None:
            return
        begun_s = clock.now_s()
        for number in range(self.POINTS):
            while (left_s := begun_s + number * self.EVERY_S - clock.now_s()) > 0.0:
                session.checkpoint()
                clock.wait(min(1.0, left_s))
            id = PointId(STEADY, session=log.session, pass_number=number, nest=far.nest.name)
            elapsed_s = clock.now_s() - begun_s
            session.fixed_nest_point(id, far.nest, self.SAMPLES, elapsed_s=elapsed_s)
        judged = judged_drift(log)
        if judged is not None:
            session.judge(DriftJudged.keys[0], judged)

    def result(self, log: Log) -> Result:
        judged = log.verdict(DriftJudged)
        return {} if judged is None else {"tracker_drift": judged}


class Compared(Reflectors):
    """Each reflector in one nest, where a person is there to carry them."""

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        if cell.layout.by_hand:
            return PlannedStep(self.name, 0, 0.0, note="the cell has one reflector")
        return super().plan(cell, seed)

    def perform(self, session: CellSession) -> None:
        if not (session.cell.layout.by_hand or session.log.inputs.unattended):
            super().perform(session)

    def result(self, log: Log) -> Result:
        checked = InstrumentChecked.by(log.verdicts)
        proven = {} if checked is None else {"proven": {**checked._asdict(), "text": checked.text}}
        return {**super().result(log), "not_checked": list(_not_checked(log)), **proven}


def _not_checked(log: Log) -> Iterator[str]:
    axes = log.verdict(AxesJudged)
    if reason := one_face(log.cell):
        yield reason
    if axes is not None and axes.transit_urad is None:
        yield "the nests are at nearly one height: transit tilt and collimation are not separable"
    if missing := [each for each in DIRECTIONS if each not in directions(log)]:
        yield f"no certified length lies {', nor '.join(missing)}, seen from the tracker"
    if log.cell.layout.by_hand:
        yield "the cell has one reflector: there is none to compare it with"
    elif log.inputs.unattended:
        yield "nobody was there to carry the reflectors into one nest"


# -- the result ------------------------------------------------------------------------------------


class Row(NamedTuple):
    """A line of the result; a figure without a limit is not judged."""

    figure: Figure
    word: str


def rows(result: Result) -> Iterator[Row]:
    for name, kind in (("tracker_axes", AxesJudged), ("tracker_drift", DriftJudged)):
        if name in result:
            for each in typed(result[name], kind).figures:
                yield Row(each, "" if each.limit is None else each.outcome.text)
    ways = typed(result.get("length_directions", {}), dict[str, list[str]])
    way_of = {nests: way for way, every in ways.items() for nests in every}
    for length in typed(result.get("known_lengths", []), list[MeasuredLength]):
        nests = " to ".join(length.nests)
        off_mm = length.found_mm - length.wanted_mm
        figure = Figure(f"length {nests}, {way_of[nests]}", off_mm, U=length.U_mm)
        yield Row(figure, "agrees" if length.holds else "differs")
    for one in typed(result.get("reflectors", []), list[MeasuredReflector]):
        figure = Figure(
            f"reflector of {one.place}", math.hypot(one.along_mm, one.across_mm),
            limit=one.limit_mm, U=one.U_mm,
        )  # fmt: skip
        yield Row(figure, "agrees" if one.holds else "differs")


def table(result: Result) -> Table:
    return Table(
        [
            Column("figure", lambda row: row.figure.name),
            Column("value", lambda row: _shown(row.figure, row.figure.value)),
            Column("U (k = 2)", lambda row: _shown(row.figure, row.figure.U)),
            Column("limit", lambda row: _shown(row.figure, row.figure.limit)),
            Column("unit", lambda row: row.figure.unit),
            Column("", lambda row: row.word),
        ],
        rows(result),
        "Tracker",
    )


def _shown(figure: Figure, value: float | None) -> str:
    return "" if value is None else format(value, figure.form)


def words(result: Result) -> str:
    unchecked = typed(result.get("not_checked", []), list[str])
    return "\n".join(f"Not checked: {each}." for each in unchecked)


TRACKER_CHECK = Procedure(
    "tracker-check",
    "axes, scale and drift of the tracker, and its reflectors; nothing moves",
    (Nests(), Axes(), Drift(), Compared()),
    table,
    words=words,
)
