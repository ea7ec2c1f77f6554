"""Points for SpatialAnalyzer: ``python -m drivers.spatialanalyzer.t2sa_points CELL FILE``.

T2SA measures points of a job by their names: the tracker points at the nominal position and
searches from there. The job has a list of points, a CSV file of ``name,x,y,z`` (mm, tracker's
frame), and the driver measures a place through the point nearest in direction; range does not
matter. The directions form a grid over the reach of the cell's reflectors, finer than the search
radius at any range. Each point lies amid the places in its direction.
"""

from __future__ import annotations

import argparse
import csv
import io
import math
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from hilcell.atomic_files import write_whole
from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import SettingsError, read_text
from hilcell.geometry.frames import apply, unit
from hilcell.geometry.kinematics import forward
from hilcell.ports import Array, HilcellError

SEARCH_MM = 60.0
MARGIN = 0.9  # of the pitch: the tracker's pose in the cell file is good to some mm
MOST_POINTS = 200_000
LEAST_RANGE_MM = 1.0
STEP_MM = 200.0  # along a direction, in the search for places
COLUMNS = ["name", "x", "y", "z"]


class NamedPoints:
    """Names, and nominal positions (N, 3), N > 0, mm, in the tracker's frame."""

    AROUND = 64  # points, among which one is chosen

    def __init__(self, names: Sequence[str], xyz_mm: Array) -> None:
        self.names, self.xyz_mm = names, xyz_mm
        self._directions = unit(xyz_mm)
        self._tree = KDTree(self._directions)

    def aim(
        self, near_mm: Array, within_mm: float, others_mm: Sequence[Array] = ()
    ) -> tuple[str, Array, float]:
        """Return the point to measure a place (3,) through: name, position (3,), mm beside.

        It is the nearest in direction. Where ``others_mm``, reflectors (3,) beside the place, were
        measured from there, it is one on their far side, if that is ``within_mm`` beside the place
        at its range.
        """
        range_mm = float(np.linalg.norm(near_mm))
        most = range(1, min(self.AROUND, len(self.names)) + 1)
        found = self._tree.query(near_mm / max(range_mm, LEAST_RANGE_MM), k=most)
        beside, order = np.atleast_1d(found[0]), np.atleast_1d(found[1])
        best = 0
        if others_mm:
            from_others = [
                np.linalg.norm(self._directions[order] - unit(each), axis=1) for each in others_mm
            ]
            margin = np.min(from_others, axis=0) - beside
            best = int(np.where(range_mm * beside <= within_mm, margin, -np.inf).argmax())
        n = order[best]
        return self.names[n], self.xyz_mm[n], range_mm * float(beside[best])

    def around(self, near_mm: Array, radius_mm: float, apart_mm: float) -> list[tuple[str, Array]]:
        """Return points to search a place (3,) through: names and positions (3,), nearest first.

        At the place's range they are within ``radius_mm`` of it, and ``apart_mm`` of one another.
        """
        range_mm = max(float(np.linalg.norm(near_mm)), LEAST_RANGE_MM)
        place = near_mm / range_mm
        within = self._tree.query_ball_point(place, radius_mm / range_mm)
        beside = np.linalg.norm(self._directions[within] - place, axis=1)
        chosen: list[int] = []
        for n in np.array(within, dtype=int)[np.argsort(beside)]:
            others = self._directions[chosen].reshape(-1, 3) - self._directions[n]
            if bool(np.all(range_mm * np.linalg.norm(others, axis=1) >= apart_mm)):
                chosen.append(int(n))
        return [(self.names[n], self.xyz_mm[n]) for n in chosen]

    def spread(self, count: int) -> list[tuple[str, Array]]:
        """Return up to ``count`` points from the first to the last."""
        chosen = np.unique(np.linspace(0, len(self.names) - 1, count).round().astype(int))
        return [(self.names[n], self.xyz_mm[n]) for n in chosen]


def read_points(path: Path) -> NamedPoints:
    """Read a list; a first row ``name,x,y,z`` may head it. Raises `SettingsError`."""
    try:
        text = read_text(path)
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(str(path), [f"the list cannot be read: {error}"]) from error
    rows = [(n, row) for n, row in enumerate(csv.reader(io.StringIO(text)), start=1) if row]
    if rows and [each.strip() for each in rows[0][1]] == COLUMNS:
        rows = rows[1:]
    found: dict[str, list[float]] = {}
    for n, row in rows:
        name = row[0].strip()
        try:
            place = [float(each) for each in row[1:]]
        except ValueError:
            place = []
        if len(place) != 3 or not LEAST_RANGE_MM <= math.hypot(*place) < math.inf:
            problem = f"expected {','.join(COLUMNS)} with three numbers, got {','.join(row)!r:.80}"
        elif not re.fullmatch(r"[A-Za-z0-9_.-]{1,40}", name):
            problem = f"name {name!r:.60}: letters, digits, _ . - are allowed, at most 40"
        elif name in found:
            problem = f"point {name} is there twice"
        else:
            found[name] = place
            continue
        raise SettingsError(str(path), [f"line {n}: {problem}"])
    if not 1 <= len(found) <= MOST_POINTS:
        raise SettingsError(str(path), [f"expected 1 to {MOST_POINTS} points, got {len(found)}"])
    return NamedPoints(list(found), np.array(list(found.values())))


def written(points: NamedPoints) -> str:
    rows = zip(points.names, points.xyz_mm, strict=True)
    return "".join(f"{name},{x:.3f},{y:.3f},{z:.3f}\n" for name, (x, y, z) in rows)


def points_of(cell: Cell, search_mm: float) -> NamedPoints:
    """Return points in all directions in which a reflector of the cell can be."""
    tracker, inside = cell.tracker, _volume(cell, search_mm)
    directions = _directions(MARGIN * math.sqrt(2.0) * search_mm / tracker.max_range_mm)
    first_mm = np.full(len(directions), np.nan)
    last_mm = first_mm.copy()
    for range_mm in np.arange(tracker.min_range_mm, tracker.max_range_mm, STEP_MM):
        here = inside(range_mm * directions)
        first_mm[here & np.isnan(first_mm)] = range_mm
        last_mm[here] = range_mm
    kept = np.isfinite(first_mm)
    if not 1 <= kept.sum() <= MOST_POINTS:
        raise HilcellError(
            f"expected 1 to {MOST_POINTS} points, got {kept.sum()}; choose another --search"
        )
    xyz_mm = directions[kept] * (0.5 * (first_mm + last_mm))[kept, None]
    return NamedPoints([f"P{n:06d}" for n in range(1, len(xyz_mm) + 1)], xyz_mm)


def _volume(cell: Cell, wider_mm: float) -> Callable[[Array], NDArray[np.bool_]]:
    """Return a test whether a reflector of the cell can be at places (N, 3), tracker's frame.

    They are those of the arm's reach, and by the nests.
    """
    layout, rail, near_mm = cell.layout, cell.rail, wider_mm + STEP_MM
    nests_mm = np.array([nest.xyz_mm for nest in layout.fixed_nests])
    low_rad, high_rad = np.radians([[j.min_deg, j.max_deg] for j in cell.robot.joint]).T
    joints_rad = np.random.default_rng(1).uniform(low_rad, high_rad, (20_000, 6))
    tools_mm = forward(cell.robot.arm(), joints_rad)[:, :3, 3]  # in {B}, near all it reaches
    reach_mm = float(np.linalg.norm(tools_mm, axis=1).max()) + wider_mm
    begin_mm = layout.nominal_base(rail.travel_min_mm)[:3, 3]
    way_mm = layout.nominal_base(rail.travel_max_mm)[:3, 3] - begin_mm
    length_2 = float(way_mm @ way_mm)

    def inside(at_mm: Array) -> NDArray[np.bool_]:
        world_mm = apply(cell.tracker.pose.matrix(), at_mm)
        above = world_mm[:, 2] >= nests_mm[:, 2].min() - wider_mm
        along = (world_mm - begin_mm) @ way_mm
        share = np.clip(along / length_2, 0.0, 1.0) if length_2 else 0.0
        bases_mm = begin_mm + np.multiply.outer(share, way_mm)  # the nearest ones
        from_base_mm = np.linalg.norm(world_mm - bases_mm, axis=-1)
        found: NDArray[np.bool_] = above & (from_base_mm <= reach_mm)
        for nest_mm in nests_mm:
            found |= np.linalg.norm(world_mm - nest_mm, axis=1) <= near_mm
        return found

    return inside


def _directions(pitch_rad: float) -> Array:
    """Return unit vectors (N, 3) in rows of one elevation, all about ``pitch_rad`` apart."""
    rows = math.ceil(math.radians(80.0) / pitch_rad)
    found: list[Array] = []
    for elevation in pitch_rad * np.arange(-rows, rows + 1):
        across = max(math.cos(elevation), pitch_rad)
        turns = np.linspace(0.0, math.tau, math.ceil(math.tau * across / pitch_rad), endpoint=False)
        up = np.full(len(turns), math.sin(elevation))
        found.append(np.column_stack([across * np.cos(turns), across * np.sin(turns), up]))
    return np.vstack(found)


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m drivers.spatialanalyzer.t2sa_points")
    parser.add_argument("cell", help="a cell file, or the name of a built-in cell")
    parser.add_argument("file", type=Path, help="the CSV to write")
    parser.add_argument(
        "--search",
        type=float,
        default=SEARCH_MM,
        metavar="MM",
        help="how far beside the aim a reflector is found (default %(default)g mm)",
    )
    given = parser.parse_args(words)
    try:
        if not 10.0 <= given.search <= 1000.0:
            raise HilcellError(f"--search: expected 10 to 1000 mm, got {given.search:g} mm")
        points = points_of(load_cell(given.cell), given.search)
        write_whole(given.file, written(points).encode("ascii"))
    except HilcellError as error:
        print(f"t2sa_points: {error}", file=sys.stderr)
        return 2
    print(f"{given.file}: {len(points.names)} points; import them as name, x, y, z in mm")
    return 0


if __name__ == "__main__":
    sys.exit(main())
