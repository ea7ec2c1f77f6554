"""Methods of `fit` that identify the robot: link parameters, elastic joints, a tool's weight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from hilcell.clean import counted
from hilcell.fit.placement import Placement, refuse_unknown_targets
from hilcell.fit.robot_file import Measurements
from hilcell.geometry.kinematics import Array, Bools, Ints
from hilcell.identification.estimate import (
    LEAST_POSES,
    Estimate,
    identify,
    identify_trusted,
    observability,
)
from hilcell.identification.kinematics import Kinematics, State
from hilcell.identification.readings import IdentificationError, Readings, count_poses
from hilcell.identification.residual import WithResidual, with_residual

TERMS: Mapping[str, tuple[bool, bool]] = {  # elastic joints, a tool's weight
    "mdh": (False, False),
    "elastic": (True, False),
    "tool": (True, True),
}


@dataclass(frozen=True, eq=False)
class Poses:
    """Rows by pose and reflector: ``at`` (N, 2) says where each row stands in the readings."""

    readings: Readings
    at: Ints

    @classmethod
    def of(cls, rows: Measurements, targets: list[str]) -> Self:
        """Return the rows of one pose together; a target that is measured again is a pose more."""
        refuse_unknown_targets(rows, targets)
        seen: dict[tuple[str, bytes, str], int] = {}
        numbers: dict[tuple[str, bytes, int], int] = {}
        at = np.empty((len(rows), 2), dtype=np.int_)
        for n, (pose, target) in enumerate(zip(rows.pose, rows.target, strict=True)):
            joints = rows.joints_rad[n].tobytes()
            again = seen.get((pose, joints, target), 0)
            seen[pose, joints, target] = again + 1
            number = numbers.setdefault((pose, joints, again), len(numbers))
            at[n] = number, targets.index(target)
        joints_rad = np.empty((len(numbers), 6))
        joints_rad[at[:, 0]] = rows.joints_rad
        xyz_mm: Array = np.full((len(numbers), len(targets), 3), np.nan)
        xyz_mm[at[:, 0], at[:, 1]] = rows.xyz_mm
        return cls(Readings(joints_rad, xyz_mm, np.zeros((*xyz_mm.shape, 3))), at)

    def by_row(self, values: Array) -> Array:
        """Return values (M, K, ...) row by row (N, ...)."""
        return values[self.at[:, 0], self.at[:, 1]]


@dataclass(frozen=True, eq=False)
class FittedArm:
    """An identified robot and the rows that it was learnt from."""

    estimate: Estimate
    poses: Poses
    targets: list[str]
    residual: WithResidual | None = None

    @classmethod
    def learn(cls, placement: Placement, rows: Measurements, method: str) -> Self:
        """Return the robot identified by one of `TERMS` from rows of which none is gross.

        Raises `IdentificationError`.
        """
        poses, kinematics, start = _prepared(placement, rows, method)
        found = identify_trusted(kinematics, poses.readings, start)
        return cls(found, poses, sorted(placement.smr_mm))

    @classmethod
    def searched(cls, placement: Placement, rows: Measurements, method: str) -> Self:
        """Return the same from rows of which some may be gross."""
        poses, kinematics, start = _prepared(placement, rows, method)
        found = identify(kinematics, poses.readings, start)
        return cls(found, poses, sorted(placement.smr_mm))

    def with_residual(self) -> Self:
        """Return the robot with a Gaussian process for what its parameters do not describe."""
        return replace(self, residual=with_residual(self.estimate))

    @property
    def base(self) -> Array:
        """Return the base in the tracker's frame (4, 4)."""
        return self.estimate.state.T

    @property
    def smr_mm(self) -> Mapping[str, Array]:
        """Return the reflectors (3,) on the flange."""
        return dict(zip(self.targets, self.estimate.state.smr_mm, strict=True))

    @property
    def freedom(self) -> float:
        """Return the degrees of freedom of the noise: reflectors of one pose err alike."""
        spent = observability(self.estimate.system).effective
        least_freedom = 3.0  # one pose more than the parameters need
        return max(3.0 * len(self.poses.readings) - spent, least_freedom)

    @property
    def outliers(self) -> Bools:
        """Return which rows (N,) contradict the others."""
        return self.estimate.outliers[self.poses.at[:, 0], self.poses.at[:, 1]]

    def predict(self, rows: Measurements) -> tuple[Array, Array]:
        """Return the rows' positions (N, 3) in the tracker's frame, and the covariances (N, 3, 3)
        of readings there.
        """
        poses = Poses.of(rows, self.targets)
        at_mm, covariance_mm2 = self._found.predict(poses.readings.joints_rad)
        return poses.by_row(at_mm), poses.by_row(covariance_mm2)

    def left_out_mm(self, fold: Ints) -> Array:
        """Return measured less predicted (N, 3), each row by those of other folds (N,)."""
        of_pose = np.empty(len(self.poses.readings), dtype=np.int_)
        of_pose[self.poses.at[:, 0]] = fold
        folds = [np.flatnonzero(of_pose == each).astype(np.int_) for each in np.unique(fold)]
        return self.poses.by_row(self._found.left_out_mm(folds))

    @property
    def _found(self) -> Estimate | WithResidual:
        return self.residual or self.estimate


def _prepared(
    placement: Placement, rows: Measurements, method: str
) -> tuple[Poses, Kinematics, State]:
    """Return poses, kinematics of one of `TERMS`, and the nominal robot where it is placed.

    Raises `IdentificationError` where the joints are of less than `LEAST_POSES` poses: one that is
    measured again tells nothing more about the robot.
    """
    different = count_poses(rows.joints_rad)
    if different < LEAST_POSES:
        raise IdentificationError(
            f"kinematics: {counted(different, 'pose')} of different joints, expected at least "
            f"{LEAST_POSES}; measure more"
        )
    targets = sorted(placement.smr_mm)
    elastic, tool = TERMS[method]
    kinematics = Kinematics(placement.arm, len(targets), gravity=elastic, waves=elastic, tool=tool)
    smr_mm = np.array([placement.smr_mm[target] for target in targets])
    return Poses.of(rows, targets), kinematics, kinematics.start(placement.T_L_B, smr_mm)
