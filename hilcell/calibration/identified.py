"""A robot identified from measured rows: its base, its reflectors, and where they are at joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hilcell.calibration.placement import place
from hilcell.calibration.robot_file import Measurements
from hilcell.geometry.kinematics import Arm, Array
from hilcell.identification.estimate import Estimate, identify
from hilcell.identification.kinematics import Kinematics
from hilcell.identification.prediction import predict
from hilcell.identification.readings import Readings

FOLDS = 5  # each fifth pose is predicted by the others


@dataclass(frozen=True, eq=False)
class Identified:
    """An estimate, and the names of its reflectors."""

    estimate: Estimate
    names: list[str]

    @property
    def base(self) -> Array:
        """Return the base in the tracker's frame (4, 4)."""
        return self.estimate.state.T

    @property
    def smr_mm(self) -> Mapping[str, Array]:
        """Return the reflectors (3,) on the flange by name."""
        return dict(zip(self.names, self.estimate.state.smr_mm, strict=True))

    @property
    def left_out_mm(self) -> Array:
        """Return measured less predicted (M, K, 3) by poses of other folds, NaN where unknown."""
        fold = np.arange(len(self.estimate.readings)) % FOLDS
        folds = [np.flatnonzero(fold == each) for each in range(FOLDS)]
        return self.estimate.system.left_out_mm(folds)

    def positions(self, joints_rad: Array, target: str) -> tuple[Array, Array]:
        """Return a reflector's positions (N, 3) at joints (N, 6), and covariances (N, 3, 3).

        Both have the tracker's frame.
        """
        found, which = self.estimate, self.names.index(target)
        positions, covariances = predict(
            found.kinematics, found.state, found.system.covariance, found.noise, joints_rad
        )
        return positions[:, which], covariances[:, which]


def identified(
    nominal: Arm, rows: Measurements, *, gravity: bool = True, waves: bool = True
) -> Identified:
    """Identify a robot from measured rows; raises `FitError`, `IdentificationError`."""
    placed = place(nominal, rows)
    names = sorted(placed.smr_mm)
    kinematics = Kinematics(nominal, len(names), gravity=gravity, waves=waves)
    start = kinematics.start(placed.T_L_B, np.array([placed.smr_mm[name] for name in names]))
    return Identified(identify(kinematics, readings_of(rows, names), start), names)


def readings_of(rows: Measurements, names: list[str]) -> Readings:
    """Return one row a pose, one column a reflector; repeated readings are averaged."""
    keys = list(zip(rows.pose, map(tuple, rows.joints_rad), strict=True))
    order = {key: n for n, key in enumerate(dict.fromkeys(keys))}
    pose = np.array([order[key] for key in keys])
    which = np.array([names.index(each) for each in rows.target])
    total, count = np.zeros((len(order), len(names), 3)), np.zeros((len(order), len(names), 1))
    np.add.at(total, (pose, which), rows.xyz_mm)
    np.add.at(count, (pose, which), 1.0)
    joints = np.zeros((len(order), 6))
    joints[pose] = rows.joints_rad
    xyz_mm = np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)
    return Readings(joints, xyz_mm, np.zeros((*xyz_mm.shape, 3)))
