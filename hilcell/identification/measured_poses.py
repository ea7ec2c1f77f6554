"""Static poses that were measured, and the scatter of their readings about a smooth model.

One row is a pose, one column a reflector. The scatter is estimated from the poses, with three
sources: the tracker's beyond the readings' covariance, independent from reading to reading; a shift
common to all reflectors of a pose; and the joints' (repeatability, short waves of gears). A source
of zero stays zero.

Joint noise alone does not describe several reflectors: at a nearly singular wrist it excludes
errors in some direction, and the few poses there outweigh all others (two real robots,
`docs/decisions/0010-kinematic-identification.md`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from hilcell.geometry.kinematics import Array, Bools, Ints
from hilcell.ports import HilcellError


class IdentificationError(HilcellError):
    """Poses that do not identify a robot's kinematics."""

    code = "HC-C22"


class ManyContradict(IdentificationError):
    """More outliers than slips explain."""


@dataclass(frozen=True, eq=False)
class Readings:
    """M poses: joints commanded (M, n) in rad, and positions of K reflectors, (M, K, 3) in mm.

    NaN: not measured. ``covariance_mm2`` (M, K, 3, 3) is that of each averaged reading, zero where
    unknown. The frame is the caller's: {B}, or a tracker's.
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
        return replace(
            self,
            joints_rad=self.joints_rad[poses],
            xyz_mm=self.xyz_mm[poses],
            covariance_mm2=self.covariance_mm2[poses],
        )

    def without(self, bad: Bools) -> Self:
        """Return the same poses with the readings of a mask (M, K) struck out."""
        return replace(self, xyz_mm=np.where(bad[..., None], np.nan, self.xyz_mm))


FOLDS = 5
SAME_RAD = np.radians(0.05)  # joints that differ by no more (.9 mm) lead to the same errors


def pose_numbers(joints_rad: Array) -> Ints:
    """Number (N,) of each row's pose, from 0.

    All joints (N, n) of a pose are within `SAME_RAD` of its first in ascending order, so that poses
    along a line of small steps stay distinct. Labels do not help: a re-measured pose has another
    label, but the same errors. The rows' order does not matter.
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


def turn_middles(joints_rad: Array, turning: Bools) -> Array:
    """Middle (n,) of the turn in which each revolute joint (N, n) was measured: opposite the
    largest gap of its angles, so that none of less than a turn moves. NaN for prismatic joints.
    """
    turn = 2.0 * np.pi
    middles = np.full(joints_rad.shape[1], np.nan)
    for n in np.flatnonzero(turning):
        low, high = joints_rad[:, n].min(), joints_rad[:, n].max()
        middles[n] = (low + high) / 2.0
        if high - low >= turn:
            angles = np.sort(joints_rad[:, n] % turn)
            gaps = np.diff(angles, append=angles[0] + turn)
            widest = int(np.argmax(gaps))
            middles[n] = angles[widest] + gaps[widest] / 2.0 + np.pi
    return middles


def count_poses(joints_rad: Array) -> int:
    return len(np.unique(pose_numbers(joints_rad)))


def places_of(joints_rad: Array) -> Array:
    """Place of each row (N,) in a scattered order of the poses, from 0 to less than 1. Any part of
    the order samples the whole space.
    """
    golden = (5.0**0.5 - 1.0) / 2.0  # its multiples scatter evenly, in step with no lattice
    return np.asarray(pose_numbers(joints_rad) * golden % 1.0, dtype=float)


def pose_folds(joints_rad: Array) -> Ints:
    """Return the fold (N,) in which each row is left out, one for all rows of a pose."""
    return (FOLDS * places_of(joints_rad)).astype(np.int_)


@dataclass(frozen=True, eq=False)
class Noise:
    """Standard deviations: of a coordinate of a reading, of a pose, and of the joints (n,)."""

    TYPICAL_MM, TYPICAL_RAD = 0.02, 30e-6  # where the estimate starts, and what few data lean on

    reading_mm: float
    pose_mm: float
    joint_rad: Array

    @classmethod
    def of_poses(cls, reflectors: int, joints: int = 6) -> Noise:
        pose_mm = cls.TYPICAL_MM if reflectors > 1 else 0.0
        return cls(cls.TYPICAL_MM, pose_mm, np.zeros(joints))

    @classmethod
    def of_joints(cls, reflectors: int = 1) -> Noise:
        """Return noise as `of_poses`, and of joints, to be estimated."""
        return replace(cls.of_poses(reflectors), joint_rad=np.full(6, cls.TYPICAL_RAD))

    @classmethod
    def independent(cls, reading_mm: float, joints: int = 6) -> Noise:
        return cls(reading_mm, 0.0, np.zeros(joints))

    def scaled(self, factor: float) -> Noise:
        return Noise(self.reading_mm * factor, self.pose_mm * factor, self.joint_rad * factor)

    def scatter(self, by_joint: Array) -> Array:
        """Return the covariances (M, K, 3, 3) of readings, each by itself."""
        levers = by_joint * self.joint_rad
        scatter: Array = levers @ np.swapaxes(levers, -1, -2)
        return scatter + (self.reading_mm**2 + self.pose_mm**2) * np.eye(3)

    def covariance(self, by_joint: Array, own_mm2: Array, known: Bools) -> Array:
        """Covariances (M, 3K, 3K) of the poses' readings.

        ``by_joint`` (M, K, 3, n) and each reading's own covariance (M, K, 3, 3). An unknown reading
        (M, K) has variance 1 and no effect on others.
        """
        levers, shifts = self._joined(by_joint, known), self._shifts(known)
        C: Array = np.einsum("mij,j,mkj->mik", levers, self.joint_rad**2, levers)
        C += self.pose_mm**2 * shifts @ np.swapaxes(shifts, 1, 2)
        for k in range(known.shape[1]):
            at = slice(3 * k, 3 * k + 3)
            own = own_mm2[:, k] + self.reading_mm**2 * np.eye(3)
            C[:, at, at] += np.where(known[:, k, None, None], own, np.eye(3))
        return C

    def improved(self, weighted: Array, precision: Array, by_joint: Array, known: Bools) -> Noise:
        """Estimate after one step that cannot lower the marginal likelihood.

        ``weighted`` (M, 3K) is P y and ``precision`` (M, 3K, 3K) the blocks of P, the inverse of
        the readings' whole covariance under the prior: the MM algorithm for variance components,
        sigma^2 <- sigma^2 sqrt(y'P V P y / tr P V) (Zhou et al., J. Comp. Graph. Stat. 2019).
        """
        rows = np.repeat(known, 3, axis=1)
        found = float(np.sum(np.where(rows, weighted, 0.0) ** 2))
        expected = float(np.sum(np.where(rows, np.einsum("mii->mi", precision), 0.0)))
        reading = self._step(self.reading_mm, found, expected, self.TYPICAL_MM)
        pose = self.pose_mm
        if pose > 0.0:
            of_pose = self._components(self._shifts(known), weighted, precision)
            pose = self._step(
                pose, float(of_pose[0].sum()), float(of_pose[1].sum()), self.TYPICAL_MM
            )
        joint = self.joint_rad
        if joint.all():
            common = float(np.exp(np.mean(np.log(joint))))
            pairs = zip(
                *self._components(self._joined(by_joint, known), weighted, precision), strict=True
            )
            joint = np.array([
                self._step(float(sigma), float(f), float(w), common)
                for sigma, (f, w) in zip(joint, pairs, strict=True)
            ])  # fmt: skip
        return Noise(reading, pose, joint)

    def changed(self, before: Noise) -> float:
        """Return the largest relative change of a standard deviation that is not zero."""
        now, then = (
            np.array([each.reading_mm, each.pose_mm, *each.joint_rad]) for each in (self, before)
        )
        return float(np.abs(np.log(now[now > 0.0] / then[now > 0.0])).max())

    @staticmethod
    def _components(factors: Array, weighted: Array, precision: Array) -> tuple[Array, Array]:
        """Return y'P V P y and tr P V (J,) of the sources V = F F' by their factors (M, 3K, J)."""
        found = np.sum(np.einsum("mij,mi->mj", factors, weighted) ** 2, axis=0)
        expected = np.sum(factors * (precision @ factors), axis=(0, 1))
        return found, expected

    @staticmethod
    def _joined(by_joint: Array, known: Bools) -> Array:
        """Return the joints' levers (M, 3K, n), zero for unknown readings."""
        levers = np.where(known[..., None, None], by_joint, 0.0)
        return levers.reshape(len(known), -1, by_joint.shape[-1])

    @staticmethod
    def _shifts(known: Bools) -> Array:
        """Return how a shift of the pose moves its readings (M, 3K, 3)."""
        shifts = known[..., None, None] * np.eye(3)
        return shifts.reshape(len(known), -1, 3)

    @staticmethod
    def _step(sigma: float, found: float, expected: float, typical: float) -> float:
        """Return sigma after a step, drawn to the typical value by an inverse chi^2."""
        doubt = 4.0  # readings' worth of data that the typical value counts for
        found += doubt * typical**2 / sigma**4
        expected += doubt / sigma**2
        return float(sigma * (found / expected) ** 0.25)
