"""The robot's error as measured at poses at rest; where they are a lattice, and of which arm."""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property
from typing import Self

import numpy as np

from hilcell.compensation.grid import GridError, MeasuredGrid
from hilcell.geometry.inverse import NominalRobot
from hilcell.geometry.kinematics import Array, Bools, Ints
from hilcell.identification.kinematics import TransmissionCurve
from hilcell.identification.readings import Readings, folds_of


@dataclass(frozen=True, eq=False)
class StaticPoses:
    """M poses at rest: joints (M, 6) as commanded, nominal poses (M, 4, 4), errors e = actual -
    nominal (M, 3) of their positions.

    ``covariance_mm2`` (M, 3, 3) is that of each averaged reading, NaN where it is unknown. Poses of
    one ``fold`` (M,) are left out together.
    """

    joints_rad: Array
    nominal: Array
    error_mm: Array
    covariance_mm2: Array
    fold: Ints

    def __post_init__(self) -> None:
        count = len(self.joints_rad)
        for name, values, shape in (
            ("joints", self.joints_rad, (count, 6)),
            ("nominal poses", self.nominal, (count, 4, 4)),
            ("errors", self.error_mm, (count, 3)),
            ("covariances", self.covariance_mm2, (count, 3, 3)),
        ):
            if np.shape(values) != shape:
                raise GridError(f"poses: {name} of shape {np.shape(values)}, expected {shape}")

    @classmethod
    def of(cls, joints_rad: Array, nominal: Array, error_mm: Array, covariance_mm2: Array) -> Self:
        """Return the poses with folds that leave each out as a whole."""
        return cls(joints_rad, nominal, error_mm, covariance_mm2, folds_of(joints_rad))

    def __len__(self) -> int:
        return len(self.joints_rad)

    def at(self, some: Bools) -> Self:
        """Return some of the poses, in their folds."""
        return type(self)(*(getattr(self, field.name)[some] for field in fields(self)))


@dataclass(frozen=True, eq=False)
class MeasuredArm:
    """The nominal robot, where its reflectors were at M poses, in {B}, and the gears' curves.

    ``seats_mm`` (K, 3) are the reflectors' nominal places on the flange, the tool point first. Two
    with the same numbers are equal: models learnt from either are the same.
    """

    robot: NominalRobot
    readings: Readings
    seats_mm: Array
    curves: tuple[TransmissionCurve, ...] = ()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MeasuredArm) and self._content == other._content

    def __hash__(self) -> int:
        return hash(self._content)

    @cached_property
    def _content(self) -> object:
        return _plain((self.robot, self.readings, self.seats_mm, self.curves))


@dataclass(frozen=True, eq=False)
class Measured:
    """All poses; for models of space the ``lattice`` that some of them are, for models of the arm
    its readings. None where nothing of the kind was measured.
    """

    poses: StaticPoses
    lattice: MeasuredGrid | None = None
    arm: MeasuredArm | None = None

    @property
    def grid(self) -> MeasuredGrid:
        """Return the lattice; raises `GridError` without one."""
        if self.lattice is None:
            raise GridError("the measured poses are not a lattice")
        return self.lattice


def _plain(value: object) -> object:
    """Return a value's numbers as something that can be compared and hashed."""
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    if is_dataclass(value):
        return tuple(_plain(getattr(value, field.name)) for field in fields(value))
    return value
