"""Random targets are sent and measured, before and after (sections 5.2-5.3, Figs 12-13)."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from hilcell.calibration.errors import HOWS, validation
from hilcell.calibration.frames import grid_of, measured_of
from hilcell.cell.file import Cell, Station
from hilcell.compensation.choice import MODELS
from hilcell.compensation.correction import corrected
from hilcell.compensation.model import ErrorModel
from hilcell.geometry.frames import apply, inverse
from hilcell.journal.log import Log
from hilcell.journal.point_id import PointId
from hilcell.ports import Array
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Step
from procedures.durations import flange_points, floor_points, leg, step
from procedures.plan import check_reach, joints_for, poses_at
from procedures.repeatability import floor
from procedures.touch import base_for_commands, touch_result, touch_spans
from procedures.world_frame import check_control_points

MARGIN_MM = 5.0  # random targets keep off the cube's faces by this much


class Validate:
    """Every figure comes from targets really sent with that correction and then measured."""

    name = "validate"
    needs = "the fitted correction, the stations framed"
    moves = "the slide from station to station, the robot to random targets in the cube"
    measures = "the flange reflector at every target, before and with each correction"
    yields = "mean, p95 and maximum of the position error per station"

    def plan(self, cell: Cell, seed: int) -> Step:
        """Refuse targets out of reach."""
        here, points, spans = cell.station_named(cell.grid.station), 0, []
        for name, targets_mm in targets(cell, seed).items():
            station = cell.station_named(name)
            joints_rad = check_reach(cell, targets_mm, f"target at {name}")
            one_way = [floor_points(cell), flange_points(cell, joints_rad)]
            touches = touch_spans(cell)
            spans += [leg(cell, here, station), *2 * one_way, one_way[0], *touches, one_way[1]]
            points += len(HOWS) * len(targets_mm) + sum(span.measured for span in touches)
            here = station
        return step(self.name, points, spans)

    def perform(self, session: CellSession) -> None:
        """Validate at the grid's station, then at the others with transferred data."""
        measured = measured_of(session.log)
        paper = MODELS["idw"].learn(measured)
        chosen = MODELS[str(session.log.verdicts["fit"]["method"])].learn(measured)
        models = {"idw": paper, "chosen": chosen}
        for name, targets_mm in targets(session.cell, session.seed).items():
            station = session.cell.station_named(name)
            for how in HOWS:
                self._send(session, station, how, targets_mm, models.get(how))
        self._judge(session)
        session.reach("validate")

    def _send(
        self,
        session: CellSession,
        station: Station,
        how: str,
        targets_mm: Array,
        model: ErrorModel | None,
    ) -> None:
        ids = [
            PointId("validate", station=station.name, how=how, number=n)
            for n in range(len(targets_mm))
        ]
        if all(session.log.find(id) for id in ids):
            return
        # Where the reflector is carried by hand, the tracker is proven once a station.
        if not session.log.find(ids[0]) and (how == "before" or not session.cell.layout.by_hand):
            check_control_points(session)
        nominal_mm = apply(session.frames.base_in_world(station), targets_mm)
        joints_rad, visit = np.zeros((len(ids), 6)), -1
        for n, id in enumerate(ids):
            session.retake_waiting()  # at another station, it ends the visit
            session.hold_station(station)
            if visit != session.log.visit:
                sent_mm = command(session, station, how, targets_mm, model)
                joints_rad = joints_for(session.cell, sent_mm)
                visit = session.log.visit
            session.flange_point(id, station, joints_rad[n], nominal_mm=nominal_mm[n])

    def _judge(self, session: CellSession) -> None:
        limits = session.cell.validation
        for where, figures in self.result(session.log)["validation"].items():
            chosen = figures["chosen"]
            holds = (
                chosen["mean"] <= limits.mean_tolerance_mm
                and chosen["max"] <= limits.max_tolerance_mm
            )
            session.verdict(
                f"validation.{where}",
                holds=holds,
                mean_mm=chosen["mean"],
                mean_tolerance_mm=limits.mean_tolerance_mm,
                max_mm=chosen["max"],
                max_tolerance_mm=limits.max_tolerance_mm,
            )

    def result(self, log: Log) -> dict[str, Any]:
        """Return the errors at the grid's station and at the others together."""
        reference = log.cell.grid.station
        others = [station.name for station in log.cell.station if station.name != reference]
        places = {reference: [reference]}
        places |= ({"others": others} if others else {}) | {name: [name] for name in others}
        figures = {where: station_figures(log, names) for where, names in places.items()}
        for where in (reference, "others"):
            if where in figures:
                figures[where]["floor"] = floor(log)
        return {"validation": figures} | touch_result(log)


def command(
    session: CellSession, station: Station, how: str, targets_mm: Array, model: ErrorModel | None
) -> Array:
    """Return where to send the robot, (N, 3) in {B}, for targets (N, 3) of the station frame's {B}.

    The targets' places in {W} are fixed before the visit. The paper takes the robot's base from
    three slide points, the chosen way from the touch poses of this visit.
    """
    if model is None:
        return targets_mm
    frames = session.frames
    if how == "idw":
        T_W_B = frames.base_by_three_points(station)
    else:
        T_W_B = base_for_commands(session, station, model)
    at_mm = apply(inverse(T_W_B) @ frames.base_in_world(station), targets_mm)
    return corrected(grid_of(session.cell), poses_at(session.cell, at_mm), model)


def station_figures(log: Log, stations: list[str]) -> dict[str, Any]:
    """Return mean, p95 and max of |e| before, by the paper's method and by the chosen one."""
    series = validation(log, stations)
    figures = {how: errors.figures._asdict() for how, errors in series.items()}
    return {"points": len(series["chosen"]), **figures}


def targets(cell: Cell, seed: int) -> dict[str, Array]:
    """Return random targets (N, 3) in {B} by station, the grid's first, stratified by grid cell."""
    reference = cell.grid.station
    rng = np.random.default_rng([seed, 2014])
    grid = grid_of(cell)
    cells = list(product(*(range(count - 1) for count in grid.shape)))
    drawn = {reference: _draw(rng, cell, cells * cell.validation.per_cell)}
    others = [station.name for station in cell.station if station.name != reference]
    for number, name in enumerate(others):
        share = cell.validation.others // len(others)
        share += number < cell.validation.others % len(others)
        rounds = -(-share // len(cells))
        drawn[name] = _draw(rng, cell, (cells * rounds)[:share])
    return drawn


def _draw(rng: np.random.Generator, cell: Cell, cells: list[tuple[int, ...]]) -> Array:
    grid = grid_of(cell)
    inside = rng.uniform(size=(len(cells), 3))
    low = grid.origin_mm + np.array(cells) * grid.pitch_mm
    faces = (grid.origin_mm, grid.origin_mm + np.array(cell.grid.size_mm))
    drawn: Array = low + inside * grid.pitch_mm
    return np.clip(drawn, faces[0] + MARGIN_MM, faces[1] - MARGIN_MM)
