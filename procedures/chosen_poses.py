"""Poses beside the grid, chosen by what is known of the robot after grid and sweeps.

Each is the one of many candidates that makes the predicted errors in the cube certain soonest;
positions and the tool's turn are free. It ends when the predicted bound is low enough.
"""

from __future__ import annotations

import numpy as np

from hilcell.calibration.frames import grid_of, measured_of
from hilcell.cell.file import Cell
from hilcell.compensation.kinematic import Kinematic
from hilcell.geometry.frames import apply
from hilcell.geometry.kinematics import forward
from hilcell.identification.design import Design, Rows, design
from hilcell.identification.readings import IdentificationError
from hilcell.journal.log import Log
from hilcell.model.events import NoPosesChosen, PosesChosen
from hilcell.model.plan import Step
from hilcell.model.point import PointId
from hilcell.ports import Array
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Result
from procedures.durations import closing, flange_count, flange_points, step
from procedures.plan import drivable, joints_for, poses_at, turned

CANDIDATES, PLACES = 128, 64


class ChosenPoses:
    """Drives to the poses that say most beside the grid: of a quick plan, or of turned targets."""

    name = "chosen-poses"
    needs = "the grid, and the sweeps where there are any"
    moves = "the robot in the cube, the tool turned"
    measures = "the reflectors on the flange at every chosen pose"
    yields = "more certain kinematics"

    def plan(self, cell: Cell, seed: int) -> Step:
        """Return the longest that it may take: which poses, only the grid's errors tell."""
        most = cell.plan.pose_counts[1]
        if not most:
            return Step(self.name, 0, 0.0)
        joints_rad = candidates_rad(cell)[:most]
        measured = flange_points(cell, joints_rad, seats=True)
        points = flange_count(cell, len(joints_rad))
        return step(self.name, points, [measured, *closing(cell)])

    def perform(self, session: CellSession) -> None:
        """Choose once, then measure."""
        if not any(session.cell.plan.pose_counts):
            return
        event = _chosen(session.log) or self._choose(session)
        station = session.cell.station_named(session.cell.grid.station)
        joints_rad = np.radians(event.joints_deg).reshape(-1, 6)
        nominal_mm = forward(session.cell.robot.arm(), joints_rad)[:, :3, 3]
        world_mm = apply(session.frames.base_in_world(station), nominal_mm)
        for number, (joints, at_mm) in enumerate(zip(joints_rad, world_mm, strict=True)):
            id = PointId("pose", number=number)
            session.flange_point(id, station, joints, nominal_mm=at_mm, seats=True)
        session.close_step()

    def _choose(self, session: CellSession) -> PosesChosen:
        joints_rad = candidates_rad(session.cell)
        try:
            found = choice(session.log, joints_rad)
        except IdentificationError as error:
            found = Design([], [])
            session.add(NoPosesChosen(reason=str(error), error=error.facts()))
        chosen_deg = np.degrees(joints_rad[found.chosen])
        chosen = PosesChosen(joints_deg=chosen_deg.tolist(), bounds_mm=found.bounds_mm)
        session.add(chosen)
        return chosen

    def result(self, log: Log) -> Result:
        """Return the mean 95 % bound over the cube as predicted before and after each pose."""
        if not any(log.cell.plan.pose_counts):
            return {}
        event = _chosen(log)
        return {"chosen_poses": {"bounds_mm": event.bounds_mm if event else []}}


def choice(log: Log, joints_rad: Array) -> Design:
    """Return which of the candidates (N, 6) to measure; raises `IdentificationError`."""
    plan, cell = log.cell.plan, log.cell
    measured = measured_of(log)
    model = Kinematic.learn(measured)
    reading_mm2 = np.nanmean(measured.poses.covariance_mm2, axis=0)
    return design(
        rows_of(model, joints_rad, reading_mm2),
        rows_of(model, judged_rad(cell), np.zeros((3, 3))),
        model.covariance,
        bound_mm=plan.bound_mm,
        counts=plan.pose_counts,
    )


def rows_of(model: Kinematic, joints_rad: Array, reading_mm2: Array) -> Rows:
    """Return the reflector's positions at joints (N, 6) as rows, read with a covariance (3, 3)."""
    found = model.kinematics.linearised(model.state, joints_rad)
    one = (len(joints_rad), 1)
    own_mm2 = np.broadcast_to(reading_mm2, (*one, 3, 3))
    noise_mm2 = model.noise.covariance(found.by_joint[:, :1], own_mm2, np.ones(one, dtype=bool))
    return Rows(found.by_parameter[:, 0], noise_mm2)


def candidates_rad(cell: Cell) -> Array:
    """Return joints (N, 6) of poses in the cube that can be driven to, each other one turned."""
    drawn = _spread(CANDIDATES, 6)
    drawn[::2, 3:] = 0.5
    return _driven_rad(cell, drawn, max(cell.plan.turn_deg, cell.plan.tilt_deg))


def judged_rad(cell: Cell) -> Array:
    """Return joints (N, 6) of poses like the targets', over which predictions are to be certain."""
    if not cell.plan.tilt_deg:
        return joints_for(cell, _places_mm(cell, _spread(PLACES, 3)))
    return _driven_rad(cell, _spread(PLACES, 6), cell.plan.tilt_deg)


def _driven_rad(cell: Cell, drawn: Array, turn_deg: float) -> Array:
    """Return joints (M, 6) of drawn poses (N, 6) that can be driven to: place and turn, 0..1."""
    turns_rad = (2.0 * drawn[:, 3:] - 1.0) * np.radians(turn_deg) / np.sqrt(3.0)
    poses = turned(poses_at(cell, _places_mm(cell, drawn[:, :3])), turns_rad)
    station = cell.station_named(cell.grid.station)
    return cell.robot.nominal().joints_for(poses[drivable(cell, station, poses)])


def _places_mm(cell: Cell, shares: Array) -> Array:
    grid = grid_of(cell)
    return grid.origin_mm + shares * (grid.far_mm - grid.origin_mm)


def _chosen(log: Log) -> PosesChosen | None:
    return next(iter(log.happened(PosesChosen)), None)


def _spread(count: int, dimensions: int) -> Array:
    """Return points (N, D) that fill the unit cube evenly, however few (Roberts' sequence)."""
    root = 2.0
    for _ in range(50):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    steps = root ** -np.arange(1.0, dimensions + 1)
    return np.asarray((0.5 + np.outer(np.arange(1, count + 1), steps)) % 1.0)
