"""Calibrates a robot with pybotics; run by `benchmarks.identification` where pybotics is.

It prints the seconds of the optimization. Link parameters are Craig's there: those of row i - 1
come before the joint i.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np


def main() -> None:
    """Read the file named by the first argument, and calibrate."""
    words = argparse.ArgumentParser(description=__doc__)  # this one has nothing of hilcell
    words.add_argument("readings", metavar="FILE")
    args = words.parse_args()
    from pybotics.optimization import OptimizationHandler, optimize_accuracy
    from pybotics.robot import Robot
    from scipy.optimize import least_squares

    data = np.load(args.readings)
    alpha, a = np.roll(data["alpha"], 1), np.roll(data["a"], 1)
    robot = Robot.from_parameters(np.column_stack([alpha, a, data["offset"], data["d"]]))
    robot.joint_limits = np.array([[-10.0] * 6, [10.0] * 6])
    robot.tool.position = data["tool"]
    handler = OptimizationHandler(
        robot, kinematic_chain_mask=True, tool_mask=[True] * 3 + [False] * 3
    )
    began = time.perf_counter()
    least_squares(
        optimize_accuracy,
        handler.generate_optimization_vector(),
        args=(handler, data["joints"], data["xyz_mm"]),
    )
    sys.stdout.write(f"{time.perf_counter() - began}\n")


if __name__ == "__main__":
    main()
