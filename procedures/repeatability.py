"""How well the robot comes back: the floor below which no compensation can go (ISO 9283 RP)."""

from __future__ import annotations

import math

import numpy as np

from hilcell.cell.file import Cell
from hilcell.geometry.statistics import figures_of, from_mean_mm, repeatability_mm, rms
from hilcell.journal.log import Log, positions_mm, variances_mm2
from hilcell.model.plan import PlannedStep
from hilcell.model.point import Point, PointId
from hilcell.model.results import Floor, Repeated
from hilcell.ports import Array
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Result
from procedures.plan import check_targets, closing, flange_points, joints_for, poses_at

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
        places = poses_at(cell, places_mm(cell))
        places_rad = check_targets(cell, there, places, "repeatability place")
        visits_rad = np.tile(places_rad, (visits_of(cell), 1))
        return PlannedStep.of_spans(
            self.name, len(visits_rad), [flange_points(cell, visits_rad), *closing(cell)]
        )

    def perform(self, session: CellSession) -> None:
        """Go round the places, so that each visit comes from another one."""
        station = session.cell.reference
        joints = joints_for(session.cell, places_mm(session.cell))
        session.expect(station, np.vstack([joints[-1:], joints]))  # round and round
        for visit in range(visits_of(session.cell)):
            for place, target in enumerate(joints):
                id = PointId("repeatability", place=place, number=visit)
                session.flange_point(id, station, target)
        session.close_step()

    def result(self, log: Log) -> Result:
        """Return RP of ISO 9283 as measured and of the robot alone, and the floor."""
        found = Repeated(rp_mm=rp_mm(log), rp_robot_mm=rp_robot_mm(log), floor_mm=floor(log).mean)
        return {"repeatability": found}


def visits_of(cell: Cell) -> int:
    return 5 if cell.plan.quick else VISITS


def places_mm(cell: Cell) -> Array:
    """Return the places (3, 3) in {B}: the centre and two opposite corners."""
    centre = cell.grid.centre.matrix()[:3, 3]
    half = np.array(cell.grid.size_mm) / 2
    return np.array([centre, centre - half, centre + half])


def _visits(log: Log) -> list[list[Point]]:
    return [log.select("repeatability", place=n) for n in range(len(places_mm(log.cell)))]


def distances_mm(log: Log) -> Array:
    """Return the distance of each visit from its place's mean, all places together (N,).

    The mean of n visits scatters too, so distances are grown by sqrt(n / (n - 1)).
    """
    clouds_mm = [positions_mm(place) for place in _visits(log)]
    return np.concatenate(
        [from_mean_mm(cloud) * np.sqrt(len(cloud) / (len(cloud) - 1)) for cloud in clouds_mm]
    )


def rp_mm(log: Log) -> float:
    """Return RP = mean + 3 s of the distances, all places together (ISO 9283, 7.2.2).

    One place has too few visits for a figure of its own: three places make the standard's 30,
    and half of them on a quick plan.
    """
    return repeatability_mm(distances_mm(log))


def rp_robot_mm(log: Log) -> float:
    """Return RP less the tracker's noise; 0 where the noise explains all.

    Mean squares subtract: that of the distances less that of the readings, which the tracker
    states as standard deviations. Distances are taken to keep the shape of their distribution.
    """
    points = [point for place in _visits(log) for point in place]
    share = 1.0 - float(variances_mm2(points).sum(axis=1).mean()) / rms(distances_mm(log)) ** 2
    return rp_mm(log) * math.sqrt(max(0.0, share))


def floor(log: Log) -> Floor:
    """Return mean and p95 of a perfect map's errors: one visit's distance from the mean."""
    figures = figures_of(distances_mm(log))
    return Floor(mean=figures.mean, p95=figures.p95)
