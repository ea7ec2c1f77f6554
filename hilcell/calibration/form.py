"""The form of a calibration file: its tables as typed structures, nothing else.

All lengths mm, frames as homogeneous matrices; the errors of the grid stand in {B}.
"""

from __future__ import annotations

from collections.abc import Collection
from datetime import UTC, datetime
from functools import cached_property

import msgspec
import numpy as np

from hilcell.calibration.influence import NoBound, Uncertainty
from hilcell.compensation.grid import Grid
from hilcell.compensation.model import ErrorModel
from hilcell.compensation.model_choice import MODELS
from hilcell.compensation.residual import Pass, TargetResiduals, WithTargetResiduals
from hilcell.decoding import Json
from hilcell.geometry.frames import matrix, poses_from_zyx, turned_deg
from hilcell.geometry.kinematics import Bools
from hilcell.model.calibration import Provenance, StationEntry
from hilcell.model.verdicts import Judged
from hilcell.ports import Array


class Validity(msgspec.Struct, frozen=True):
    """Where the calibration holds: the cube in {B}, one orientation, the measured temperatures.

    ``temperature_c`` is None where the tracker had no weather station, ``orientations`` are those
    that were measured besides.
    """

    low_mm: tuple[float, float, float]
    high_mm: tuple[float, float, float]
    orientation: list[list[float]]
    orientation_tolerance_deg: float
    temperature_c: tuple[float, float] | None
    orientations: list[list[list[float]]] = []

    def turned_deg(self, poses: Array) -> Array:
        """Return by how much poses (N, 4, 4) in {B} are turned from the nearest of all (N,)."""
        known = (self.orientation, *self.orientations)
        angles_deg = [turned_deg(np.array(R), poses) for R in known]
        return np.asarray(np.min(angles_deg, axis=0))

    def points_back(self, poses: Array) -> Bools:
        """Return which poses (N, 4, 4) in {B} have z against every calibrated one's, (N,).

        Within the tolerance of the axis: the turn about it does not matter.
        """
        axes = np.array([self.orientation, *self.orientations])[:, :, 2]
        against = np.clip(-(poses[:, :3, 2] @ axes.T), -1.0, 1.0).max(axis=1)
        return np.asarray(np.degrees(np.arccos(against)) <= self.orientation_tolerance_deg)


class LostMotion(msgspec.Struct, frozen=True):
    """The lost motion of axes 1 to 6 when they reverse, and 1 sigma of it, in rad.

    An axis that comes from above stands lower by it than one that comes from below. ``measured``
    says that the run measured it, of axes 1 to 3.
    """

    lost_rad: list[float]
    u_rad: list[float]
    measured: bool


class ModelEntry(msgspec.Struct, frozen=True):
    """The model by its name, with its own parameters: typed by `LearntModel.restore`."""

    name: str
    parameters: Json


class TargetPass(msgspec.Struct, frozen=True):
    """Targets measured in one run: names, commanded poses x, y, z (mm), a, b, c (deg) in {B}, what
    the model left of the error there (N, 3) in mm, its covariance (N, 3, 3) from visit and reading,
    and that of the frames (7, 7) as in `Influence`, about the origin of {B}.
    """

    run: str
    names: list[str]
    poses: list[tuple[float, float, float, float, float, float]]
    remainders_mm: list[tuple[float, float, float]]
    own_mm2: list[list[list[float]]]
    common: list[list[float]]

    def without(self, names: Collection[str]) -> TargetPass:
        kept = [n for n, name in enumerate(self.names) if name not in names]
        return msgspec.structs.replace(
            self,
            names=[self.names[n] for n in kept],
            poses=[self.poses[n] for n in kept],
            remainders_mm=[self.remainders_mm[n] for n in kept],
            own_mm2=[self.own_mm2[n] for n in kept],
        )

    def measured(self) -> Pass:
        return Pass(
            poses_from_zyx(np.array(self.poses, dtype=float).reshape(-1, 6)),
            np.array(self.remainders_mm, dtype=float).reshape(-1, 3),
            np.array(self.own_mm2, dtype=float).reshape(-1, 3, 3),
            np.array(self.common, dtype=float),
        )


class Targets(msgspec.Struct, frozen=True):
    """Passes over targets, and the variance of one coordinate by which they are folded in."""

    variance_mm2: float
    passes: list[TargetPass]

    def remainder(self) -> TargetResiduals:
        return TargetResiduals([each.measured() for each in self.passes], self.variance_mm2)


class Calibration(msgspec.Struct, frozen=True, dict=True):
    """The file. ``targets`` are those that later runs have measured.

    ``verdicts`` are the validation's by place, none where it was not made. ``failed`` are other
    verdicts of the same run that do not hold, each in words, suspicions among them.
    """

    schema: int
    provenance: Provenance
    validity: Validity
    stations: dict[str, StationEntry]
    pitch_mm: float
    grid_errors_mm: list[list[list[tuple[float, float, float]]]]
    model: ModelEntry
    uncertainty: Uncertainty
    lost_motion: LostMotion
    verdicts: dict[str, Judged]
    failed: dict[str, str]
    targets: Targets | None = None

    @property
    def budget(self) -> Uncertainty:
        """Return the budget of corrected targets; raises `NoBound` where it states none."""
        if self.uncertainty.missing:
            raise NoBound(self.uncertainty.missing)
        return self.uncertainty

    def grid(self) -> Grid:
        """Return the grid in {B}."""
        errors = np.array(self.grid_errors_mm)
        shape = (errors.shape[0], errors.shape[1], errors.shape[2])
        return Grid(np.array(self.validity.low_mm), self.pitch_mm, shape)

    def base(self, station: str) -> Array:
        """Return {B} in {W} (4, 4) at a station."""
        return np.array(self.stations[station].T_W_B)

    def poses_at(self, places_mm: Array) -> Array:
        """Return poses (N, 4, 4) in {B} at places (N, 3), in the calibrated orientation."""
        return matrix(np.array(self.validity.orientation), places_mm)

    def error_model(self) -> ErrorModel:
        """Return the model, targets folded in; raises `HilcellError` for parameters of none."""
        return self._error_model

    @cached_property
    def orients(self) -> bool:
        """Whether it corrects the tool's orientation as well: several reflectors were measured."""
        middle_mm = (np.array(self.validity.low_mm) + np.array(self.validity.high_mm)) / 2
        return self.error_model().predict(self.poses_at(middle_mm[None])).orientation is not None

    @cached_property
    def _error_model(self) -> ErrorModel:  # to restore one and check it takes 7 ms
        model = self.learnt_model()
        return (
            model if self.targets is None else WithTargetResiduals(model, self.targets.remainder())
        )

    def learnt_model(self) -> ErrorModel:
        errors_mm = np.array(self.grid_errors_mm)
        return MODELS[self.model.name].restore(self.grid(), errors_mm, self.model.parameters)


def written_now() -> str:
    return f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"
