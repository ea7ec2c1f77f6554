"""Static poses that were measured, one row a pose and one column a reflector."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hilcell.geometry.kinematics import Array
from hilcell.ports import HilcellError

Bools = NDArray[np.bool_]
Ints = NDArray[np.int_]


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
