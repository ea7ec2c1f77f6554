"""How well the robot comes back: the floor below which no compensation can go (ISO 9283 RP)."""

from __future__ import annotations

from typing import Any

import numpy as np

from hilcell.cell import Cell
from hilcell.ports import Array
from hilcell.run.bench import Bench
from hilcell.run.log import Log, positions_mm
from hilcell.run.procedure import Step
from procedures.durations import flange_points, step
from procedures.plan import check_reach

VISITS = 10


class Repeatability:
    """Visits three places of the cube many times, away and back, each time from below."""

    name = "repeatability"
    needs = "the grid's station held"
    moves = "the robot between the cube's centre and two corners"
    measures = "the flange reflector on every visit"
    yields = "the floor: repeatability and tracker noise alone"

    def plan(self, cell: Cell, seed: int) -> Step:
        """Refuse places out of reach."""
        places_rad = check_reach(cell, places_mm(cell), "repeatability place")
        visits_rad = np.tile(places_rad, (VISITS, 1))
        return step(self.name, len(visits_rad), [flange_points(cell, visits_rad)])

    def perform(self, bench: Bench) -> None:
        """Go round the places; going on to the next is what leaves the last."""
        station = bench.cell.station_named(bench.cell.grid.station)
        joints = check_reach(bench.cell, places_mm(bench.cell), "repeatability place")
        for visit in range(VISITS):
            for place, target in enumerate(joints):
                key = f"repeatability/{place}/{visit:03d}"
                bench.flange_point(key, f"repeatability_{place}", station, target)

    def result(self, log: Log) -> dict[str, Any]:
        """Return RP of ISO 9283 and the floor."""
        return {"repeatability": {"rp_mm": rp_mm(log), "floor_mm": floor(log)["mean"]}}


def places_mm(cell: Cell) -> Array:
    """Return the places (3, 3) in {B}: the centre and two opposite corners."""
    centre = cell.grid.centre.matrix()[:3, 3]
    half = np.array(cell.grid.size_mm) / 2
    return np.array([centre, centre - half, centre + half])


def clouds_mm(log: Log) -> list[Array]:
    """Return each place's visits less their mean, (VISITS, 3)."""
    places = range(len(places_mm(log.cell)))
    visits = [positions_mm(log.group(f"repeatability_{place}")) for place in places]
    return [cloud - cloud.mean(axis=0) for cloud in visits]


def rp_mm(log: Log) -> float:
    """Return the largest RP = mean + 3 s of the distances from the mean position (ISO 9283)."""
    distances = [np.linalg.norm(cloud, axis=1) for cloud in clouds_mm(log)]
    return max(float(each.mean() + 3 * each.std(ddof=1)) for each in distances)


def floor(log: Log) -> dict[str, float]:
    """Return mean and p95 of what a perfect map would leave: one visit's distance from its mean.

    The mean of n visits scatters too, so distances grow by sqrt(n / (n - 1)).
    """
    grow = np.sqrt(VISITS / (VISITS - 1))
    distances = np.concatenate([np.linalg.norm(cloud, axis=1) for cloud in clouds_mm(log)]) * grow
    return {"mean": float(distances.mean()), "p95": float(np.quantile(distances, 0.95))}
