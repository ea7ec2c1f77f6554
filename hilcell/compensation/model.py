"""A model of a robot's errors: nominal poses in, predicted errors and their covariance out.

It is learnt from the errors that were measured at poses at rest. A model is one class,
registered in `hilcell.compensation.model_choice`; `hilcell run` and `hilcell fit` both learn, judge
and choose from those, and nothing else in the core names them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property
from typing import ClassVar, Protocol, Self

import numpy as np

from hilcell.compensation.grid import Grid, GridError, MeasuredGrid
from hilcell.decoding import Json
from hilcell.geometry.inverse import NominalRobot
from hilcell.geometry.kinematics import Array, Bools, Ints
from hilcell.identification.kinematics import TransmissionCurve
from hilcell.identification.measured_poses import IdentificationError, Readings, pose_folds
from hilcell.ports import HilcellError


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
        rows = {"joints_rad": (6,), "nominal": (4, 4), "error_mm": (3,), "covariance_mm2": (3, 3)}
        for name, row in rows.items():
            found, shape = np.shape(getattr(self, name)), (len(self.joints_rad), *row)
            if found != shape:
                raise GridError(f"poses: {name} of shape {found}, expected {shape}")

    @classmethod
    def of(cls, joints_rad: Array, nominal: Array, error_mm: Array, covariance_mm2: Array) -> Self:
        """Return the poses with folds that leave each out as a whole."""
        return cls(joints_rad, nominal, error_mm, covariance_mm2, pose_folds(joints_rad))

    def __len__(self) -> int:
        return len(self.joints_rad)

    def at(self, some: Bools) -> Self:
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


class ModelError(HilcellError):
    """Parameters of which no model can be made."""

    code = "HC-C21"


@dataclass(frozen=True, eq=False, slots=True)
class PredictedOrientation:
    """Errors of orientation at N targets as rotation vectors (N, 3), and their covariances
    (N, 3, 3): actual = exp(vector) nominal, so that the axes are those of the model's frame.
    """

    error_rad: Array
    covariance_rad2: Array


@dataclass(frozen=True, eq=False, slots=True)
class Prediction:
    """Errors e = actual - nominal (N, 3) at N targets, and their covariances (N, 3, 3), NaN where
    a calibration states none. ``orientation`` is None where the model knows positions only.

    The covariance covers parameters, residual and the repeatability of one visit, as far as the
    data that the model learnt from show it. The frame is the model's.
    """

    error_mm: Array
    covariance_mm2: Array
    orientation: PredictedOrientation | None = None


class ErrorModel(Protocol):
    """Predicts the robot's error of position, and of orientation if it can."""

    def predict(self, poses: Array) -> Prediction:
        """Return the errors at nominal poses (N, 4, 4) in {B}; raises `HilcellError` outside."""


@dataclass(frozen=True, eq=False)
class LearntModel(ABC):
    """A model that is learnt from measured poses, judged, chosen and stored in a calibration file.

    A subclass is a frozen dataclass of arrays in `hilcell.compensation.model_choice.MODELS`;
    ``text`` is its description in a report. ``any_orientation``: it is valid for other orientations
    than the grid's. ``scattered``: it learns from poses anywhere; others need a lattice, or the
    arm's readings.
    """

    name: ClassVar[str]
    text: ClassVar[str]
    any_orientation: ClassVar[bool] = False
    scattered: ClassVar[bool] = True

    @classmethod
    @abstractmethod
    def learn(cls, measured: Measured) -> LearntModel:
        """Return the model; raises `HilcellError` where what was measured is not enough."""

    @classmethod
    def left_out_mm(cls, measured: Measured) -> Array:
        """Return predicted less measured errors (M, 3) of poses that were not learnt from."""
        poses = measured.poses
        if not len(poses):
            raise IdentificationError(f"{cls.name}: no pose was measured")
        missed_mm = -poses.error_mm
        for fold in np.unique(poses.fold):
            out = poses.fold == fold
            model = cls.learn(Measured(poses.at(~out)))
            missed_mm[out] += model.predict(poses.nominal[out]).error_mm
        return missed_mm

    @abstractmethod
    def predict(self, poses: Array) -> Prediction:
        """Return the errors at nominal poses (N, 4, 4) in {B}; raises `HilcellError` outside."""

    @classmethod
    def restore(cls, grid: Grid, errors_mm: Array, parameters: Json) -> Self:
        """Return the model of a calibration file; raises `ModelError` for bad parameters.

        The file has the grid's errors (nx, ny, nz, 3) beside the model's own parameters.
        """
        try:
            found = {name: np.array(value, dtype=float) for name, value in parameters.items()}
            model = cls(**found)
        except (ValueError, TypeError) as error:
            raise ModelError(f"invalid parameters of model {cls.name}: {error}") from error
        if not all(np.isfinite(values).all() for values in found.values()):
            raise ModelError(f"invalid parameters of model {cls.name}: expected finite numbers")
        return model

    def parameters(self) -> Json:
        """Return what `restore` needs besides the grid's errors, as plain JSON values."""
        return {field.name: getattr(self, field.name).tolist() for field in fields(self)}
