"""Static poses that were measured, one row a pose and one column a reflector."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from hilcell.geometry.kinematics import Array, Bools, Ints
from hilcell.ports import HilcellError


class IdentificationError(HilcellError):
    """Poses from which a robot's kinematics cannot be found."""

    code = "HC-C22"


class ManyContradict(IdentificationError):
    """More readings contradict the others than slips explain."""


@dataclass(frozen=True, eq=False)
class Readings:
    """M poses: joints commanded (M, 6) in rad, and where K reflectors were then, (M, K, 3) in mm.

    A reflector that was not measured is NaN. ``covariance_mm2`` (M, K, 3, 3) is that of each
    averaged reading, zero where it is unknown. The frame is the caller's: {B}, or a tracker's.
    """

    joints_rad: Array
    xyz_mm: Array
    covariance_mm2: Array

    def __len__(self) -> int:
        return len(self.joints_rad)

    @property
    def known(self) -> Bools:
        """Return which reflectors were measured (M, K)."""
        return np.asarray(np.isfinite(self.xyz_mm).all(axis=-1))

    def at(self, poses: Ints | Bools) -> Self:
        """Return these poses only."""
        return replace(
            self,
            joints_rad=self.joints_rad[poses],
            xyz_mm=self.xyz_mm[poses],
            covariance_mm2=self.covariance_mm2[poses],
        )

    def without(self, bad: Bools) -> Self:
        """Return the same poses with the readings of a mask (M, K) struck out."""
        return replace(self, xyz_mm=np.where(bad[..., None], np.nan, self.xyz_mm))


SAME_RAD = np.radians(0.05)  # joints that differ by no more lead to the same errors
FOLDS = 5


def poses_of(joints_rad: Array) -> Ints:
    """Return the number (N,) of each row's pose, counted from 0.

    All joints (N, 6) of a pose are within `SAME_RAD` of its first in ascending order. So poses
    along a line of small steps do not become one. Labels do not say it: a pose that is measured
    again has another number, but the same errors. The rows' order does not matter.
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
    golden = (5.0**0.5 - 1.0) / 2.0  # its multiples scatter evenly, in step with no lattice
    return np.asarray(poses_of(joints_rad) * golden % 1.0, dtype=float)


def folds_of(joints_rad: Array) -> Ints:
    """Return the fold (N,) in which each row is left out, one for all rows of a pose."""
    return (FOLDS * places_of(joints_rad)).astype(np.int_)
