"""Keep-out volumes as a person gives them: boxes of a list, or corners taught with a reflector."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import msgspec
import numpy as np

from hilcell.cell.settings import SettingsError, convert, read_file
from hilcell.cell.surroundings import KeepOut
from hilcell.cell.tables import Pose
from hilcell.compensation.targets import read_named_rows, unit_hint
from hilcell.decoding import Json
from hilcell.geometry.frames import from_zyx, matrix
from hilcell.geometry.kinematics import Array

CORNERS = (2, 8)  # of a taught volume
MARGIN_MM = 30.0  # a reflector's centre is not at the corner, and a hand is not exact
HEADER = [
    "name", "on_slide",
    "from_x_mm", "from_y_mm", "from_z_mm", "to_x_mm", "to_y_mm", "to_z_mm",
]  # fmt: skip
FRAMES = ("world", "slide")  # by `on_slide`


def read_volumes(path: Path) -> list[KeepOut]:
    """Return the boxes of a list, each by two opposite corners along the axes of its frame: fixed
    in {W}, or on the slide in nominal {B}. Raises `SettingsError` with every problem.
    """
    rows = read_named_rows(path, read_file(path), [HEADER], "volumes")
    volumes, problems = list[KeepOut](), list[str]()
    if hint := unit_hint(np.array(rows.values)[:, 1:]):
        raise SettingsError(str(path), [hint.strip()])
    for name, (on_slide, *ends_mm) in zip(rows.names, rows.values, strict=True):
        if on_slide not in (0.0, 1.0):
            problems.append(f"{name}: on_slide is {on_slide:g}, expected 0 or 1")
            continue
        low_mm, high_mm = np.sort(np.reshape(ends_mm, (2, 3)), axis=0)
        centre = Pose.of(matrix(np.eye(3), (low_mm + high_mm) / 2))
        try:
            volumes.append(_box(name, centre, high_mm - low_mm, FRAMES[int(on_slide)]))
        except SettingsError as error:
            problems += [f"{name}: {each}" for each in error.problems]
    if problems:
        raise SettingsError(str(path), problems)
    return volumes


def taught(name: str, corners_mm: Array) -> KeepOut:
    """Return the upright box that contains corners (N, 3) in {W} with the margin.

    Two corners are opposite ones of a box along the axes of {W}; with more the box has the least
    floor area of those with a side along two of the corners.
    """
    turns_rad = [0.0]
    if len(corners_mm) > CORNERS[0]:
        turns_rad += [
            float(np.arctan2(*(other - one)[1::-1])) for one, other in combinations(corners_mm, 2)
        ]
    boxes = [_around(corners_mm, turn_rad) for turn_rad in turns_rad]
    T, size_mm = min(boxes, key=lambda box: float(np.prod(box[1][:2])))
    return _box(name, Pose.of(T), size_mm, "world")


def _around(corners_mm: Array, turn_rad: float) -> tuple[Array, Array]:
    """Return the centre (4, 4) and edges (3,) of the box about corners, turned about z."""
    R = from_zyx((np.degrees(turn_rad), 0.0, 0.0))
    turned_mm = corners_mm @ R
    low_mm, high_mm = turned_mm.min(axis=0) - MARGIN_MM, turned_mm.max(axis=0) + MARGIN_MM
    return matrix(R, R @ (low_mm + high_mm) / 2), high_mm - low_mm


def _box(name: str, centre: Pose, size_mm: Array, frame: str) -> KeepOut:
    values = {"name": name, "centre": msgspec.to_builtins(centre), "frame": frame}
    return convert(values | {"size_mm": np.round(size_mm, 3).tolist()}, KeepOut, "keep_out")


def row(volume: KeepOut) -> Json:
    """Return a volume as the cell file has it."""
    values: Json = msgspec.to_builtins(volume)
    centre = values["centre"]
    values["centre"] = {key: each for key, each in centre.items() if each or key[0] in "xyz"}
    return values
