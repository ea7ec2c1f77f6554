"""Holes to drill, in {W}, and the tool orientations that each of them allows.

A hole with a normal fixes {T}'s z, which points against the part's outward normal; rotation about
it is free. A target with angles fixes the whole orientation.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from hilcell.cell.settings import SettingsError, read_file
from hilcell.compensation.targets import HEADER, read_named_rows
from hilcell.errors import bounded
from hilcell.geometry.frames import from_rotvec, from_zyx
from hilcell.geometry.kinematics import Array

NORMALS = ["name", "x_mm", "y_mm", "z_mm", "nx", "ny", "nz"]
TOOL_ROTATIONS = 24  # about the tool's axis, 15 deg apart
MOST_HOLES = 5000  # routes hold all distances between holes at once


REFLECTOR_ITSELF = np.eye(4)


@dataclass(frozen=True, slots=True)
class Holes:
    """``points_mm`` (N, 3) in {W}; ``tools`` (N, K, 3, 3): allowed orientations of the tool in {W}.

    ``T_D_T`` (4, 4) is the reflector's frame {T} in that of the tool's tip {D}.
    """

    names: list[str]
    points_mm: Array
    tools: Array
    T_D_T: Array = field(default_factory=REFLECTOR_ITSELF.copy)

    @property
    def outward(self) -> Array:
        """The part's outward normals (N, 3): the tool points against them."""
        return np.asarray(-self.tools[:, 0, :, 2])

    def reflector_poses(self) -> Array:
        """Allowed poses (N, K, 4, 4) of {T} in {W}."""
        return self.poses() @ self.T_D_T

    def poses(self) -> Array:
        """Allowed poses (N, K, 4, 4) of the tool's tip in {W}."""
        poses = np.zeros((*self.tools.shape[:2], 4, 4))
        poses[..., :3, :3] = self.tools
        poses[..., :3, 3] = self.points_mm[:, None]
        poses[..., 3, 3] = 1.0
        return poses

    def with_rotation_near(self, R: Array) -> Holes:
        """The holes with one more rotation where free: with {T} nearest to ``R`` (3, 3)."""
        rounding = 1e-9  # of a cosine
        if self.tools.shape[1] == 1:
            return self  # angles, which fix the turn
        R = R @ self.T_D_T[:3, :3].T
        z = self.tools[:, 0, :, 2]
        axis = np.cross(R[:, 2], z)
        sine = np.linalg.norm(axis, axis=1)
        angle_rad = np.arctan2(sine, z @ R[:, 2])
        vectors = axis * (angle_rad / np.maximum(sine, np.finfo(float).tiny))[:, None]
        nearest = from_rotvec(vectors) @ R  # by the shortest rotation
        there = np.einsum("ni,ni->n", nearest[:, :, 2], z) > 1.0 - rounding
        nearest[~there] = self.tools[~there, 0]  # of opposite axes none is the shortest
        tools = np.concatenate([self.tools, nearest[:, None]], axis=1)
        return replace(self, tools=tools)

    @property
    def twins(self) -> list[str]:
        """Warnings of holes nearer to another, with its normal, than a bound tells apart."""
        twin_mm, twin_rad = 0.1, 0.02  # of one hole: less than most bounds, and than any drill
        if len(self.names) < 2:
            return []
        axes = self.tools[:, 0, :, 2] * (twin_mm / twin_rad)
        places = np.hstack([self.points_mm, axes])
        none = len(places)  # means no neighbour
        near = np.asarray(cKDTree(places).query(places, k=2, distance_upper_bound=twin_mm)[1])
        pairs = {
            (min(n, other), max(n, other))
            for n, (one, two) in enumerate(near.tolist())
            if (other := two if one == n else one) != none
        }
        same_mm, warnings = 5e-4, list[str]()  # lists are rounded
        for first, second in sorted(pairs):
            off_mm = float(np.linalg.norm(self.points_mm[second] - self.points_mm[first]))
            how = f"{off_mm:.3f} mm apart, same normal: is it one hole, listed twice?"
            if off_mm < same_mm:
                how = "one hole: same place, same normal"
            warnings.append(f"warning: {self.names[second]} and {self.names[first]} are {how}")
        return warnings

    @property
    def warnings(self) -> list[str]:
        """A readable number of the `twins`."""
        return bounded(self.twins)


def read_holes(path: Path, T_D_T: Array = REFLECTOR_ITSELF) -> Holes:
    """Read holes by normals or angles, {T} in the tip's frame ``T_D_T``; raises `SettingsError`."""

    def fault_of(header: list[str], values: list[float]) -> str:
        least_normal = 1e-6  # a shorter one is a zero that was rounded
        if header == NORMALS and not np.linalg.norm(values[3:]) >= least_normal:
            return f"normal {values[3:]} has no length"
        return ""

    rows = read_named_rows(path, read_file(path), [NORMALS, HEADER], "holes", fault_of)
    if len(rows.names) > MOST_HOLES:
        problem = f"{len(rows.names)} holes, expected at most {MOST_HOLES}: split the file"
        raise SettingsError(str(path), [problem])
    values = np.array(rows.values)
    by_normal = rows.header == NORMALS
    tools = tools_against(values[:, 3:]) if by_normal else from_zyx(values[:, 3:])[:, None]
    return Holes(rows.names, values[:, :3], tools, T_D_T)


def tools_against(normals: Array) -> Array:
    """Orientations (N, `TOOL_ROTATIONS`, 3, 3) whose z points against normals (N, 3)."""
    z = -normals / np.linalg.norm(normals, axis=1, keepdims=True)
    aside = np.eye(3)[np.argmin(np.abs(z), axis=1)]  # never along z
    x = np.cross(aside, z)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    first = np.stack([x, np.cross(z, x), z], axis=-1)
    angles_rad = np.arange(TOOL_ROTATIONS) * 2 * np.pi / TOOL_ROTATIONS
    turns = from_rotvec(angles_rad[:, None] * [0.0, 0.0, 1.0])
    return np.asarray(np.einsum("nij,kjl->nkil", first, turns))
