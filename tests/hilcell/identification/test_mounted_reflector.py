"""Base and reflector by poses of an arm, also of one whose joint 3 is coupled to joint 2."""

from dataclasses import replace

import numpy as np
import pytest

from hilcell.cell.file import load_cell
from hilcell.geometry.frames import apply, from_zyx, matrix
from hilcell.geometry.kinematics import forward
from hilcell.identification.mounted_reflector import fit_base, nominal_base

CELL = load_cell("paper")
SMR_MM = np.array(CELL.robot.smr_mm)


@pytest.mark.parametrize("coupling", [0.0, -1.0])
@pytest.mark.parametrize("seed", range(3))
def test_base_and_reflector_follow_from_poses(seed: int, coupling: float) -> None:
    rng, arm = np.random.default_rng(seed), replace(CELL.robot.arm(), coupling=coupling)
    angles = np.radians(np.array(CELL.robot.home_deg) + rng.uniform(-15, 15, (24, 6)))
    joints_rad = arm.joints(angles)
    T_L_B = matrix(from_zyx(rng.uniform(-180, 180, 3)), rng.uniform(-3e3, 3e3, 3))
    places = apply(T_L_B, forward(arm, joints_rad)[:, :3, 3])
    seen_mm = places + rng.normal(scale=0.05, size=(24, 3))
    supposed_mm = SMR_MM + rng.uniform(-30, 30, 3)
    fit = fit_base(arm, joints_rad, seen_mm, 0.05, supposed_mm, 1e3)
    assert np.linalg.norm(fit.T_L_B[:3, 3] - T_L_B[:3, 3]) < fit.base_U_mm
    assert np.linalg.norm(fit.smr_mm - SMR_MM) < fit.smr_U_mm
    nominal = nominal_base(arm, joints_rad, seen_mm, 0.05, supposed_mm, 1e3)
    assert nominal.rms_mm < 0.15
    assert np.linalg.norm(nominal.predict_mm(joints_rad[3]) - seen_mm[3]) < 0.4
    other = replace(arm, coupling=-1.0 - coupling)
    assert nominal_base(other, joints_rad, seen_mm, 0.05, SMR_MM, 1e3).rms_mm > 3.0


def test_an_arm_that_turns_the_other_way_does_not_fit() -> None:
    rng, arm = np.random.default_rng(1), CELL.robot.arm()
    joints_rad = np.radians(np.array(CELL.robot.home_deg) + rng.uniform(-15, 15, (24, 6)))
    seen_mm = forward(arm, joints_rad * [1, 1, 1, 1, -1, 1])[:, :3, 3]
    assert nominal_base(arm, joints_rad, seen_mm, 0.05, SMR_MM, 1e3).rms_mm > 3.0
