"""The calibration file: one JSON schema with a version.

Lengths in mm, frames as homogeneous matrices; grid errors in {B}, so that they are valid at every
station. One changed digit corrects every target wrongly, so the file has a seal and is checked
before use.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from itertools import chain
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from hilcell.atomic_files import write_whole
from hilcell.calibration.influence import SIZE, NoBound, UncertaintyBudget
from hilcell.calibration.tool_point import AT_REFLECTOR, Tip
from hilcell.cell.settings import SettingsError, read_file
from hilcell.compensation.correction import corrected_poses
from hilcell.compensation.grid import Grid
from hilcell.compensation.model import ErrorModel
from hilcell.compensation.model_choice import MODELS
from hilcell.compensation.residual import Pass, TargetResiduals, WithTargetResiduals
from hilcell.decoding import Json, decoded, typed
from hilcell.geometry.frames import (
    apply,
    inverse,
    is_rotation,
    matrix,
    poses_from_zyx,
    turned_deg,
    zyx_from_pose,
)
from hilcell.geometry.kinematics import Bools
from hilcell.model.calibration import Provenance, StationEntry
from hilcell.model.outcome import Outcome
from hilcell.model.verdicts import Judged
from hilcell.ports import Array, HilcellError
from hilcell.sanitize import counted

SCHEMA = 6  # to be raised whenever `Calibration` changes, or what its fields mean
SEAL = "seal"
NAMED = 5  # targets that one message names


class Validity(msgspec.Struct, frozen=True):
    """Range of validity: the cube in {B}, orientation, measured temperatures. ``temperature_c``:
    None without a weather station; ``orientations``: those measured besides.
    """

    low_mm: tuple[float, float, float]
    high_mm: tuple[float, float, float]
    orientation: list[list[float]]
    orientation_tolerance_deg: float
    temperature_c: tuple[float, float] | None
    orientations: list[list[list[float]]] = []

    def turned_deg(self, poses: Array) -> Array:
        """Rotations (N,) of poses (N, 4, 4) in {B} from the nearest orientation, deg."""
        known = (self.orientation, *self.orientations)
        angles_deg = [turned_deg(np.array(R), poses) for R in known]
        return np.asarray(np.min(angles_deg, axis=0))

    def points_back(self, poses: Array) -> Bools:
        """Which poses (N, 4, 4) in {B} have z opposite to every calibrated one, (N,). Within the
        tolerance of the axis; rotation about it does not matter.
        """
        axes = np.array([self.orientation, *self.orientations])[:, :, 2]
        against = np.clip(-(poses[:, :3, 2] @ axes.T), -1.0, 1.0).max(axis=1)
        return np.asarray(np.degrees(np.arccos(against)) <= self.orientation_tolerance_deg)


class LostMotion(msgspec.Struct, frozen=True):
    """Lost motion of axes 1 to 6 at reversal, and 1 sigma of it, rad.

    An axis that arrives from above is lower by it than one that arrives from below. ``measured``:
    by the run, for axes 1 to 3.
    """

    lost_rad: list[float]
    u_rad: list[float]
    measured: bool


class Circle(msgspec.Struct, frozen=True):
    """Points of one of the base's circles: commanded joints (N, 6), and positions (N, 3) in the {B}
    that the circles made.
    """

    joints_deg: list[list[float]]
    at_mm: list[tuple[float, float, float]]


class ModelEntry(msgspec.Struct, frozen=True):
    """The model's name and parameters, typed by `LearntModel.restore`."""

    name: str
    parameters: Json


class TargetPass(msgspec.Struct, frozen=True):
    """Targets measured in one run: names, commanded poses x, y, z (mm), a, b, c (deg) in {B}.

    Residual errors of the model (N, 3) in mm, their covariance (N, 3, 3) from visit and reading,
    and that of the frames (7, 7) as in `Influence`, about the origin of {B}.
    """

    run: str
    names: list[str]
    poses: list[tuple[float, float, float, float, float, float]]
    residuals_mm: list[tuple[float, float, float]] = msgspec.field(name="remainders_mm")
    own_mm2: list[list[list[float]]]
    common: list[list[float]]

    def without(self, names: Collection[str]) -> TargetPass:
        kept = [n for n, name in enumerate(self.names) if name not in names]
        return msgspec.structs.replace(
            self,
            names=[self.names[n] for n in kept],
            poses=[self.poses[n] for n in kept],
            residuals_mm=[self.residuals_mm[n] for n in kept],
            own_mm2=[self.own_mm2[n] for n in kept],
        )

    def measured(self) -> Pass:
        return Pass(
            poses_from_zyx(np.array(self.poses, dtype=float).reshape(-1, 6)),
            np.array(self.residuals_mm, dtype=float).reshape(-1, 3),
            np.array(self.own_mm2, dtype=float).reshape(-1, 3, 3),
            np.array(self.common, dtype=float),
        )


class Targets(msgspec.Struct, frozen=True):
    """Passes over targets, and the variance of one coordinate used to fold them in."""

    variance_mm2: float
    passes: list[TargetPass]

    def residuals(self) -> TargetResiduals:
        return TargetResiduals([each.measured() for each in self.passes], self.variance_mm2)


class Calibration(msgspec.Struct, frozen=True, dict=True):
    """The file; ``targets`` were measured by later runs, ``circles`` of axes 1 and 6 by its own.

    ``verdicts``: of the validation by place, none without validation; ``failed``: other failed
    verdicts of the run as text, suspicions included.
    """

    schema: int
    provenance: Provenance
    validity: Validity
    stations: dict[str, StationEntry]
    pitch_mm: float
    grid_errors_mm: list[list[list[tuple[float, float, float]]]]
    model: ModelEntry
    uncertainty: UncertaintyBudget
    lost_motion: LostMotion
    verdicts: dict[str, Judged]
    failed: dict[str, str]
    circles: list[Circle] = []
    targets: Targets | None = None

    @property
    def budget(self) -> UncertaintyBudget:
        """Budget of corrected targets; raises `NoBound` where there is none."""
        if self.uncertainty.missing:
            raise NoBound(self.uncertainty.missing)
        return self.uncertainty

    def grid(self) -> Grid:
        errors = np.array(self.grid_errors_mm)
        shape = (errors.shape[0], errors.shape[1], errors.shape[2])
        return Grid(np.array(self.validity.low_mm), self.pitch_mm, shape)

    def base(self, station: str) -> Array:
        """{B} in {W} (4, 4) at a station."""
        return np.array(self.stations[station].T_W_B)

    def poses_at(self, places_mm: Array) -> Array:
        """Poses (N, 4, 4) in {B} at positions (N, 3), in the calibrated orientation."""
        return matrix(np.array(self.validity.orientation), places_mm)

    def error_model(self) -> ErrorModel:
        """The model, targets folded in; raises `HilcellError` for invalid parameters."""
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
            model if self.targets is None else WithTargetResiduals(model, self.targets.residuals())
        )

    def learnt_model(self) -> ErrorModel:
        errors_mm = np.array(self.grid_errors_mm)
        return MODELS[self.model.name].restore(self.grid(), errors_mm, self.model.parameters)


def written_now() -> str:
    return f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"


def write_calibration(calibration: Calibration, path: Path) -> None:
    """Write the file atomically, with its seal; raises `NotWritten`."""
    content = msgspec.json.decode(msgspec.json.encode(calibration))
    text = msgspec.json.encode(content | {SEAL: _seal(content)})
    write_whole(path, msgspec.json.format(text, indent=1) + b"\n")


def read_calibration(path: Path) -> Calibration:
    """Read the file; raises `SettingsError` unless complete and consistent."""
    data = read_file(path)
    try:
        schema = decoded(data, _Head).schema
        if schema != SCHEMA:
            problem = f"schema {schema:.6g}, expected {SCHEMA}; calibrate again"
            raise SettingsError(str(path), [problem])
        content = msgspec.json.decode(data)
        problems = seal_problems(content)
        calibration = typed(content, Calibration)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, OverflowError) as error:
        raise SettingsError(str(path), [f"not a calibration file: {error}"]) from error
    problems += file_problems(calibration)
    if problems:
        raise SettingsError(str(path), problems)
    return calibration


def _seal(content: Json) -> str:
    """SHA-256 of everything except the seal: detects damage, no signature."""
    rest = {key: value for key, value in content.items() if key != SEAL}
    return hashlib.sha256(msgspec.json.encode(rest, order="sorted")).hexdigest()


def seal_problems(content: Json) -> list[str]:
    if content.get(SEAL) == _seal(content):
        return []
    return ["was changed after it was written: its seal does not hold; take the run's own file"]


class _Head(msgspec.Struct):
    schema: int


def compensate_targets(
    calibration: Calibration,
    station: str,
    targets: Array,
    names: list[str],
    tip: Tip = AT_REFLECTOR,
) -> Array:
    """Poses to command, (N, 6) in {W}, for nominal ``targets`` (N, 6), both of the ``tip``. Raises
    `HilcellError` naming those outside of the calibrated volume or orientation.
    """
    if station not in calibration.stations:
        known = ", ".join(calibration.stations)
        raise HilcellError(f"station {station!r} is not calibrated; calibrated: {known}")
    far = np.flatnonzero(~(np.abs(targets).max(axis=1) <= MOST_MM))
    if len(far):
        named = ", ".join(names[n] for n in far[:NAMED])
        raise HilcellError(
            f"{counted(len(far), 'target')} not in the cell, expected within +-{MOST_MM:g} mm and "
            f"deg; correct the numbers: {named}"
        )
    T_W_B = calibration.base(station)
    poses = poses_from_zyx(targets)
    in_base = inverse(T_W_B) @ poses @ tip.T_D_T  # of {T}
    _refuse_orientations(calibration, in_base, names)
    model = calibration.error_model()
    sent = corrected_poses(calibration.grid(), in_base, model, names=names) @ tip.T_T_D
    poses[:, :3, 3] = apply(T_W_B, sent[:, :3, 3])
    if not calibration.orients:
        return zyx_from_pose(poses)
    poses[:, :3, :3] = T_W_B[:3, :3] @ sent[:, :3, :3]
    commands = zyx_from_pose(poses)
    beside = commands.copy()
    beside[:, 3:] += 360.0 * np.round((targets[:, 3:] - commands[:, 3:]) / 360.0)
    return beside


def _refuse_orientations(calibration: Calibration, poses: Array, names: list[str]) -> None:
    found_deg = calibration.validity.turned_deg(poses)
    limit_deg = calibration.validity.orientation_tolerance_deg
    far = np.flatnonzero(~(found_deg <= limit_deg))
    inward = np.flatnonzero(calibration.validity.points_back(poses))
    if len(inward):
        named = ", ".join(names[n] for n in inward[:NAMED])
        raise HilcellError(
            f"the tool's z points out of the part at {len(inward)} of "
            f"{counted(len(names), 'target')}, expected into it, against the outward normal; turn "
            f"them: {named}"
        )
    if len(far):
        named = ", ".join(f"{names[n]} by {found_deg[n]:.2f} deg" for n in far[:NAMED])
        raise HilcellError(
            f"{len(far)} of {counted(len(names), 'target')} turned away from the calibrated "
            f"orientation, expected <= {limit_deg} deg: {named}; calibrate with "
            "their orientation, or for more than one with plan.tilt_deg or plan.grid_orientations"
        )


MOST_MM = 1e6


def file_problems(calibration: Calibration) -> list[str]:
    """All problems as text, each with the name of its field."""
    checks = _Checks(calibration)
    problems = [
        *checks.name(),
        *checks.validity(),
        *checks.grid(),
        *checks.stations(),
        *checks.uncertainty(),
        *checks.lost_motion(),
        *checks.updates(),
        *checks.targets(),
        *checks.verdicts(),
    ]
    return problems or list(checks.model())


@dataclass(frozen=True, eq=False)
class _Checks:
    MOST_ERROR_MM = 100.0  # beyond is no robot's error
    MOST_ROTATION_DEG = 180.0
    MOST_C = 100.0

    calibration: Calibration

    def name(self) -> Iterator[str]:
        name = self.calibration.model.name
        if name not in MODELS:
            yield f"model.name: {name[:40]!r} is unknown; known here: {', '.join(MODELS)}"

    def model(self) -> Iterator[str]:
        """Yield why an otherwise valid file gives no model."""
        try:
            self.calibration.error_model()
        except HilcellError as error:
            yield f"model.parameters: {error}"

    def validity(self) -> Iterator[str]:
        validity = self.calibration.validity
        for name, corner in (("low_mm", validity.low_mm), ("high_mm", validity.high_mm)):
            yield from self._within(f"validity.{name}", corner, MOST_MM, "mm")
        yield from self._rotation("validity.orientation", self._array(validity.orientation))
        for number, R in enumerate(validity.orientations):
            yield from self._rotation(f"validity.orientations.{number}", self._array(R))
        tolerance_deg = validity.orientation_tolerance_deg
        name = "validity.orientation_tolerance_deg"
        yield from self._positive(name, tolerance_deg, self.MOST_ROTATION_DEG)
        if validity.temperature_c is None:
            return
        yield from self._within("validity.temperature_c", validity.temperature_c, self.MOST_C, "C")
        low_c, high_c = validity.temperature_c
        if not low_c <= high_c:
            yield f"validity.temperature_c: {low_c:g} .. {high_c:g}, expected the lower first"

    def grid(self) -> Iterator[str]:
        errors = self._array(self.calibration.grid_errors_mm)
        if errors.ndim != 4 or min(errors.shape[:3]) < 2:
            yield "grid_errors_mm: ragged, or less than 2 vertices along an axis"
            return
        yield from self._within("grid_errors_mm", errors, self.MOST_ERROR_MM, "mm")
        pitch_mm = self.calibration.pitch_mm
        size_mm = np.subtract(self.calibration.validity.high_mm, self.calibration.validity.low_mm)
        expected_mm = pitch_mm * (np.array(errors.shape[:3]) - 1)
        whole = 1e-6  # of a pitch: its numbers are rounded
        if not (pitch_mm > 0 and np.abs(size_mm - expected_mm).max() <= whole * pitch_mm):
            counts = " x ".join(map(str, errors.shape[:3]))
            sides = " x ".join(f"{side:g}" for side in size_mm)
            yield (
                f"pitch_mm: {counts} vertices {pitch_mm:g} mm apart do not fill the validity's "
                f"{sides} mm"
            )

    def stations(self) -> Iterator[str]:
        stations = self.calibration.stations
        if not stations:
            yield "stations: there is none"
        for name, station in stations.items():
            at = f"stations.{name[:40]}"
            yield from self._frame(f"{at}.T_W_B", self._array(station.T_W_B))
            yield from self._frame(f"{at}.T_W_S", self._array(station.T_W_S))
            covariance = self._array(station.covariance)
            if covariance.shape != (6, 6) or not np.isfinite(covariance).all():
                yield f"{at}.covariance: expected 6 x 6 finite numbers"
            tool_mm = station.tool_uncertainty_mm
            yield from self._not_negative(f"{at}.tool_uncertainty_mm", tool_mm, self.MOST_ERROR_MM)
            yield from self._within(f"{at}.strip_mm", station.strip_mm, MOST_MM, "mm")

    def uncertainty(self) -> Iterator[str]:
        stated = self.calibration.uncertainty
        if stated.missing:
            return
        if stated.stations.keys() != self.calibration.stations.keys():
            found = ", ".join(stated.stations) or "none"
            yield f"uncertainty.stations: of {found[:40]}, expected the same as in stations"
        if stated.model_samples is not None:
            yield from self._positive("uncertainty.model_samples", stated.model_samples)
        yield from self._not_negative("uncertainty.growth_per_k", stated.growth_per_k, self.MOST_C)
        yield from self._not_negative("uncertainty.air_range_k", stated.air_range_k, self.MOST_C)
        for each in chain(stated.lines, *stated.stations.values()):
            at = f"uncertainty, {each.name[:40]}"
            yield from self._within(f"{at}: origin_mm", each.origin_mm, MOST_MM, "mm")
            if not self._is_covariance(self._array(each.covariance)):
                yield f"{at}: expected a covariance of {SIZE} x {SIZE} numbers"
            if each.freedom is not None:
                yield from self._positive(f"{at}: freedom", each.freedom)

    def lost_motion(self) -> Iterator[str]:
        lost = self.calibration.lost_motion
        most_lost_rad = 0.1
        axes = 6
        for name, values in (("lost_rad", lost.lost_rad), ("u_rad", lost.u_rad)):
            if len(values) != axes:
                yield f"lost_motion.{name}: {len(values)} axes, expected {axes}"
            else:
                yield from self._within(f"lost_motion.{name}", values, most_lost_rad, "rad")
        if not all(each >= 0.0 for each in lost.u_rad):
            yield "lost_motion.u_rad: a standard deviation below zero"

    def updates(self) -> Iterator[str]:
        for update in self.calibration.provenance.updates:
            at = f"provenance.updates of run {update.run[:40]}"
            expected = (6,) if update.what == "base" else (0,)
            if self._array(update.motion).shape != expected:
                yield f"{at}: motion of {len(update.motion)} numbers, expected {expected[0]}"
            elif update.motion:
                yield from self._within(f"{at}: motion", update.motion, self.MOST_ERROR_MM, "mm")

    def targets(self) -> Iterator[str]:
        if self.calibration.targets is None:
            return
        variance_mm2, most_mm2 = self.calibration.targets.variance_mm2, self.MOST_ERROR_MM**2
        yield from self._positive("targets.variance_mm2", variance_mm2, most_mm2)
        for each in self.calibration.targets.passes:
            at, count = f"targets of run {each.run[:40]}", len(each.names)
            for name, values, shape, most in (
                ("poses", each.poses, (count, 6), MOST_MM),
                ("remainders_mm", each.residuals_mm, (count, 3), self.MOST_ERROR_MM),
                ("own_mm2", each.own_mm2, (count, 3, 3), self.MOST_ERROR_MM**2),
            ):
                found = self._array(values)
                if found.shape != shape or not np.abs(found).max() <= most:
                    yield f"{at}: {name}: expected {count} rows of finite numbers within +-{most:g}"
                elif name == "own_mm2" and not np.linalg.eigvalsh(found).min() > 0:
                    yield f"{at}: own_mm2: a variance that is not above 0"
            if not self._is_covariance(self._array(each.common)):
                yield f"{at}: common: expected a covariance of {SIZE} x {SIZE} finite numbers"

    def verdicts(self) -> Iterator[str]:
        for place, each in self.calibration.verdicts.items():
            at = f"verdicts.{place[:40]}"
            figures = (each.mean_mm, each.max_mm, each.mean_U_mm, each.max_U_mm)
            if not all(0 <= figure <= MOST_MM for figure in figures):
                shown = ", ".join(f"{each:g}" for each in figures)
                yield f"{at}: {shown}, expected 0 .. {MOST_MM:g} mm"
            elif not all(0 <= deg <= self.MOST_ROTATION_DEG for deg in each.orientation or ()):
                yield (
                    f"{at}: orientation {each.orientation}, expected 0 .. "
                    f"{self.MOST_ROTATION_DEG:g} deg"
                )
            elif not all(limit is None or limit > 0 for limit in each.limits):
                yield f"{at}: a tolerance that is not above 0"
            elif each.holds and any(of.outcome is not Outcome.ACCEPTED for of in each.figures):
                yield f"{at}: passes, but its figures fail: {each.figures_text}"

    @staticmethod
    def _is_covariance(covariance: Array) -> bool:
        most_variance = 1e12  # mm2, rad2, or a ratio squared
        if covariance.shape != (SIZE, SIZE) or not np.abs(covariance).max() <= most_variance:
            return False
        rounding = 1e-6  # of a covariance, relative
        if not np.abs(covariance - covariance.T).max() <= rounding * np.abs(covariance).max():
            return False
        least_variance = 1e-30  # likewise; below is 0
        scale = np.sqrt(np.maximum(np.diag(covariance), least_variance))
        return bool(np.linalg.eigvalsh(covariance / np.outer(scale, scale)).min() >= -rounding)

    @staticmethod
    def _frame(name: str, frame: Array) -> Iterator[str]:
        if frame.shape != (4, 4):
            yield f"{name}: expected 4 x 4 numbers"
            return
        if not np.array_equal(frame[3], [0, 0, 0, 1]):
            yield f"{name}: its last row must be 0, 0, 0, 1"
        yield from _Checks._rotation(name, frame[:3, :3])
        yield from _Checks._within(name, frame[:3, 3], MOST_MM, "mm")

    @staticmethod
    def _positive(name: str, value: float, most: float = math.inf) -> Iterator[str]:
        if not 0 < value <= most:
            limit = f", <= {most:g}" if most < math.inf else ""
            yield f"{name}: {value:g}, expected above 0{limit}"

    @staticmethod
    def _not_negative(name: str, value: float, most: float) -> Iterator[str]:
        if not 0 <= value <= most:
            yield f"{name}: {value:g}, expected 0 .. {most:g}"

    @staticmethod
    def _array(nested: ArrayLike) -> Array:
        """Array of numbers, empty where the lists are ragged."""
        try:
            return np.array(nested, dtype=float)
        except ValueError:
            return np.full(0, math.nan)

    @staticmethod
    def _rotation(name: str, R: Array) -> Iterator[str]:
        if R.shape != (3, 3):
            yield f"{name}: expected 3 x 3 numbers"
        elif not is_rotation(R):
            yield f"{name}: is not rigid: its rotation stretches, shears or mirrors"

    @staticmethod
    def _within(name: str, values: ArrayLike, most: float, unit: str) -> Iterator[str]:
        largest = float(np.abs(np.asarray(values, dtype=float)).max())
        if not largest <= most:
            yield f"{name}: {largest:g} {unit}, expected within +-{most:g} {unit}"
