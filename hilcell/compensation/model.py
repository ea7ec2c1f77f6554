"""Models of a robot's errors: nominal poses in, predicted errors and their covariance out.

A model is one class, learnt from errors at poses at rest and registered in
`hilcell.compensation.model_choice`; nothing else in the core names it.
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
from hilcell.geometry.statistics import lengths_mm
from hilcell.identification.kinematics import TransmissionCurve
from hilcell.identification.known_arm import KnownArm
from hilcell.identification.measured_poses import IdentificationError, Readings, pose_folds
from hilcell.ports import HilcellError


@dataclass(frozen=True, eq=False)
class StaticPoses:
    """M poses at rest: joints (M, n) as commanded, nominal poses (M, 4, 4), errors e = actual -
    nominal (M, 3) of their positions.

    ``covariance_mm2`` (M, 3, 3): of each averaged reading, NaN where unknown. Poses of one ``fold``
    (M,) are left out together.
    """

    joints_rad: Array
    nominal: Array
    error_mm: Array
    covariance_mm2: Array
    fold: Ints

    def __post_init__(self) -> None:
        rows = {"nominal": (4, 4), "error_mm": (3,), "covariance_mm2": (3, 3)}
        for name, row in rows.items():
            found, shape = np.shape(getattr(self, name)), (len(self.joints_rad), *row)
            if found != shape:
                raise GridError(f"poses: {name} of shape {found}, expected {shape}")

    @classmethod
    def of(cls, joints_rad: Array, nominal: Array, error_mm: Array, covariance_mm2: Array) -> Self:
        return cls(joints_rad, nominal, error_mm, covariance_mm2, pose_folds(joints_rad))

    def __len__(self) -> int:
        return len(self.joints_rad)

    def at(self, some: Bools) -> Self:
        return type(self)(*(getattr(self, field.name)[some] for field in fields(self)))


@dataclass(frozen=True, eq=False)
class MeasuredArm:
    """The nominal robot, positions of its reflectors at M poses, in {B}, and the gears' curves.

    ``seats_mm`` (K, 3): the reflectors' nominal positions on the flange, the tool point first.
    ``known``: the arm of the calibration from which this one starts. Instances with the same
    numbers are equal.
    """

    robot: NominalRobot
    readings: Readings
    seats_mm: Array
    curves: tuple[TransmissionCurve, ...] = ()
    known: KnownArm | None = None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MeasuredArm) and self._content == other._content

    def __hash__(self) -> int:
        return hash(self._content)

    @cached_property
    def _content(self) -> object:
        return _plain((self.robot, self.readings, self.seats_mm, self.curves, self.known))


@dataclass(frozen=True, eq=False)
class Measured:
    """All poses; the ``lattice`` of some of them for spatial models, readings for models of the
    arm. None where not measured.
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
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    if is_dataclass(value):
        return tuple(_plain(getattr(value, field.name)) for field in fields(value))
    return value


class ModelError(HilcellError):
    """Invalid parameters of a model."""

    code = "HC-C21"


@dataclass(frozen=True, eq=False, slots=True)
class PredictedOrientation:
    """Orientation errors at N targets as rotation vectors (N, 3), covariances (N, 3, 3). actual =
    exp(vector) nominal, so that the axes are those of the model's frame.
    """

    error_rad: Array
    covariance_rad2: Array


@dataclass(frozen=True, eq=False, slots=True)
class Prediction:
    """Errors e = actual - nominal (N, 3) at N targets, covariances (N, 3, 3), NaN where unknown.

    ``orientation``: None where the model predicts positions only. The covariance covers parameters,
    residual and the repeatability of one visit, as shown by the training data. The frame is the
    model's.
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
    """A model learnt from measured poses, judged, chosen and stored in a calibration file.

    A subclass is a frozen dataclass of arrays in `hilcell.compensation.model_choice.MODELS`;
    ``text``: its description in a report; ``any_orientation``: valid for other orientations than
    the grid's; ``scattered``: learns from arbitrary poses; others need a lattice, or the arm's
    readings.
    """

    name: ClassVar[str]
    text: ClassVar[str]
    any_orientation: ClassVar[bool] = False
    scattered: ClassVar[bool] = True

    @classmethod
    @abstractmethod
    def learn(cls, measured: Measured) -> LearntModel:
        """Learn; raises `HilcellError` where the measurements are not sufficient."""

    @classmethod
    def left_out_mm(cls, measured: Measured) -> Array:
        """Predicted minus measured errors (M, 3) of poses that were not learnt from."""
        poses = measured.poses
        if not len(poses):
            raise IdentificationError(f"{cls.name}: no pose was measured")
        missed_mm = -poses.error_mm
        for fold in np.unique(poses.fold):
            out = poses.fold == fold
            model = cls.learn(Measured(poses.at(~out)))
            missed_mm[out] += model.predict(poses.nominal[out]).error_mm
        return missed_mm

    @classmethod
    def left_out_sizes_mm(cls, measured: Measured) -> Array:
        """Lengths (M,) of the errors at poses left out, as targets have them."""
        return lengths_mm(cls.left_out_mm(measured))

    @abstractmethod
    def predict(self, poses: Array) -> Prediction:
        """Return the errors at nominal poses (N, 4, 4) in {B}; raises `HilcellError` outside."""

    @classmethod
    def restore(cls, grid: Grid, errors_mm: Array, parameters: Json) -> Self:
        """Model of a calibration file; raises `ModelError` for invalid parameters. The file has the
        grid's errors (nx, ny, nz, 3) beside the model's own parameters.
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
        """Input of `restore` besides the grid's errors, as plain JSON values."""
        return {field.name: getattr(self, field.name).tolist() for field in fields(self)}
