"""Which rows show the same pose, by their joints, and folds that leave a pose out as a whole.

Labels do not say it: a pose that is measured again has another number, but the same errors. Numbers
and folds do not depend on the order of the rows.
"""

from __future__ import annotations

import numpy as np

from hilcell.geometry.kinematics import Array
from hilcell.identification.readings import Ints

SAME_RAD = np.radians(0.05)  # joints that differ by no more lead to the same errors
FOLDS = 5
GOLDEN = (5.0**0.5 - 1.0) / 2.0  # its multiples scatter evenly, in step with no lattice


def poses_of(joints_rad: Array) -> Ints:
    """Return the number (N,) of each row's pose, counted from 0.

    All joints (N, 6) of a pose are within `SAME_RAD` of its first in ascending order. So poses
    along a line of small steps do not become one.
    """
    different, of_row = np.unique(joints_rad, axis=0, return_inverse=True)
    number: Ints = np.full(len(different), -1)
    count = 0
    for n, first in enumerate(different):
        if number[n] < 0:
            near = (np.abs(different - first) <= SAME_RAD).all(axis=1)
            number[near & (number < 0)] = count
            count += 1
    return number[of_row.ravel()]


def count_poses(joints_rad: Array) -> int:
    """Return how many different poses the rows show."""
    return len(np.unique(poses_of(joints_rad)))


def places_of(joints_rad: Array) -> Array:
    """Return where each row (N,) stands in a scattered order of the poses, from 0 to less than 1.

    One part of the order holds poses of the whole space.
    """
    return np.asarray(poses_of(joints_rad) * GOLDEN % 1.0, dtype=float)


def folds_of(joints_rad: Array) -> Ints:
    """Return the fold (N,) in which each row is left out, one for all rows of a pose."""
    return (FOLDS * places_of(joints_rad)).astype(np.int_)
