"""The orientation of a body by several points on it, in the tracker's or any other frame."""

from __future__ import annotations

import numpy as np

from hilcell.geometry.frames import cross_matrix
from hilcell.geometry.kinematics import Array


def orientations(places_mm: Array, seen_mm: Array) -> Array:
    """Return the rotations (N, 3, 3) of a body whose points (K, 3) are seen at (N, K, 3).

    By least squares (Arun, Huang, Blostein 1987); K >= 3 points that lie on no line.
    """
    places = places_mm - places_mm.mean(axis=0)
    seen = seen_mm - seen_mm.mean(axis=1, keepdims=True)
    U, _, Vt = np.linalg.svd(np.einsum("ki,nkj->nij", places, seen))
    mirrored = np.broadcast_to(np.eye(3), U.shape).copy()
    mirrored[:, 2, 2] = np.sign(np.linalg.det(U @ Vt))
    found: Array = np.swapaxes(Vt, 1, 2) @ mirrored @ np.swapaxes(U, 1, 2)
    return found


def turn_levers(places_mm: Array, rotations: Array) -> Array:
    """Return by how much a displacement of each point turns the body, (N, K, 3, 3) in rad / mm.

    The body's points (K, 3) are turned by rotations (N, 3, 3): the derivative of `orientations`,
    as a rotation vector in the frame in which they are seen.
    """
    places = places_mm - places_mm.mean(axis=0)
    levers = cross_matrix(np.einsum("nij,kj->nki", rotations, places))
    inertia = -np.sum(levers @ levers, axis=1)
    return np.linalg.inv(inertia)[:, None] @ levers
