"""Readings of one pose, repeated: their mean counts as one reading.

They share what no model describes of the pose, however often it is measured.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hilcell.fit.measurements import Measurements
from hilcell.fit.placement import Placement
from hilcell.geometry.kinematics import Array
from hilcell.geometry.statistics import lengths_mm
from hilcell.identification.measured_poses import pose_numbers


def averaged(placement: Placement, rows: Measurements, middles_rad: Array) -> Measurements:
    """One row a pose and reflector, at the joints of the pose's first row, whose turns are about
    the middles (n,).

    Means are of differences from nominal positions, as the joints differ a little, and are weighted
    by the inverse covariances, where known; those of distances are singular, and count alike.
    """
    pose, groups = _poses(rows, middles_rad), _repeated(rows, middles_rad)
    if len(groups) == len(rows):
        return rows
    of_pose = {number: n for n, number in reversed([*enumerate(pose)])}
    first = [of_pose[number] for number, _, _ in groups]
    mean = replace(
        rows.at(own[0] for own in groups.values()),
        pose=[rows.pose[n] for n in first],
        joints_rad=rows.joints_rad[first],
    )
    missed_mm, errors_mm = rows.xyz_mm - placement.predicted_mm(rows), np.empty((len(mean), 3))
    precision: Array = np.broadcast_to(np.eye(3), (len(rows), 3, 3))
    covariances_mm2 = mean.covariance_mm2
    weighted = rows.along is None
    if weighted and rows.covariance_mm2 is not None:
        precision = np.asarray(np.linalg.inv(rows.covariance_mm2), dtype=float)
    for n, repeated in enumerate(groups.values()):
        own = _agreeing(repeated, missed_mm)
        together = precision[own].sum(axis=0)
        errors_mm[n] = np.linalg.solve(
            together, np.einsum("nij,nj->i", precision[own], missed_mm[own])
        )
        if weighted and covariances_mm2 is not None:
            covariances_mm2[n] = np.linalg.inv(together)
        if mean.R is not None and rows.R is not None:
            mean.R[n] = _middle(rows.R[own])
        if mean.u_rad is not None and rows.u_rad is not None:
            mean.u_rad[n] = np.sum(rows.u_rad[own] ** -2.0) ** -0.5
    return replace(mean, xyz_mm=placement.predicted_mm(mean) + errors_mm)


def lacking_mm2(placement: Placement, rows: Measurements, middles_rad: Array) -> float:
    """The variance of a coordinate that one reading has and the mean of its pose has not.

    It is of the readings' scatter within poses, less their own variances.
    """
    missed_mm = rows.seen_mm(rows.xyz_mm - placement.predicted_mm(rows))
    own_mm2, axes = np.zeros(len(rows)), 3.0 if rows.along is None else 1.0
    if rows.covariance_mm2 is not None:
        own_mm2 = np.trace(rows.seen_mm2(rows.covariance_mm2), axis1=1, axis2=2)
    groups = [_agreeing(own, missed_mm) for own in _repeated(rows, middles_rad).values()]
    again = len(rows) - len(groups)
    if not again:
        return 0.0
    squares_mm2 = sum(len(own) * missed_mm[own].var(axis=0).sum() for own in groups)
    scatter_mm2 = (squares_mm2 / (sum(map(len, groups)) - len(groups)) - own_mm2.mean()) / axes
    lacking = 1.0 - np.mean([1.0 / len(own) for own in groups])
    return float(max(scatter_mm2, 0.0) * lacking)


def _poses(rows: Measurements, middles_rad: Array) -> list[int]:
    numbers: list[int] = pose_numbers(rows.within_turns(middles_rad).joints_rad).tolist()
    return numbers


def _repeated(rows: Measurements, middles_rad: Array) -> dict[tuple[int, str, str], list[int]]:
    """The rows of each pose, reflector and anchor."""
    anchor = rows.anchor or [""] * len(rows)
    groups: dict[tuple[int, str, str], list[int]] = {}
    keys = zip(_poses(rows, middles_rad), rows.target, anchor, strict=True)
    for n, key in enumerate(keys):
        groups.setdefault(key, []).append(n)
    return groups


def _agreeing(own: list[int], missed_mm: Array) -> list[int]:
    """The rows of a pose without those far from most others."""
    far = 5.0  # in median distances
    away_mm = lengths_mm(missed_mm[own] - np.median(missed_mm[own], axis=0))
    return [n for n, each in zip(own, away_mm, strict=True) if each <= far * np.median(away_mm)]


def _middle(R: Array) -> Array:
    """The mean (3, 3) of rotations (N, 3, 3), NaN where none is known."""
    known = R[np.isfinite(R).all(axis=(1, 2))]
    if not len(known):
        return np.full((3, 3), np.nan)
    U, _, V = np.linalg.svd(known.sum(axis=0))
    middle: Array = U @ V
    return middle
