"""Promises of a robot alone."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from hilcell.conformance.acts import SPEED_PERCENT, Driver, worst_deg
from hilcell.conformance.bench import Bench
from hilcell.conformance.trial import Promise
from hilcell.conformance.verdicts import NotApplicable, fails, need
from hilcell.geometry.kinematics import forward
from hilcell.ports import Array, Robot, Sweeps

STEP_DEG = 5.0
NEAR_MM, NEAR_SHARE = 1.0, 0.02  # a controller's model is the nominal one, rounded
SWEEP_DEG, SWEEP_RAD_S = 4.0, 0.05
OTHERS_DEG = 0.01


def _steps(bench: Bench) -> list[tuple[int, Array, Array]]:
    """Return, for each axis, its step of the tool point as stated and by the nominal arm, mm."""
    driver: Robot = bench.connected()
    arm, safe_rad = bench.cell.robot.arm(), np.radians(bench.cell.robot.safe_deg)
    first = driver.move_to(safe_rad, SPEED_PERCENT)
    found = []
    for axis in range(6):
        to_rad = safe_rad + np.radians(STEP_DEG) * np.eye(6)[axis]
        stated_mm = driver.move_to(to_rad, SPEED_PERCENT).pose[:3, 3] - first.pose[:3, 3]
        nominal_mm = (forward(arm, to_rad) - forward(arm, safe_rad))[:3, 3]
        found.append((axis + 1, stated_mm, nominal_mm))
    return found


def units(bench: Bench) -> None:
    """Step each axis, and compare how far the tool point goes."""
    for axis, stated_mm, nominal_mm in _steps(bench):
        wanted_mm, found_mm = (float(np.linalg.norm(each)) for each in (nominal_mm, stated_mm))
        limit_mm = NEAR_MM + NEAR_SHARE * wanted_mm
        need(
            abs(found_mm - wanted_mm) <= limit_mm,
            f"axis {axis} by {STEP_DEG:g} deg: tool point {found_mm:.2f} mm, nominally "
            f"{wanted_mm:.2f} +-{limit_mm:.2f} mm",
        )


def handedness(bench: Bench) -> None:
    """Step each axis, and compare where the tool point goes."""
    for axis, stated_mm, nominal_mm in _steps(bench):
        off_mm = float(
            np.linalg.norm(stated_mm / _length(stated_mm) - nominal_mm / _length(nominal_mm))
        )
        turns = _length(nominal_mm) > NEAR_MM
        need(
            not turns or off_mm <= 1.0,
            f"axis {axis} by {STEP_DEG:+g} deg: tool point by {np.round(stated_mm, 1)} mm, "
            f"nominally {np.round(nominal_mm, 1)} mm",
        )


def _length(step_mm: Array) -> float:
    return max(float(np.linalg.norm(step_mm)), 1e-9)


def speed(bench: Bench) -> None:
    """Ask for speeds that are none."""
    driver: Robot = bench.connected()
    there_rad = np.radians(bench.cell.robot.safe_deg)
    before = driver.move_to(there_rad, SPEED_PERCENT)
    for percent in (0.0, -10.0, 0.9, 100.1, math.nan, math.inf):
        fails(
            f"a motion at {percent} %",
            partial(driver.move_to, there_rad + 0.05, percent),
        )
    apart = bench.acts.apart(before, driver.read())
    need(apart <= 1.0, f"the robot has moved: {apart:.1f} of what a rest allows")


def sweep(bench: Bench) -> None:
    """Turn axis 1 slowly, and see that no other turns."""
    driver = _sweeper(bench)
    start = driver.move_to(np.radians(bench.cell.robot.safe_deg), SPEED_PERCENT)
    end_rad = start.joints_rad[0] + np.radians(SWEEP_DEG)
    faster = 1.02
    with driver.sweep(0, end_rad, SWEEP_RAD_S) as sweeping:
        need(
            0 < sweeping.speed_rad_s <= SWEEP_RAD_S * faster,
            f"set to {sweeping.speed_rad_s:.4f} rad/s, wanted <= {SWEEP_RAD_S:g} rad/s",
        )
        sweeping.kickoff()
        samples = []
        while not sweeping.ended:
            samples.append(sweeping.collect())
        last = sweeping.complete()
    target_rad = start.joints_rad.copy()
    target_rad[0] = end_rad
    off_deg = worst_deg(last.joints_rad, target_rad)
    need(off_deg <= OTHERS_DEG, f"the sweep ends {off_deg:.4f} deg off")
    others_deg = max(worst_deg(each.joints_rad[1:], start.joints_rad[1:]) for each in samples)
    need(others_deg <= OTHERS_DEG, f"another axis turns by {others_deg:.4f} deg")
    times = [time_s for each in samples for time_s in (each.before_s, each.after_s)]
    need(times == sorted(times), "times of samples run back")


def moving(bench: Bench) -> None:
    """Read while an axis turns."""
    driver = _sweeper(bench)
    start = driver.move_to(np.radians(bench.cell.robot.safe_deg), SPEED_PERCENT)
    with driver.sweep(0, start.joints_rad[0] + np.radians(SWEEP_DEG), SWEEP_RAD_S) as sweeping:
        sweeping.kickoff()
        sweeping.collect()
        need(not driver.read().still, "still while an axis turns")
        while not sweeping.ended:
            sweeping.collect()
        sweeping.complete()


def _sweeper(bench: Bench) -> Driver:
    driver = bench.connected()
    if not isinstance(driver, Sweeps):
        raise NotApplicable("it does not sweep")
    return driver


PROMISES = (
    Promise("units", "A step of each axis moves the tool point as far as the nominal arm says.",
            units, ("robot",), real=True),
    Promise("handedness", "A step of each axis moves the tool point the way the nominal arm says.",
            handedness, ("robot",), real=True),
    Promise("speed", "A speed that is not 1 to 100 % is refused, and nothing moves.", speed,
            ("robot",)),
    Promise("sweep", "A sweep turns one axis, not faster than asked for.", sweep, ("robot",)),
    Promise("moving", "A reading taken while an axis sweeps is not still.", moving, ("robot",)),
)  # fmt: skip
