"""The data of the correction: the robot's error on a grid, and at chosen poses beside it.

The grid's vertices are visited at one station (section 5.2, Fig 11). The chosen poses are those of
many candidates that lower the predicted bound in the cube fastest, given grid and sweeps, with free
position and orientation, until it is low enough.

Everything is linear and Gaussian: poses and positions of the volume are rows of the identification,
and a measurement changes the parameters' covariance by a known amount beforehand (I-optimal design:
least mean variance of the predictions; Pukelsheim 2006, "Optimal Design of Experiments", chapter
9). Greedy: each pose is the best one after those before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Self

import numpy as np

from hilcell.calibration.grid import (
    ORIENTED,
    grid_of,
    measured_errors,
    outlying_vertices,
    vertex_ids,
)
from hilcell.calibration.known_arm import known_arm
from hilcell.calibration.lookup import calibration_named
from hilcell.cell.file import Cell, Station
from hilcell.compensation.kinematic import Kinematic
from hilcell.geometry.frames import apply, matrix, to_rotvec
from hilcell.geometry.kinematics import forward
from hilcell.geometry.statistics import bounds95_mm
from hilcell.identification.known_arm import KnownArm
from hilcell.identification.measured_poses import IdentificationError
from hilcell.journal.log import Log
from hilcell.model.events import NoPosesChosen, OutlierRemeasured, PosesChosen
from hilcell.model.plan import PlannedStep
from hilcell.model.point import PointId
from hilcell.ports import Array, HilcellError
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Result, Step
from procedures import plan
from procedures.recalibration import CARRIED, TABLE, arm_in, followed

# Identity, joints (6,) in rad, nominal position (3,) and angles (3,) in {W}.
Vertex = tuple[PointId, Array, Array, Array]


class RobotGrid(Step):
    """Visits the vertices in serpentine order, every axis from below, and records the joints. An
    outlier among its neighbours is measured once more; the second measurement counts.
    """

    name = "robot-grid"
    needs = "world and base frame, the grid's station held"
    moves = "the robot"
    measures = "the reflectors on the flange at every vertex"
    yields = "the position error on the grid, the orientation's with several reflectors"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Refuse vertices out of reach, out of limits or out of sight, at any station."""
        vertices_mm = grid_of(cell).serpentine_mm()
        there = cell.reference
        if cell.plan.recalibrates:
            return PlannedStep(self.name, 0, 0.0, note=CARRIED)
        joints_rad = plan.check_targets(
            cell, there, plan.poses_at(cell, vertices_mm), "grid vertex"
        )
        for station in cell.station:
            world_mm = apply(cell.layout.nominal_base(station.rail_mm), vertices_mm)
            plan.check_range(cell, world_mm, f"grid at {station.name}")
        sent_rad = [joints_rad]
        self._check_orientations(cell)
        for n, R in enumerate(plan.more_orientations(cell)):
            what = f"grid vertex in orientation {self._named(cell.plan.grid_orientations[n])}"
            sent_rad.append(plan.check_targets(cell, there, matrix(R, vertices_mm), what))
        points = len(vertices_mm) * len(sent_rad) * len(cell.robot.seats_mm)
        measured = plan.flange_points(cell, np.concatenate(sent_rad), seats=True)
        return PlannedStep.of_spans(
            self.name, points, [measured, *plan.closing(cell, carried=True, points=points)]
        )

    def perform(self, session: CellSession) -> None:
        cell, station = session.cell, session.cell.reference
        if cell.plan.recalibrates:
            session.reach("measure_grid")
            return
        vertices_mm, ids = grid_of(cell).serpentine_mm(), vertex_ids(grid_of(cell))
        T_W_B = session.frames.base_in_world(station)
        vertices = self._sent(cell, T_W_B, ids, plan.poses_at(cell, vertices_mm))
        self._measure_all(session, station, vertices)
        for each in self._doubtful(session, vertices):
            self._measure(session, station, each, retake=True)
        for number, R in enumerate(plan.more_orientations(cell), start=1):
            again = [PointId(ORIENTED, vertex=id.vertex, place=number) for id in ids]
            self._measure_all(
                session, station, self._sent(cell, T_W_B, again, matrix(R, vertices_mm))
            )
        session.close_step(carried=True)
        session.reach("measure_grid")

    def _measure_all(self, session: CellSession, station: Station, vertices: list[Vertex]) -> None:
        session.expect(station, np.array([joints_rad for _, joints_rad, *_ in vertices]))
        for each in vertices:
            self._measure(session, station, each)

    def _measure(
        self, session: CellSession, station: Station, vertex: Vertex, *, retake: bool = False
    ) -> None:
        id, joints_rad, at_mm, at_deg = vertex
        session.flange_point(
            id, station, joints_rad, nominal_mm=at_mm, nominal_deg=at_deg, retake=retake, seats=True
        )

    def _doubtful(self, session: CellSession, vertices: list[Vertex]) -> list[Vertex]:
        """Return the outlying vertices that were not re-measured yet."""
        ids = set(outlying_vertices(session.log))
        doubtful = [v for v in vertices if v[0] in ids and not session.log.point(v[0]).retaken]
        for id, *_ in doubtful:
            for seat in range(1, len(session.cell.robot.seats_mm) + 1):
                session.add(OutlierRemeasured(key=id.at_seat(seat).key))
        return doubtful

    @staticmethod
    def _check_orientations(cell: Cell) -> None:
        """Raise `HilcellError` for equal orientations, or the grid's own: they add nothing."""
        of = cell.grid.centre.matrix()[None, :3, :3]
        found = np.concatenate([of, plan.more_orientations(cell)])
        names = ["the grid's own", *map(RobotGrid._named, cell.plan.grid_orientations)]
        for n, m in combinations(range(len(found)), 2):
            same_rad = 1e-4  # nearer orientations are one
            if not float(np.linalg.norm(to_rotvec(found[n].T @ found[m]))) > same_rad:
                raise HilcellError(
                    f"plan.grid_orientations: {names[m]} is the same orientation as {names[n]}: "
                    "the vertices would be measured twice in it; leave one out",
                    code="HC-C10",
                )

    @staticmethod
    def _sent(cell: Cell, T_W_B: Array, ids: list[PointId], poses: Array) -> list[Vertex]:
        joints_rad = cell.robot.nominal().joints_for(poses)
        world_mm, world_deg = apply(T_W_B, poses[:, :3, 3]), plan.angles_deg(T_W_B, poses)
        return list(zip(ids, joints_rad, world_mm, world_deg, strict=True))

    @staticmethod
    def _named(angles_deg: Sequence[float]) -> str:
        a, b, c = angles_deg
        return f"A {a:g}°, B {b:g}°, C {c:g}°"


CANDIDATES = 128


class ChosenPoses:
    """Drives to the most informative poses: beside the grid of a quick or a reoriented plan, or
    those that tell in a re-calibration how the arm has changed.
    """

    name = "chosen-poses"
    needs = "the grid, and the sweeps where there are any"
    moves = "the robot in the cube, the tool reoriented"
    measures = "the reflectors on the flange at every chosen pose"
    yields = "more certain kinematics"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Return the poses that are measured in any case: how many more, only the grid tells."""
        least, _ = cell.plan.pose_counts
        if not least:
            return PlannedStep(self.name, 0, 0.0)
        known = cell.plan.recalibrates
        joints_rad = planned_rad(cell, seed) if known else candidates_rad(cell)[:least]
        joints_rad = joints_rad[plan.nearest_next(cell, joints_rad)]
        measured = plan.flange_points(cell, joints_rad, seats=True)
        points = len(joints_rad) * len(cell.robot.seats_mm)
        return PlannedStep.of_spans(self.name, points, [measured, *plan.closing(cell)])

    def perform(self, session: CellSession) -> None:
        if not any(session.cell.plan.pose_counts):
            return
        if not session.log.happened(PosesChosen):
            self._choose(session)
        station = session.cell.reference
        joints_rad = chosen_rad(session.log)
        nominal_mm = forward(session.cell.robot.arm(), joints_rad)[:, :3, 3]
        world_mm = apply(session.frames.base_in_world(station), nominal_mm)
        for number, (joints, at_mm) in enumerate(zip(joints_rad, world_mm, strict=True)):
            id = PointId("pose", number=number)
            session.flange_point(id, station, joints, nominal_mm=at_mm, seats=True)
        session.close_step()
        if session.cell.plan.recalibrates:
            followed(session.log)  # or refused

    def _choose(self, session: CellSession) -> None:
        joints_rad = candidates_rad(session.cell)
        try:
            if session.cell.plan.recalibrates:
                joints_rad, found = telling(session.cell, arm_in(session.log), session.seed)
            else:
                found = choice(session.log, joints_rad)
        except IdentificationError as error:
            found = Design([], [])
            session.add(NoPosesChosen(reason=str(error), error=error.facts()))
        chosen = joints_rad[found.chosen]
        chosen_deg = np.degrees(chosen[plan.nearest_next(session.cell, chosen)])
        session.add(PosesChosen(joints_deg=chosen_deg.tolist(), bounds_mm=found.bounds_mm))

    def result(self, log: Log) -> Result:
        """Return the mean 95 % bound over the cube as predicted before and after each pose."""
        if not any(log.cell.plan.pose_counts):
            return {}
        bounds_mm = [each.bounds_mm for each in log.happened(PosesChosen)]
        return {"chosen_poses": {"bounds_mm": bounds_mm[0] if bounds_mm else []}}


def choice(log: Log, joints_rad: Array) -> Design:
    """Return which of the candidates (N, 6) to measure; raises `IdentificationError`."""
    cell, measured = log.cell, measured_errors(log)
    model = Kinematic.learn(measured)
    reading_mm2 = np.nanmean(measured.poses.covariance_mm2, axis=0)
    return design(
        Rows.of(model, joints_rad, reading_mm2),
        Rows.of(model, judged_rad(cell), np.zeros((3, 3))),
        model.covariance,
        bound_mm=cell.plan.bound_mm,
        counts=cell.plan.pose_counts,
    )


def planned_rad(cell: Cell, seed: int) -> Array:
    """Return the joints (N, 6) of the poses that a re-calibration will choose, in their order."""
    joints_rad, found = telling(cell, known_arm(calibration_named(cell, TABLE)), seed)
    chosen = joints_rad[found.chosen]
    return chosen[plan.nearest_next(cell, chosen)]


def chosen_rad(log: Log) -> Array:
    """Return the joints (N, 6) of the poses that a run has chosen."""
    return np.radians(log.happened(PosesChosen)[-1].joints_deg).reshape(-1, 6)


def telling(cell: Cell, arm: KnownArm, seed: int) -> tuple[Array, Design]:
    """Candidates (N, 6), and those of them that tell most of a known arm."""
    drawn, exactly = _evenly_spread(CANDIDATES, 6), np.zeros((3, 3))
    # elsewhere each time: the same poses would repeat the errors that no parameter describes
    drawn = (drawn + np.random.default_rng([seed, 231]).uniform(size=6)) % 1.0
    joints_rad = _drivable_rad(cell, drawn, cell.plan.tilt_deg)
    return joints_rad, design(
        Rows.of(arm, joints_rad, exactly),
        Rows.of(arm, judged_rad(cell), exactly),
        arm.prior(arm.typical),
        bound_mm=cell.plan.bound_mm,
        counts=cell.plan.pose_counts,
    )


def candidates_rad(cell: Cell) -> Array:
    """Return joints (N, 6) of drivable poses in the cube, every other one reoriented."""
    drawn = _evenly_spread(CANDIDATES, 6)
    drawn[::2, 3:] = 0.5
    return _drivable_rad(cell, drawn, max(cell.plan.turn_deg, cell.plan.tilt_deg))


def judged_rad(cell: Cell) -> Array:
    """Return joints (N, 6) of poses like the targets', over which predictions are to be certain."""
    if not cell.plan.tilt_deg:
        return plan.joints_for(cell, _places_mm(cell, _evenly_spread(64, 3)))
    return _drivable_rad(cell, _evenly_spread(64, 6), cell.plan.tilt_deg)


def _drivable_rad(cell: Cell, drawn: Array, turn_deg: float) -> Array:
    """Return joints (M, 6) of drawn poses (N, 6) that can be driven to: place and turn, 0..1."""
    turns_rad = (2.0 * drawn[:, 3:] - 1.0) * np.radians(turn_deg) / np.sqrt(3.0)
    poses = plan.reoriented(plan.poses_at(cell, _places_mm(cell, drawn[:, :3])), turns_rad)
    return cell.robot.nominal().joints_for(poses[plan.drivable(cell, cell.reference, poses)])


def _places_mm(cell: Cell, shares: Array) -> Array:
    grid = grid_of(cell)
    return grid.origin_mm + shares * (grid.far_mm - grid.origin_mm)


def _evenly_spread(count: int, dimensions: int) -> Array:
    """Return points (N, D) that fill the unit cube evenly, however few (Roberts' sequence)."""
    root = 2.0
    for _ in range(50):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    steps = root ** -np.arange(1.0, dimensions + 1)
    return np.asarray((0.5 + np.outer(np.arange(1, count + 1), steps)) % 1.0)


@dataclass(frozen=True, eq=False)
class Rows:
    """M positions: derivatives by P parameters (M, 3, P), and additional scatter ``noise_mm2`` (M,
    3, 3).
    """

    by_parameter: Array
    noise_mm2: Array

    @classmethod
    def of(cls, model: Kinematic | KnownArm, joints_rad: Array, reading_mm2: Array) -> Self:
        """Return the reflector's positions at joints (N, 6), read with a covariance (3, 3)."""
        found = model.kinematics.linearised(model.state, joints_rad)
        one = (len(joints_rad), 1)
        own_mm2 = np.broadcast_to(reading_mm2, (*one, 3, 3))
        noise_mm2 = model.noise.covariance(found.by_joint[:, :1], own_mm2, np.ones(one, dtype=bool))
        return cls(found.by_parameter[:, 0], noise_mm2)

    def covariance_mm2(self, covariance: Array) -> Array:
        """Return the positions' covariances (M, 3, 3) by that of the parameters (P, P)."""
        J = self.by_parameter
        return J @ covariance @ np.swapaxes(J, 1, 2) + self.noise_mm2

    def gains_mm2(self, covariance: Array, weight: Array) -> Array:
        """Return by how much each candidate (M,) would lower the mean variance over the volume."""
        J = self.by_parameter
        carried = J @ covariance
        spread_mm2 = carried @ np.swapaxes(J, 1, 2) + self.noise_mm2
        lowered = carried @ weight @ np.swapaxes(carried, 1, 2)
        gains: Array = np.trace(np.linalg.solve(spread_mm2, lowered), axis1=1, axis2=2)
        return gains

    def mean_bound_mm(self, covariance: Array) -> float:
        """Return the mean 95 % bound of the positions."""
        return float(bounds95_mm(self.covariance_mm2(covariance)).mean())


@dataclass(frozen=True, eq=False)
class Design:
    """Chosen candidates in their order, and the mean 95 % bound before and after each (mm)."""

    chosen: list[int]
    bounds_mm: list[float]


def design(
    candidates: Rows, volume: Rows, covariance: Array, *, bound_mm: float, counts: tuple[int, int]
) -> Design:
    """Poses to measure until the mean bound over the volume is at most ``bound_mm``. Or until more
    of them would gain little; but between the least and the most of ``counts``.
    """
    count = len(volume.by_parameter)
    rows = volume.by_parameter.reshape(-1, volume.by_parameter.shape[-1])
    weight = rows.T @ rows / count
    rest = 1.1  # of the bound that is left with all parameters known: below, poses gain little
    enough_mm = max(bound_mm, rest * volume.mean_bound_mm(np.zeros_like(covariance)))
    chosen: list[int] = []
    bounds_mm = [volume.mean_bound_mm(covariance)]
    least, most = (min(each, len(candidates.by_parameter)) for each in counts)
    while len(chosen) < least or (bounds_mm[-1] > enough_mm and len(chosen) < most):
        gains_mm2 = candidates.gains_mm2(covariance, weight)
        gains_mm2[chosen] = -1.0  # a second visit says less about what no parameter describes
        best = int(np.argmax(gains_mm2))
        J, noise_mm2 = candidates.by_parameter[best], candidates.noise_mm2[best]
        carried = J @ covariance
        spread_mm2 = carried @ J.T + noise_mm2
        updated: Array = covariance - carried.T @ np.linalg.solve(spread_mm2, carried)
        covariance = 0.5 * (updated + updated.T)
        chosen.append(best)
        bounds_mm.append(volume.mean_bound_mm(covariance))
    return Design(chosen, bounds_mm)
