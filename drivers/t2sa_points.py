"""Named points for SpatialAnalyzer: ``python -m drivers.t2sa_points CELL FILE [--search MM]``.

T2SA measures points of a job by their names: the tracker turns to the point's nominal position and
searches from there. So the job has a lattice of points over the volume in which the cell's
reflectors can be, in the tracker's frame, written as a CSV file of ``name,x,y,z`` (mm), and the
driver measures a place through the named point nearest to it. The lattice is cubic; its pitch
leaves no place in the volume farther than the search reaches.
"""

from __future__ import annotations

import argparse
import csv
import io
import math
import re
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import SettingsError, read_text
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.kinematics import forward
from hilcell.ports import Array, HilcellError
from hilcell.writing import write_whole

SEARCH_MM = 130.0
MARGIN = 0.98  # of the pitch: the tracker's pose in the cell file is good to some mm
MOST_POINTS = 200_000
POSES = 20_000  # random ones, whose farthest tool point is the arm's reach
PLACES = 3  # decimal places of a position
COLUMNS = ["name", "x", "y", "z"]
SIZE = 3
NAME = re.compile(r"[A-Za-z0-9_.-]{1,40}")


class NamedPoints:
    """Names, and nominal positions (N, 3), N > 0, mm, in the tracker's frame."""

    def __init__(self, names: Sequence[str], xyz_mm: Array) -> None:
        self.names, self.xyz_mm = names, xyz_mm
        self._tree = KDTree(xyz_mm)

    def around(self, near_mm: Array, most: int) -> list[tuple[str, Array, float]]:
        """Return the ``most`` points nearest to a place (3,): name, position, distance."""
        found = self._tree.query(near_mm, k=range(1, min(most, len(self.names)) + 1))
        far_mm, order = np.atleast_1d(found[0]), np.atleast_1d(found[1])
        return [
            (self.names[n], self.xyz_mm[n], float(each))
            for n, each in zip(order, far_mm, strict=True)
        ]

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
        if len(place) != SIZE or not all(map(math.isfinite, place)):
            problem = f"{','.join(row)!r:.80}, wanted {','.join(COLUMNS)} with three numbers"
        elif not NAME.fullmatch(name):
            problem = f"name {name!r:.60}: letters, digits, _ . - are allowed, at most 40"
        elif name in found:
            problem = f"point {name} is there twice"
        else:
            found[name] = place
            continue
        raise SettingsError(str(path), [f"line {n}: {problem}"])
    if not 1 <= len(found) <= MOST_POINTS:
        raise SettingsError(str(path), [f"{len(found)} points, wanted 1 to {MOST_POINTS}"])
    return NamedPoints(list(found), np.array(list(found.values())))


def written(points: NamedPoints) -> str:
    """Return the list as CSV."""
    rows = zip(points.names, points.xyz_mm.round(PLACES), strict=True)
    return "".join(f"{name},{x:.3f},{y:.3f},{z:.3f}\n" for name, (x, y, z) in rows)


def points_of(cell: Cell, search_mm: float) -> NamedPoints:
    """Return a lattice over all places at which a reflector of the cell can be."""
    pitch_mm = math.floor(MARGIN * 2.0 / math.sqrt(3.0) * search_mm)
    layout, tracker = cell.layout, cell.tracker
    T_W_T = tracker.pose.matrix()
    standing_mm = np.array([nest.xyz_mm for nest in layout.standing])
    ends_mm = np.array(
        [
            layout.nominal_base(rail_mm)[:3, 3]
            for rail_mm in (cell.rail.travel_min_mm, cell.rail.travel_max_mm)
        ]
    )
    reach_mm = _reach_mm(cell)
    corners_mm = np.vstack([standing_mm, ends_mm - reach_mm, ends_mm + reach_mm])
    low_mm, high_mm = corners_mm.min(axis=0), corners_mm.max(axis=0)
    box_mm = apply(inverse(T_W_T), _corners(low_mm, high_mm))
    lattice_mm = _lattice(box_mm.min(axis=0), box_mm.max(axis=0), pitch_mm)
    in_world_mm = apply(T_W_T, lattice_mm)
    range_mm = np.linalg.norm(lattice_mm, axis=1)
    seen = (tracker.min_range_mm - pitch_mm <= range_mm) & (
        range_mm <= tracker.max_range_mm + pitch_mm
    )
    above = in_world_mm[:, 2] >= standing_mm[:, 2].min() - pitch_mm
    by_arm = _from_line_mm(in_world_mm, *ends_mm) <= reach_mm + pitch_mm
    by_nest = np.min([np.linalg.norm(in_world_mm - at_mm, axis=1) for at_mm in standing_mm], axis=0)
    kept_mm = lattice_mm[seen & ((above & by_arm) | (by_nest <= 2.0 * pitch_mm))]
    if not 1 <= len(kept_mm) <= MOST_POINTS:
        raise HilcellError(
            f"{len(kept_mm)} points with a pitch of {pitch_mm} mm, wanted 1 to {MOST_POINTS}; "
            "choose another --search"
        )
    return NamedPoints([f"P{n:06d}" for n in range(1, len(kept_mm) + 1)], kept_mm)


def _reach_mm(cell: Cell) -> float:
    """Return how far from {B}'s origin the arm carries its reflector, nearly."""
    low_rad, high_rad = np.radians([[j.min_deg, j.max_deg] for j in cell.robot.joint]).T
    joints_rad = np.random.default_rng(1).uniform(low_rad, high_rad, (POSES, 6))
    return float(np.linalg.norm(forward(cell.robot.arm(), joints_rad)[:, :3, 3], axis=1).max())


def _corners(low_mm: Array, high_mm: Array) -> Array:
    ends_mm = np.array([low_mm, high_mm])
    return np.array(
        [[ends_mm[i, 0], ends_mm[j, 1], ends_mm[k, 2]] for i, j, k in np.ndindex(2, 2, 2)]
    )


def _lattice(low_mm: Array, high_mm: Array, pitch_mm: float) -> Array:
    """Return the nodes (N, 3) of a cubic lattice about a box."""
    axes = [
        pitch_mm * np.arange(math.floor(low / pitch_mm), math.ceil(high / pitch_mm) + 1)
        for low, high in zip(low_mm, high_mm, strict=True)
    ]
    nodes: Array = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return nodes


def _from_line_mm(at_mm: Array, begin_mm: Array, end_mm: Array) -> Array:
    """Return how far places (N, 3) are from the line between two points (3,)."""
    way_mm = end_mm - begin_mm
    length_2 = float(way_mm @ way_mm)
    share = np.clip((at_mm - begin_mm) @ way_mm / length_2, 0.0, 1.0) if length_2 else 0.0
    feet_mm = begin_mm + np.multiply.outer(share, way_mm)
    far_mm: Array = np.linalg.norm(at_mm - feet_mm, axis=-1)
    return far_mm


def main(words: Sequence[str] | None = None) -> int:
    """Write the list of a cell file."""
    parser = argparse.ArgumentParser(prog="python -m drivers.t2sa_points")
    parser.add_argument("cell", help="a cell file, or the name of a built-in cell")
    parser.add_argument("file", type=Path, help="the CSV to write")
    parser.add_argument(
        "--search",
        type=float,
        default=SEARCH_MM,
        metavar="MM",
        help="how far from its named point a reflector is found (default %(default)g mm)",
    )
    given = parser.parse_args(words)
    try:
        if not 10.0 <= given.search <= 1000.0:
            raise HilcellError(f"--search {given.search:g} mm, wanted 10 to 1000 mm")
        points = points_of(load_cell(given.cell), given.search)
        write_whole(given.file, written(points).encode("ascii"))
    except HilcellError as error:
        print(f"t2sa_points: {error}", file=sys.stderr)
        return 2
    print(f"{given.file}: {len(points.names)} points; import them as name, x, y, z in mm")
    return 0


if __name__ == "__main__":
    sys.exit(main())
