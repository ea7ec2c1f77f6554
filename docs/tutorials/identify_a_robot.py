"""Identify a robot from measured positions.

    python docs/tutorials/identify_a_robot.py

Then bound its errors and correct poses. The measurements are simulated here, so that the result can
be compared with the truth: a robot with errors of its link parameters, a reflector on its flange,
and a laser tracker. With a real robot the two inputs come from files:
`hc.read_robot("robot.urdf", tip="tool0")` or `hc.read_robot("robot.toml")`, and
`hc.read_measurements("train.csv")`.
"""

# %%
from __future__ import annotations

import numpy as np

import hilcell as hc

rng = np.random.default_rng(2)

# %% [markdown]
# The nominal robot: six rows of standard DH, `Rz(sign q + offset) Tz(d) Tx(a) Rx(alpha)`.

# %%
DH_ROWS = np.array([  # a_mm, alpha_deg, d_mm, offset_deg
    [0.0, -90.0, 290.0, 0.0],
    [270.0, 0.0, 0.0, -90.0],
    [70.0, -90.0, 0.0, 0.0],
    [0.0, 90.0, 302.0, 0.0],
    [0.0, -90.0, 0.0, 0.0],
    [0.0, 0.0, 72.0, 180.0],
])  # fmt: skip
nominal = hc.Robot.from_dh("IRB 120", DH_ROWS)

# %% [markdown]
# The true robot, the reflector in the flange's frame, and the robot's root in the tracker's frame.
# The identification knows none of them.

# %%
true = hc.Robot.from_dh("true", DH_ROWS + rng.normal(0.0, [0.4, 0.05, 0.4, 0.1], DH_ROWS.shape))
SMR_MM = np.array([20.0, -5.0, 120.0])
T_TRACKER_ROOT = np.array([
    [-1.0, 0.0, 0.0, 2200.0],
    [0.0, -1.0, 0.0, -150.0],
    [0.0, 0.0, 1.0, -600.0],
    [0.0, 0.0, 0.0, 1.0],
])  # fmt: skip
NOISE_MM = 0.02  # 1 sigma of each coordinate of a reading


def reach(joints_rad: np.ndarray) -> np.ndarray:
    """Return where the true robot carries the reflector, (N, 3) in the tracker's frame."""
    flange = T_TRACKER_ROOT @ true.poses(joints_rad)
    return np.asarray(flange[:, :3, :3] @ SMR_MM + flange[:, :3, 3])


def random_joints(poses: int) -> np.ndarray:
    """Return joints (N, 6) in rad, in front of the robot and away from its singular poses."""
    return np.array([0.0, 0.5, 0.0, 0.0, 1.0, 0.0]) + rng.uniform(-0.7, 0.7, (poses, 6))


def measure(poses: int) -> hc.Measurements:
    """Return measurements of random poses: commanded joints, measured positions."""
    joints_rad = random_joints(poses)
    xyz_mm = reach(joints_rad)
    return hc.Measurements.from_arrays(joints_rad, xyz_mm + rng.normal(0.0, NOISE_MM, xyz_mm.shape))


# %% [markdown]
# 60 poses to learn from, 200 to judge by. `fit_robot` is what `hilcell fit` calls: it tries every
# method, and chooses by cross-validation within the training poses.

# %%
train, test = measure(60), measure(200)
fit = hc.fit_robot(nominal, train, test)
print("errors at the test poses, mm:    mean     p95     max")
for method, figures in fit.result["methods"].items():
    mean, p95, largest = (figures[f"{name}_mm"] for name in ("mean", "p95", "max"))
    print(f"  {method:28} {mean:7.3f} {p95:7.3f} {largest:7.3f}")
print(f"chosen: {fit.chosen}")

# %% [markdown]
# The chosen method predicts positions with a 95 % bound of the 3-D difference to a reading.

# %%
predicted = fit.predict(test.joints_rad, "SMR")
miss_mm = np.linalg.norm(test.xyz_mm - predicted.xyz_mm, axis=1)
inside = np.mean(miss_mm <= predicted.bound95_mm)
print(f"95 % bound: {predicted.bound95_mm.mean():.3f} mm in the mean, {inside:.0%} of 200 inside")

# %% [markdown]
# The identified link parameters, with standard uncertainties before (prior) and after. Single
# parameters share their effect with others (d of axes 2 and 3, the first row and the base), so
# that their own uncertainty is large although positions are known well.

# %%
arm = hc.rigid_arm(fit)
for parameter in arm.parameters[:6]:
    print(
        f"  {parameter.name:8} {parameter.nominal:8.3f} -> {parameter.identified:8.3f} "
        f"{parameter.unit}, u {parameter.u:.3f} (prior {parameter.prior_u:.3f})"
    )

# %% [markdown]
# Corrected poses. The controller computes with the nominal arm, and has the reflector as its tool
# point. It is given the command instead of the nominal pose. The bound covers a reading's noise,
# too, so that nearly all true errors keep it.

# %%
correction = hc.PoseCorrection.of(fit, tool="SMR")
wanted_rad = random_joints(100)
corrected = correction.of_joints(wanted_rad)
wanted_mm = (correction.controller.root @ corrected.nominal)[:, :3, 3]
before_mm = np.linalg.norm(reach(wanted_rad) - wanted_mm, axis=1)
after_mm = np.linalg.norm(reach(corrected.command_rad()) - wanted_mm, axis=1)
print(
    f"true error of 100 poses: {before_mm.mean():.3f} mm as sent, {after_mm.mean():.3f} corrected"
)
inside = np.mean(after_mm <= corrected.bound95_mm)
print(f"95 % bound: {corrected.bound95_mm.mean():.3f} mm in the mean, {inside:.0%} of 100 inside")
