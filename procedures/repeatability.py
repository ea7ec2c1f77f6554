"""Repeatability of the robot, and whether it has changed.

Repeated visits give the error floor of any compensation, and RP (ISO 9283). Poses are re-visited
after the grid, so that nothing is built on a changed robot: vertices, and the base frame's
outermost poses, which detect a slipped mount; and at the end of the run, so that the robot is still
the calibrated one. After the grid a few vertices are approached from above as well, which shows the
joints' lost motion.
"""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np

from hilcell.calibration.changes import compared
from hilcell.calibration.diagnosis import CLOSING, REVISIT, SecondVisits, suspected_causes
from hilcell.calibration.grid import grid_of, vertex_ids
from hilcell.calibration.known_arm import carried_calibration
from hilcell.calibration.lost_motion import REVERSAL, reversal
from hilcell.calibration.position_errors import visit_scatter
from hilcell.cell.file import Cell
from hilcell.geometry.frames import apply
from hilcell.geometry.statistics import (
    figures_of,
    from_mean_mm,
    lengths_mm,
    repeatability_mm,
    rms,
    without_noise,
)
from hilcell.journal.log import Log, positions_mm, repeated_visits, variances_mm2
from hilcell.model.events import VisitedOnceMore
from hilcell.model.plan import PlannedStep
from hilcell.model.point import Point, PointId
from hilcell.model.results import Floor, Repeated
from hilcell.model.verdicts import Cause, ChangedSince, Revisited, Suspected
from hilcell.ports import Array
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Result
from procedures.base_frame import points_on_arc, sweep
from procedures.plan import (
    check_targets,
    closing,
    flange_points,
    joints_for,
    leg,
    poses_at,
    stations_in_order,
)
from procedures.robot_grid import chosen_rad, planned_rad

VISITS = 10


class Repeatability:
    """Visits three places of the cube many times, away and back, each time from below."""

    name = "repeatability"
    needs = "the grid's station held"
    moves = "the robot between the cube's centre and two corners"
    measures = "the flange reflector on every visit"
    yields = "the floor: repeatability and tracker noise alone"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Refuse places out of reach."""
        there = cell.reference
        places = poses_at(cell, self.places_mm(cell))
        places_rad = check_targets(cell, there, places, "repeatability place")
        visits_rad = np.tile(places_rad, (self.visits(cell), 1))
        return PlannedStep.of_spans(
            self.name, len(visits_rad), [flange_points(cell, visits_rad), *closing(cell)]
        )

    def perform(self, session: CellSession) -> None:
        """Go round the places, so that each visit comes from another one."""
        station = session.cell.reference
        joints = joints_for(session.cell, self.places_mm(session.cell))
        session.expect(station, np.vstack([joints[-1:], joints]))  # round and round
        for visit in range(self.visits(session.cell)):
            for place, target in enumerate(joints):
                id = PointId("repeatability", place=place, number=visit)
                session.flange_point(id, station, target)
        session.close_step()

    def result(self, log: Log) -> Result:
        return {"repeatability": self.repeated(log)}

    @staticmethod
    def visits(cell: Cell) -> int:
        return 3 if cell.plan.quick else VISITS

    @staticmethod
    def places_mm(cell: Cell) -> Array:
        """Return the places (P, 3) in {B}: the centre and two opposite corners, on a quick plan
        those that are re-visited next, which is one visit more of each.
        """
        if cell.plan.quick:
            return grid_of(cell).serpentine_mm()[revisited(cell)]
        centre = cell.grid.centre.matrix()[:3, 3]
        half = np.array(cell.grid.size_mm) / 2
        return np.array([centre, centre - half, centre + half])

    @staticmethod
    def _clouds(log: Log) -> list[list[Point]]:
        return repeated_visits(log)

    @staticmethod
    def distances_mm(log: Log) -> Array:
        """Distance of each visit from its place's mean, all places together (N,). The mean of n
        visits scatters too, so distances are multiplied by sqrt(n / (n - 1)).
        """
        clouds_mm = [positions_mm(place) for place in Repeatability._clouds(log)]
        return np.concatenate(
            [from_mean_mm(cloud) * np.sqrt(len(cloud) / (len(cloud) - 1)) for cloud in clouds_mm]
        )

    @staticmethod
    def repeated(log: Log) -> Repeated:
        """RP of the place where it is largest (ISO 9283, 7.2.2), and the radius of all together."""
        places, pooled_mm = Repeatability._clouds(log), Repeatability.distances_mm(log)
        radius_mm = repeatability_mm(pooled_mm)
        noise = [float(variances_mm2(points).sum(axis=1).mean()) for points in places]
        rp_mm = [repeatability_mm(from_mean_mm(positions_mm(points))) for points in places]
        worst = int(np.argmax(rp_mm))
        scatter_mm2 = float(np.trace(np.cov(positions_mm(places[worst]).T)))
        return Repeated(
            rp_mm=rp_mm[worst],
            rp_robot_mm=rp_mm[worst] * without_noise(scatter_mm2, noise[worst]),
            pooled_radius_mm=radius_mm,
            pooled_radius_robot_mm=radius_mm
            * without_noise(rms(pooled_mm) ** 2, float(np.mean(noise))),
            floor_mm=Repeatability.floor(log).mean,
        )

    @staticmethod
    def floor(log: Log) -> Floor:
        """Return mean and p95 of a perfect map's errors: one visit's distance from the mean. Of a
        re-calibration by the scatter that it carries.
        """
        if carried_calibration(log) is None:
            figures = figures_of(Repeatability.distances_mm(log))
        else:
            scatter_mm2, *_ = visit_scatter(log, np.eye(3))
            drawn = np.random.default_rng(9283).multivariate_normal(
                np.zeros(3), scatter_mm2, 10_000
            )
            figures = figures_of(lengths_mm(drawn))
        return Floor(mean=figures.mean, p95=figures.p95)


# -- poses that are re-visited ---------------------------------------------------------------------


class Visit(NamedTuple):
    """A pose that is visited again, by joints (6,) in rad: a vertex (3,) in {B}, or of a circle."""

    id: PointId
    joints_rad: Array
    vertex_mm: Array | None = None


class Revisits:
    """Takes poses that are spread over the time since the robot's first point."""

    needs = "the grid, the robot's repeatability"
    moves = "the robot to a few poses of base frame and grid"
    measures = "the flange reflector there, once more; at a few from above as well"
    yields = "whether zero, mount and slide are as they were, which cause fits if not, lost motion"

    def __init__(self, *, at_end: bool = False) -> None:
        """``at_end``: the slide comes from the last station, back to the grid's."""
        self._kind, self.name = (CLOSING, "closing") if at_end else (REVISIT, "revisits")

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Return the step: the grid's own has refused vertices out of reach."""
        poses = visits(cell, self._kind)
        if cell.plan.recalibrates:
            poses = revisited_poses(planned_rad(cell, seed))
        joints_rad = np.array([visit.joints_rad for visit in poses])
        spans = [flange_points(cell, joints_rad), *closing(cell)]
        if self._kind == CLOSING:
            spans = [*leg(cell, stations_in_order(cell)[-1], cell.reference), *spans]
        return PlannedStep.of_spans(self.name, len(joints_rad), spans)

    def perform(self, session: CellSession) -> None:
        cell, log = session.cell, session.log
        station, poses = cell.reference, visits(cell, self._kind)
        if cell.plan.recalibrates:
            poses = revisited_poses(chosen_rad(log))
        T_W_B = session.frames.base_in_world(station)
        while waiting := [visit for visit in poses if self._waits(log, visit.id)]:
            session.expect(station, np.array([visit.joints_rad for visit in waiting]))
            for id, joints_rad, vertex_mm in waiting:
                session.hold_station(station)
                if again := log.find(id) is not None:
                    session.add(VisitedOnceMore(key=id.key))
                nominal_mm = None if vertex_mm is None else apply(T_W_B, vertex_mm)
                session.flange_point(id, station, joints_rad, nominal_mm=nominal_mm, retake=again)
        session.close_step()
        newest = max(log.recorded(log.point(visit.id)) for visit in poses)
        judged = log.verdict_records.get(SecondVisits(log, self._kind).verdict_key)
        if judged is None or judged.seq < newest:
            self._judge(session)

    def _judge(self, session: CellSession) -> None:
        lost_motion = reversal(session.log) if self._kind == REVISIT else None
        second = SecondVisits(session.log, self._kind)
        found = second.change()
        if lost_motion is not None:
            session.judge("reversal", lost_motion)
        suspicion = second.recorded_cause or found.suspicion
        judged = Revisited(
            holds=found.holds and suspicion is None,
            ratio=found.ratio,
            limit=found.limit,
            suspicion=suspicion,
            suspected=[] if suspicion is None else [suspicion.text],
        )
        session.judge(second.verdict_key, judged)
        if self._kind == CLOSING:
            judge_suspicions(session)
        elif found.suspicion is not None:
            session.pause(f"re-visited poses have moved: {found.suspicion.text}")

    def result(self, log: Log) -> Result:
        """Return the lost motion, after the grid; at the end all that is suspected in the run."""
        if self._kind == CLOSING:
            return {"suspicions": suspected_causes(log)}
        lost_motion = reversal(log)
        if lost_motion is None:
            return {}
        figures: dict[str, object] = msgspec.to_builtins(lost_motion)
        del figures["holds"]
        return {"reversal": figures}

    def _waits(self, log: Log, id: PointId) -> bool:
        """Whether a pose waits to be visited, or to be visited once more."""
        point = log.find(id)
        return point is None or SecondVisits(log, self._kind).is_overtaken(point)


def visits(cell: Cell, kind: str) -> list[Visit]:
    """Poses in their order. After the grid, the base frame's come first, and the first few vertices
    are approached from above next, where the joints' limits allow it.
    """
    vertices_mm = grid_of(cell).serpentine_mm()
    joints_rad = joints_for(cell, vertices_mm)
    beyond_rad = joints_rad + cell.robot.approach_rad
    free = (beyond_rad <= cell.robot.margin_limits_rad[1]).all(axis=1)
    ids = vertex_ids(grid_of(cell))
    numbers = revisited(cell)
    sides = [n for n in numbers if free[n] and kind == REVISIT][: 2 if cell.plan.quick else 4]
    found = list[Visit]()
    if kind == REVISIT:  # ends of the base frame's sweeps; in a quick plan where it began
        last = points_on_arc(cell) - 1
        ends = [(1, 0)] if cell.plan.quick else [(1, 0), (1, last), (6, 0), (6, last)]
        found = [
            Visit(PointId(REVISIT, axis=axis, number=n), sweep(cell, axis)[n]) for axis, n in ends
        ]
    for n in numbers:
        below = PointId(kind, vertex=ids[n].vertex)
        above = PointId(REVERSAL, vertex=ids[n].vertex, side=1)
        sent = [below, above] if n in sides else [below]
        found += [Visit(id, joints_rad[n], vertices_mm[n]) for id in sent]
    return found


def revisited_poses(poses_rad: Array) -> list[Visit]:
    """Poses of a re-calibration's chosen ones (N, 6), at the end."""
    numbers = _spread(len(poses_rad), 3)
    return [Visit(PointId(CLOSING, number=n), poses_rad[n]) for n in numbers]


def revisited(cell: Cell) -> list[int]:
    """Return the numbers of the vertices that are re-visited."""
    return _spread(len(grid_of(cell).serpentine_mm()), 3 if cell.plan.quick else 12)


def _spread(count: int, most: int) -> list[int]:
    """Return numbers below a count: the first, and evenly on."""
    wanted = min(most, count)
    return [n * count // wanted for n in range(wanted)]


def judge_suspicions(session: CellSession) -> None:
    """Journal the run's suspicions. A change since the current calibration is a separate verdict:
    the operator decides which calibration is right.
    """
    found, before = suspected_causes(session.log), session.log.inputs.floor_before
    suspected = [each.text for each in found if each.cause is not Cause.CHANGED_SINCE]
    session.judge("suspicions", Suspected(holds=not suspected, suspected=suspected))
    risen = any(each.cause is Cause.NEST_MOVED for each in found)
    changes = compared(session.log, with_base=not risen)
    if before is not None and changes:
        changed = ChangedSince(
            holds=all(each.holds for each in changes),
            before=before.run,
            suspected=[each.text for each in found if each.cause is Cause.CHANGED_SINCE],
            beyond=[each for each in changes if not each.holds],
            compared=len(changes),
        )
        session.judge("since", changed)
