"""The robot's error as measured, in {B}: on the grid, at every pose, axis by axis."""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hilcell.compensation.grid import GridError, MeasuredGrid
from hilcell.geometry.inverse import NominalRobot
from hilcell.geometry.kinematics import Array
from hilcell.identification.curve import TransmissionCurve


@dataclass(frozen=True, eq=False)
class StaticPoses:
    """M poses at rest: joints (M, 6) as commanded, nominal and actual positions (M, 3) in {B}.

    ``covariance_mm2`` (M, 3, 3) is that of each averaged reading, NaN where it is unknown.
    """

    joints_rad: Array
    nominal_mm: Array
    actual_mm: Array
    covariance_mm2: Array

    def __post_init__(self) -> None:
        count = len(self.joints_rad)
        for name, values, shape in (
            ("joints", self.joints_rad, (count, 6)),
            ("nominal positions", self.nominal_mm, (count, 3)),
            ("actual positions", self.actual_mm, (count, 3)),
            ("covariances", self.covariance_mm2, (count, 3, 3)),
        ):
            if np.shape(values) != shape:
                raise GridError(f"poses: {name} of shape {np.shape(values)}, wanted {shape}")

    def __len__(self) -> int:
        return len(self.joints_rad)


@dataclass(frozen=True, eq=False)
class OtherReflectors:
    """The K - 1 reflectors on the flange besides the tool point, at the same M poses.

    ``places_mm`` (K - 1, 3) are nominal, on the flange, ``actual_mm`` (M, K - 1, 3) in {B}, NaN
    where one was not measured, ``covariance_mm2`` (M, K - 1, 3, 3) that of the averaged readings.
    """

    places_mm: Array
    actual_mm: Array
    covariance_mm2: Array


@dataclass(frozen=True, eq=False)
class Measured:
    """The grid for models of space, all poses and the curves for models of the arm.

    ``others`` tell of the tool's orientation; None where one reflector was measured. Two with the
    same numbers are equal: models learnt from either are the same.
    """

    grid: MeasuredGrid
    robot: NominalRobot
    poses: StaticPoses
    curves: tuple[TransmissionCurve, ...] = ()
    others: OtherReflectors | None = None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Measured) and self._content == other._content

    def __hash__(self) -> int:
        return hash(self._content)

    @cached_property
    def _content(self) -> Any:
        return _plain((self.grid, self.robot, self.poses, self.curves, self.others))


def _plain(value: Any) -> Any:
    """Return a value's numbers as something that can be compared and hashed."""
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    if is_dataclass(value):
        return tuple(_plain(getattr(value, field.name)) for field in fields(value))
    return value
