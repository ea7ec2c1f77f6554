"""A station held by the strip, and the proof that it comes back (section 4.3, Figs 9-10)."""

from __future__ import annotations

from typing import Any

import numpy as np

from hilcell.cell import Cell, Nest, Station
from hilcell.ports import Array
from hilcell.run.bench import Bench
from hilcell.run.log import Log, positions_mm
from hilcell.run.procedure import Step
from procedures.plan import MEASURE_S

REPEATS = 15
APPROACH_MM = 150.0
STRIP_LIMIT_MM = 0.035


class HoldStation:
    """Brings the slide to the grid's station by the closed loop of the strip."""

    name = "hold-station"
    needs = "a referenced drive"
    moves = "the slide, with the robot at its safe pose"
    measures = "the strip"
    yields = "a held station"

    def plan(self, cell: Cell, seed: int) -> Step:
        """Return the step."""
        return Step(self.name, 0, 30.0)

    def perform(self, bench: Bench) -> None:
        """Hold the station once; who needs it later holds it himself."""
        if not bench.reached("station_held"):
            bench.hold_station(bench.cell.station_named(bench.cell.grid.station))
            bench.reach("hold_station")

    def result(self, log: Log) -> dict[str, Any]:
        """Return nothing: the station's figures come with its frame."""
        return {}


class StationRepeatability:
    """Approaches one station many times from both sides, by drive alone and by the strip."""

    name = "station-repeatability"
    needs = "the world frame, a reflector on the slide"
    moves = "the slide to and fro around the grid's station"
    measures = "one slide nest after each approach"
    yields = "range and backlash without and with the strip"

    def plan(self, cell: Cell, seed: int) -> Step:
        """Return the step."""
        points = 2 * REPEATS
        return Step(self.name, points, points * (20.0 + MEASURE_S * cell.layout.nest_samples))

    def perform(self, bench: Bench) -> None:
        """Approach from alternating sides, first plainly, then held by the strip."""
        station = bench.cell.station_named(bench.cell.grid.station)
        nest = bench.cell.layout.slide[0]
        for number in range(REPEATS):
            self._visit(bench, station, nest, number, strip=False)
        for number in range(REPEATS):
            self._visit(bench, station, nest, number, strip=True)
        result = self.result(bench.log)["station_repeatability"]
        bench.verdict(
            "station-repeatability", holds=result["strip"]["range_mm"] <= STRIP_LIMIT_MM,
            found_mm=result["strip"]["range_mm"], limit_mm=STRIP_LIMIT_MM,
        )  # fmt: skip

    def _visit(
        self, bench: Bench, station: Station, nest: Nest, number: int, *, strip: bool
    ) -> None:
        how = "strip" if strip else "plain"
        key = f"repeat/{how}/{number:03d}"
        if key in bench.log.points:
            return
        side = 1 if number % 2 else -1
        bench.rail_to(station.rail_mm + side * APPROACH_MM)
        if strip:
            bench.hold_station(station, anew=True)
        else:
            bench.rail_to(station.rail_mm)
        expected = (bench.frames.base_in_world(station) @ np.append(nest.xyz_mm, 1.0))[:3]
        bench.slide_now(key, f"repeat_{how}", nest, expected)

    def result(self, log: Log) -> dict[str, Any]:
        """Return range, ISO 9283 RP and the effect of the side, along the rail."""
        how = {name: approach_figures(log, name) for name in ("plain", "strip")}
        return {"station_repeatability": how | {"repeats": REPEATS}}


def approach_figures(log: Log, how: str) -> dict[str, float]:
    """Return range and repeatability of the slide's position along the rail, and the backlash."""
    points_mm = positions_mm(log.group(f"repeat_{how}"))
    along_mm = along_rail(log, points_mm)
    from_below, from_above = along_mm[0::2], along_mm[1::2]
    spread_mm = np.linalg.norm(points_mm - points_mm.mean(axis=0), axis=1)
    return {
        "range_mm": float(np.ptp(along_mm)),
        "rp_mm": float(spread_mm.mean() + 3 * spread_mm.std(ddof=1)),
        "backlash_mm": float(from_above.mean() - from_below.mean()),
    }


def along_rail(log: Log, points_mm: Array) -> Array:
    """Return (N,) coordinates along the rail's nominal direction of raw points (N, 3)."""
    rotation = log.matrix("world")[:3, :3]
    along: Array = points_mm @ rotation.T @ np.array(log.cell.layout.rail_direction)
    return along
