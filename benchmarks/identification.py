"""``python -m benchmarks.identification [PYTHON]``: a robot is identified, beside its peers.

The same unknowns, priors and readings by `solve`, by scipy's least_squares with differences, and,
where PYTHON is an interpreter that has it, by pybotics (it wants numpy 1, so it cannot share
this one). pybotics has link parameters and no base, reflectors or priors: less work than ours.
"""

from __future__ import annotations

import subprocess
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from benchmarks.words import parser
from hilcell.geometry.kinematics import Arm, Array
from hilcell.identification.estimate import identify, predict, solve
from hilcell.identification.kinematics import Kinematics, State
from hilcell.identification.measured_poses import Noise, Readings

ARM = Arm(
    a_mm=np.array([350.0, 1250.0, -55.0, 0.0, 0.0, 0.0]),
    alpha_rad=np.radians([-90.0, 0.0, -90.0, 90.0, -90.0, 0.0]),
    d_mm=np.array([675.0, 0.0, 0.0, 1500.0, 0.0, 215.0]),
    offset_rad=np.radians([0.0, 0.0, -90.0, 0.0, 0.0, 180.0]),
    sign=np.ones(6),
    tool=np.eye(4),
)
SMR_MM = np.array([[0.0, 0.0, 120.0], [75.0, 90.0, 213.0], [150.0, 0.0, 121.0]])
NOISE_MM = 0.02
TARGETS = 100_000
PEER = Path(__file__).with_name("pybotics_peer.py")


def timed(act: Callable[[], object], runs: int) -> float:
    """Return the least processor time of an act."""
    taken = []
    for _ in range(runs):
        began = time.process_time()
        act()
        taken.append(time.process_time() - began)
    return min(taken)


def measured(kinematics: Kinematics, poses: int) -> tuple[Readings, State]:
    """Draw a robot with errors of the prior's size, and return its readings and nominal start."""
    rng = np.random.default_rng(poses)
    mean, covariance = kinematics.prior
    placed = kinematics.placed
    start = kinematics.start(np.eye(4), SMR_MM[: kinematics.reflectors])
    drawn = mean + rng.standard_normal(len(mean)) * np.sqrt(np.diag(covariance))
    true = State(start.T, start.smr_mm, drawn[placed:], start.moved)
    joints = np.radians([0.0, -70.0, 90.0, 20.0, 40.0, 10.0]) + rng.uniform(-0.6, 0.6, (poses, 6))
    xyz_mm = kinematics.positions_mm(true, joints)
    xyz_mm += NOISE_MM * rng.standard_normal(xyz_mm.shape)
    return Readings(joints, xyz_mm, np.zeros((*xyz_mm.shape, 3))), start


def by_differences(kinematics: Kinematics, readings: Readings, start: State) -> Array:
    mean, covariance = kinematics.prior
    sigma = np.sqrt(np.diag(covariance))

    def misses(x: Array) -> Array:
        at_mm = kinematics.positions_mm(kinematics.moved(start, x * sigma), readings.joints_rad)
        return np.concatenate([((readings.xyz_mm - at_mm) / NOISE_MM).ravel(), x - mean / sigma])

    found: Array = least_squares(misses, np.zeros(len(mean)), method="trf").x * sigma
    return found


def by_pybotics(python: str, readings: Readings) -> float:
    with tempfile.NamedTemporaryFile(suffix=".npz") as file:
        np.savez(
            file.name, joints=readings.joints_rad, xyz_mm=readings.xyz_mm[:, 0], a=ARM.a_mm,
            alpha=ARM.alpha_rad, d=ARM.d_mm, offset=ARM.offset_rad, tool=SMR_MM[0],
        )  # fmt: skip
        done = subprocess.run([python, str(PEER), file.name], check=True, capture_output=True)
    return float(done.stdout)


def main() -> None:
    words = parser(__doc__)
    words.add_argument("python", nargs="?", metavar="PYTHON")
    python = words.parse_args().python
    for reflectors, poses in ((1, 64), (3, 200)):
        kinematics = Kinematics(ARM, reflectors, tool=True)
        readings, start = measured(kinematics, poses)
        noise = Noise.independent(NOISE_MM)
        given = (kinematics, readings, start)
        ours = timed(partial(solve, *given, noise), 5)
        theirs = timed(partial(by_differences, *given), 1)
        whole = timed(partial(identify, *given), 3)
        print(
            f"{poses} poses x {reflectors}   solve {ours * 1e3:7.1f} ms   least_squares "
            f"{theirs:6.2f} s = {theirs / ours:.0f} x   with outliers and noise {whole:.2f} s"
        )
        if reflectors == 1 and python:
            seconds = by_pybotics(python, readings)
            print(f"{'':14s}pybotics {seconds:6.2f} s = {seconds / ours:.0f} x")
    kinematics = Kinematics(ARM)
    readings, start = measured(kinematics, 64)
    found = identify(kinematics, readings, start)
    joints = np.resize(readings.joints_rad, (TARGETS, 6))
    seconds = timed(
        lambda: predict(
            kinematics, found.state, found.system.covariance, found.noise, joints
        ), 1
    )  # fmt: skip
    print(f"{TARGETS} poses predicted with covariances in {seconds:.2f} s")


if __name__ == "__main__":
    main()
