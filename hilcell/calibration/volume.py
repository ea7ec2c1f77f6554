"""Where a calibration corrects: its stations, its volume, its orientation.

`compensate` refuses by it and a plan of holes chooses by it: neither contradicts the other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hilcell.calibration.form import Calibration
from hilcell.compensation.grid import ROUNDING_MM
from hilcell.geometry.frames import inverse
from hilcell.geometry.statistics import lengths_mm
from hilcell.ports import Array

Bools = NDArray[np.bool_]


class Volume:
    """The calibrated poses, at each station."""

    ROUNDING_DEG = 1e-4  # of angles in a file: a planned target stays inside when it is read again

    def __init__(self, calibration: Calibration) -> None:
        self._grid = calibration.grid()
        self._validity = calibration.validity
        self._bases = {name: np.array(each.T_W_B) for name, each in calibration.stations.items()}

    @property
    def stations(self) -> list[str]:
        """Return the names of the calibrated stations."""
        return list(self._bases)

    def orientation(self, station: str) -> Array:
        """Return the calibrated orientation (3, 3) in {W} at a station."""
        turned: Array = self._bases[station][:3, :3] @ np.array(self._validity.orientation)
        return turned

    def takes(self, station: str, poses: Array) -> Bools:
        """Return which poses (..., 4, 4) in {W} are corrected at a station."""
        outside_mm, turned_deg = self._beyond(station, poses.reshape(-1, 4, 4))
        limit_deg = self._validity.orientation_tolerance_deg - self.ROUNDING_DEG
        taken: Bools = (outside_mm <= 0.0) & (turned_deg <= limit_deg)
        return taken.reshape(poses.shape[:-2])

    def points_back(self, stations: Sequence[str], poses: Array) -> bool:
        """Whether all poses (K, 4, 4) in {W} have z against every calibrated one's at a station."""
        bases = (self._bases[name] for name in stations if name in self._bases)
        return any(bool(self._validity.points_back(inverse(T) @ poses).all()) for T in bases)

    def refusal(self, stations: Sequence[str], poses: Array) -> str:
        """Return why none of poses (K, 4, 4) in {W} is corrected, where least is missing."""
        known = [name for name in stations if name in self._bases]
        if not known:
            return f"none of its stations is calibrated; calibrated: {', '.join(self._bases)}"
        limit_deg = self._validity.orientation_tolerance_deg
        found = list[tuple[float, float, str]]()
        for name in known:
            outside_mm, turned_deg = self._beyond(name, poses)
            turned_deg = np.maximum(turned_deg, limit_deg - self.ROUNDING_DEG)
            found += (
                (*each, name) for each in zip(turned_deg.tolist(), outside_mm.tolist(), strict=True)
            )
        turned, off_mm, at = min(found, key=lambda each: (round(each[0]), each[1], each[0]))
        outside = f"outside the calibrated volume by {off_mm:.1f} mm at {at}"
        if turned <= limit_deg - self.ROUNDING_DEG:
            return outside
        return (
            f"the flange would be turned by {turned:.2f} deg from the calibrated orientation at "
            f"{at}, expected at most {limit_deg:g} deg; calibrate with plan.tilt_deg or "
            f"plan.grid_orientations{f'; {outside}' if off_mm > 0.0 else ''}"
        )

    def _beyond(self, station: str, poses: Array) -> tuple[Array, Array]:
        """Return how far poses (N, 4, 4) are outside (mm, 0 inside) and turned (deg), each (N,)."""
        in_base = inverse(self._bases[station]) @ poses
        places_mm = in_base[:, :3, 3]
        outside_mm = lengths_mm(places_mm - self._grid.clamped(places_mm))
        outside_mm[outside_mm <= ROUNDING_MM] = 0.0
        return outside_mm, self._validity.turned_deg(in_base)
