"""Random targets, measured before and after correction (sections 5.2-5.3, Figs 12-13)."""

from __future__ import annotations

import dataclasses
from itertools import product
from operator import itemgetter

import numpy as np
from msgspec.structs import replace

from hilcell.calibration.budget import coverages
from hilcell.calibration.decision_rule import (
    check_limits,
    class_warning,
    decide,
    guard_band,
    mean_warning,
    tolerance_limits,
)
from hilcell.calibration.from_run import learnt_so_far
from hilcell.calibration.grid import grid_of, measured_errors
from hilcell.calibration.influence import NoBound
from hilcell.calibration.orientation import (
    MOVED_MM,
    check_orientation_limit,
    largest_orientation_error,
    moved_on_flange_mm,
    orientation_coverages,
    validated_orientation_errors,
)
from hilcell.calibration.position_errors import judged_places, validation
from hilcell.calibration.touch import beside_nest
from hilcell.cell.file import Cell, Station
from hilcell.compensation.correction import corrected_poses
from hilcell.compensation.interpolation import Idw
from hilcell.compensation.model import ErrorModel
from hilcell.compensation.model_choice import MODELS
from hilcell.decoding import typed
from hilcell.geometry.frames import apply, inverse, matrix
from hilcell.geometry.statistics import Figures
from hilcell.journal.log import Log
from hilcell.model.plan import PlannedStep
from hilcell.model.point import BOTH, PointId, Sent
from hilcell.model.results import Place, SentErrors, TargetBounds
from hilcell.model.verdicts import OTHERS, VALIDATION, Oriented
from hilcell.ports import Array
from hilcell.present.table import Column, Named, Table, Value
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Result
from procedures import plan, quick_validation
from procedures.fit import orients
from procedures.repeatability import Repeatability, judge_suspicions
from procedures.station_frames import frame_spans, frame_station, nest_points
from procedures.touch_station import touch_once, touch_spans, touches

DRAWS = 8  # attempts at a target's orientation and position
MARGIN_MM = 5.0  # of random targets to the cube's faces


class Validate:
    """Every figure comes from targets commanded with that correction and measured."""

    name = "validate"
    needs = "the fitted correction, the stations framed"
    moves = "the slide from station to station, the robot to random targets in the cube"
    measures = "the reflectors on the flange at every target, before and with each correction"
    yields = "mean, p95 and maximum of the position error, and of the orientation's, per station"

    def announced(self, cell: Cell) -> str:
        return self.moves if cell.has_rail else "the robot to random targets in the cube"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Refuse targets out of reach, and limits that nothing could keep."""
        check_limits(cell)
        check_orientation_limit(cell)
        here, points, spans = cell.reference, 0, []
        T_W_T, ranges_mm = inverse(cell.tracker.pose.matrix()), list[float]()
        for name, poses in target_poses(cell, seed).items():
            station = cell.station_named(name)
            joints_rad = plan.check_targets(cell, station, poses, f"target at {name}")
            at_mm = apply(T_W_T @ cell.layout.nominal_base(station.strip_mm), poses[:, :3, 3])
            ranges_mm.append(float(np.linalg.norm(at_mm, axis=1).mean()))
            stays = cell.plan.quick and here == station  # since its base was framed
            if cell.plan.quick and not stays:  # one stop, to frame and to validate
                spans += frame_spans(cell, here, station, verifies=cell.layout.by_hand)
                points += nest_points(cell)
            else:
                spans += plan.leg(cell, here, station)
            for how in self._series(cell):
                touched = how == Sent.CHOSEN and not stays
                measured = touch_spans(cell, station) if touched else []
                sent_rad = joints_rad[: self._planned(cell)]
                measured.append(plan.flange_points(cell, sent_rad, seats=how in BOTH))
                count = sum(span.measured for span in measured)
                proofs = (
                    plan.closing(cell, carried=True, points=count)
                    if how in self._verified_after(cell, station)
                    else []
                )
                spans += [*measured, *proofs]
                points += count
            here = station
        found = PlannedStep.of_spans(self.name, points, spans)
        return dataclasses.replace(
            found, warning=class_warning(cell, min(ranges_mm)) or mean_warning(cell)
        )

    def perform(self, session: CellSession) -> None:
        cell, measured = session.cell, measured_errors(session.log)
        paper = Idw.learn(measured)
        chosen = MODELS[session.log.method].learn(measured)
        models = {Sent.IDW: paper, Sent.CHOSEN: chosen}
        for name, poses in target_poses(cell, session.seed).items():
            station = cell.station_named(name)
            frame_station(session, station, verifies=cell.layout.by_hand)
            for how in self._series(cell):
                every, quick = [range(len(poses))], cell.plan.quick
                for numbers in quick_validation.rounds(session.log, name) if quick else every:
                    self._send(session, station, how, numbers, poses, models.get(how))
                if quick:
                    quick_validation.record_guard(session, name)
                if how in self._verified_after(cell, station):
                    session.close_step(carried=True)
        self._judge(session)
        judge_suspicions(session)
        session.reach("validate")

    def _send(
        self,
        session: CellSession,
        station: Station,
        how: Sent,
        numbers: range,
        poses: Array,
        model: ErrorModel | None,
    ) -> None:
        ids = [PointId("validate", station=station.name, how=how, number=n) for n in numbers]
        seats = len(session.cell.robot.seats_mm) if how in BOTH else 1
        needed = [id.at_seat(seat) for id in ids for seat in range(1, seats + 1)]
        if all(session.log.find(id) for id in needed):
            return
        targets, T_W_B = poses[numbers], session.frames.base_in_world(station)
        nominal_mm = apply(T_W_B, targets[:, :3, 3])
        nominal_deg = plan.angles_deg(T_W_B, targets)
        joints_rad, visit = np.zeros((len(ids), 6)), -1
        for n, id in enumerate(ids):
            session.retake_waiting()  # at another station, it ends the visit
            session.hold_station(station)
            if visit != session.log.visit:
                sent = self._command(session, station, how, targets, model)
                joints_rad = session.cell.robot.nominal().joints_for(sent)
                session.expect(station, joints_rad[n:])
                visit = session.log.visit
            session.flange_point(
                id, station, joints_rad[n], nominal_mm=nominal_mm[n], nominal_deg=nominal_deg[n],
                seats=how in BOTH,
            )  # fmt: skip

    def _judge(self, session: CellSession) -> None:
        limits = tolerance_limits(session.cell)
        for where, stations in judged_places(session.cell).items():
            place = self._place_of(session.log, where, stations)
            orientations = validated_orientation_errors(session.log, stations).get(Sent.CHOSEN)
            errors = validation(session.log, stations)[Sent.CHOSEN]
            found = decide(
                place.chosen.mean,
                place.chosen.max,
                limits,
                guard_band(session.log, errors.error_mm),
                orientation=largest_orientation_error(session.log, orientations),
                sequential=place.decision,
            )
            session.judge(f"{VALIDATION}{where}", found)
        self._judge_orientation(session)

    def _judge_orientation(self, session: CellSession) -> None:
        stations = [station.name for station in session.cell.station]
        turns = validated_orientation_errors(session.log, stations)
        if set(BOTH) <= turns.keys() and orients(session.log):
            before, chosen = (turns[how].figures.mean_deg for how in BOTH)
            moved_mm = moved_on_flange_mm(session.log)
            holds = chosen < before and moved_mm <= MOVED_MM
            found = Oriented(
                holds=holds, before_mean_deg=before, mean_deg=chosen, reflectors_moved_mm=moved_mm
            )
            session.judge("orientation", found)

    def result(self, log: Log) -> Result:
        places, touched = judged_places(log.cell), touches(log)
        found = {where: self._place_of(log, where, stations) for where, stations in places.items()}
        for where, bounds in self._bounds(log, places).items():
            place = found[where]
            chosen = replace(place.chosen, bound95_mean=bounds.mean_mm, covered=bounds.coverage)
            found[where] = replace(place, chosen=chosen, bounds=bounds)
        return {"validation": found} | ({"touch": touched} if touched else {})

    @staticmethod
    def _bounds(log: Log, places: dict[str, list[str]]) -> dict[str, TargetBounds]:
        calibration = learnt_so_far(log)
        if calibration is None:
            return {}
        try:
            found = coverages(calibration, log, places)
            turns = orientation_coverages(calibration, log, places)
        except NoBound:  # the report says why
            return {}
        return {
            place: replace(each.figures, orientation=turns.get(place))
            for place, each in found.items()
        }

    @staticmethod
    def _command(
        session: CellSession, station: Station, how: Sent, poses: Array, model: ErrorModel | None
    ) -> Array:
        """Poses (N, 4, 4) in {B} to send, for those of the station frame's {B}.

        The targets' positions in {W} are fixed before the visit. The paper takes the robot's base
        from three slide points, the chosen model from the touch poses of this visit.
        """
        if model is None:
            return poses
        frames, targets_mm = session.frames, poses[:, :3, 3]
        if how == Sent.IDW:
            T_W_B = frames.carried("three_points", station)
            at_mm = apply(inverse(T_W_B) @ frames.base_in_world(station), targets_mm)
        else:
            if not session.frames.stays(station):
                touch_once(session, station, model)
            at_mm = frames.on_visit_mm(station, targets_mm)
        at = matrix(poses[:, :3, :3], at_mm)
        return corrected_poses(grid_of(session.cell), at, model)

    @staticmethod
    def _place_of(log: Log, where: str, stations: list[str]) -> Place:
        """Return the errors before, by the paper's method and by the chosen one, without bounds."""
        together = where in (log.cell.grid.station, OTHERS)
        series, turns = validation(log, stations), validated_orientation_errors(log, stations)
        sent = {
            how: SentErrors(
                **errors.figures._asdict(),
                orientation=turns[how].figures if how in turns else None,
            )
            for how, errors in series.items()
        }
        return Place(
            points=len(series[Sent.CHOSEN]),
            points_sent={how: len(errors) for how, errors in series.items()},
            before=sent[Sent.BEFORE],
            idw=sent.get(Sent.IDW),
            chosen=sent[Sent.CHOSEN],
            decision=quick_validation.judgement(log, stations) if log.cell.plan.quick else None,
            floor=Repeatability.floor(log) if together else None,
        )

    @staticmethod
    def _series(cell: Cell) -> tuple[Sent, ...]:
        """Series that are sent: in a quick plan the corrected targets, which show the error before
        as well.
        """
        return (Sent.CHOSEN,) if cell.plan.quick else tuple(Sent)

    @staticmethod
    def _verified_after(cell: Cell, station: Station) -> tuple[Sent, ...]:
        """Series after which the tracker is verified: all; with a reflector carried by hand the
        last of each station, in a quick plan that of each but the first.
        """
        if cell.layout.by_hand:
            return (Sent.CHOSEN,)
        if not cell.plan.quick:
            return tuple(Sent)
        return (Sent.CHOSEN,) if [station] == cell.station or station != cell.reference else ()

    @staticmethod
    def _planned(cell: Cell) -> int | None:
        """Return the number of targets that a station of a quick plan needs; None is all."""
        return quick_validation.planned_targets(cell) if cell.plan.quick else None

    @staticmethod
    def table(result: Result) -> Table:
        places, method = typed(result["validation"], dict[str, Place]), str(result["method"])
        rows = list[tuple[Value, ...]]()
        for where, place in places.items():
            judged = "" if place.decision is None else f", {place.decision.outcome.text}"
            named = {way: Named(way, way.text) for way in Sent}
            named[Sent.CHOSEN] = Named(f"chosen: {method}{judged}", f"{Sent.CHOSEN.text}{judged}")
            for way, errors in place.sent.items():
                figures = [getattr(errors, name) for name in Figures._fields]
                figures += [
                    getattr(errors.orientation, f"{name}_deg", None) for name in Figures._fields
                ]
                first = where if way is Sent.BEFORE else ""
                rows.append((first, place.points_sent.get(way), named[way], *figures))
            if place.floor is not None:  # the errors that are left
                left = place.floor.mean, place.floor.p95, None
                rows.append(("", None, Named("floor", "floor"), *left, None, None, None))
        oriented = any(place.before.orientation is not None for place in places.values())
        turns = Figures._fields if oriented else ()
        return Table(
            [
                Column("station", itemgetter(0)),
                Column("points", itemgetter(1), form="d"),
                Column("error of", itemgetter(2)),
                *(
                    Column(n, itemgetter(at), "mm", ".4f")
                    for at, n in enumerate(Figures._fields, 3)
                ),
                *(Column(f"turn {n}", itemgetter(at), "°", ".4f") for at, n in enumerate(turns, 6)),
            ],
            rows,
        )


def target_poses(cell: Cell, seed: int) -> dict[str, Array]:
    """Return the targets' poses (N, 4, 4) in {B} by station, reoriented as planned.

    A target without a reachable orientation keeps the grid's.
    """
    found = {
        name: plan.poses_at(cell, at_mm) for name, at_mm in _visible_targets(cell, seed).items()
    }
    if cell.plan.grid_orientations:
        others = plan.more_orientations(cell)
        for name, poses in found.items():  # in the orientations of the grid, alternating
            for number, R in enumerate(others, start=1):
                rows = np.arange(number, len(poses), len(others) + 1)
                tried = matrix(R, poses[rows, :3, 3])
                ok = plan.drivable(cell, cell.station_named(name), tried)
                poses[rows[ok]] = tried[ok]
    if cell.plan.tilt_deg:
        rng = np.random.default_rng([seed, 2015])
        for name, poses in found.items():
            found[name] = _tilted(cell, cell.station_named(name), poses, rng)
    return found


def _visible_targets(cell: Cell, seed: int) -> dict[str, Array]:
    """Return the targets (N, 3) in {B} by station, drawn again where a nest is too near."""
    found, station = targets(cell, seed), cell.station_named
    for draw in range(DRAWS):
        beside = {name: beside_nest(cell, station(name), at_mm) for name, at_mm in found.items()}
        if not any(rows.any() for rows in beside.values()):
            break
        fresh = targets(cell, int(np.random.SeedSequence([seed, draw]).generate_state(1)[0]))
        for name, rows in beside.items():
            found[name][rows] = fresh[name][rows]
    return found


def _tilted(cell: Cell, station: Station, poses: Array, rng: np.random.Generator) -> Array:
    """Return poses (N, 4, 4), each reoriented by up to the plan's tilt about any axis."""
    poses, left = poses.copy(), np.arange(len(poses))
    for _ in range(DRAWS):
        turns = rng.standard_normal((len(left), 3))
        turns *= np.radians(cell.plan.tilt_deg) / np.linalg.norm(turns, axis=1, keepdims=True)
        tried = plan.reoriented(poses[left], turns * rng.uniform(size=(len(left), 1)) ** (1 / 3))
        ok = plan.drivable(cell, station, tried)
        poses[left[ok]] = tried[ok]
        left = left[~ok]
    return poses


def targets(cell: Cell, seed: int) -> dict[str, Array]:
    """Return random targets (N, 3) in {B} by station, the grid's first, stratified by grid cell."""
    rng, grid = np.random.default_rng([seed, 2014]), grid_of(cell)
    if cell.plan.quick:
        low_mm, high_mm = grid.origin_mm + MARGIN_MM, grid.far_mm - MARGIN_MM
        return quick_validation.octant_targets(cell, seed, low_mm, high_mm)

    def draw(cells: list[tuple[int, ...]]) -> Array:
        inside = rng.uniform(size=(len(cells), 3))
        low = grid.origin_mm + np.array(cells) * grid.pitch_mm
        faces = (grid.origin_mm, grid.origin_mm + np.array(cell.grid.size_mm))
        drawn: Array = low + inside * grid.pitch_mm
        return np.clip(drawn, faces[0] + MARGIN_MM, faces[1] - MARGIN_MM)

    cells = list(product(*(range(count - 1) for count in grid.shape)))
    reference, *others = (station.name for station in plan.stations_in_order(cell))
    drawn = {reference: draw(cells * cell.validation.per_cell)}
    for number, name in enumerate(others):
        share = cell.validation.others // len(others)
        share += number < cell.validation.others % len(others)
        rounds = -(-share // len(cells))
        drawn[name] = draw((cells * rounds)[:share])
    return drawn
