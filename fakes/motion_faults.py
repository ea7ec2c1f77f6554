"""Faults that strike when a robot's motion starts, alike for every make."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fakes.faults import Faults
from fakes.truth.transforms import Array

LOST_ZEROS = {
    1: "robot.lost_zero",
    2: "robot.lost_zero_2",
    3: "robot.lost_zero_3",
    4: "robot.lost_zero_4",
    5: "robot.lost_zero_5",
    6: "robot.lost_zero_6",
}
WHOLE_TURN_DEG = np.array([0.0] * 5 + [360.0])


@dataclass(frozen=True, slots=True)
class Harms:
    """The lasting damage that faults do to the machine."""

    lose_zero: Callable[[float, int], None] = lambda lost_rad, axis: None
    slip_mount: Callable[[float], None] = lambda along_mm: None
    lose_motion: Callable[[float], None] = lambda lost_rad: None
    grow: Callable[[float], None] = lambda um_m: None
    loosen: Callable[[int, float], None] = lambda axis, slip_rad: None


@dataclass(frozen=True, slots=True)
class Struck:
    """The motion after its faults: its target (6,), whether it is frozen or never acknowledged."""

    target_deg: Array
    frozen: bool
    keeps_acknowledge: bool


def strike(faults: Faults, harms: Harms, target_deg: Array) -> Struck:
    """Let the faults of a motion to joints (6,) happen."""
    for axis, fault in LOST_ZEROS.items():
        lost_deg = faults.number(fault)
        if lost_deg is not None:
            harms.lose_zero(float(np.radians(lost_deg)), axis)
    harms.slip_mount(faults.number("robot.mount_slip") or 0.0)
    harms.lose_motion(1e-6 * (faults.number("robot.lost_motion") or 0.0))
    if (um_m := faults.number("robot.growing")) is not None:
        harms.grow(um_m)
    if (slip_deg := faults.number("robot.brake_slips")) is not None:
        harms.loosen(2, float(np.radians(slip_deg)))
    keeps_acknowledge = faults.take("robot.ack_previous") is not None
    frozen = faults.take("robot.frozen") is not None
    target_deg = target_deg - (faults.number("robot.stops_short") or 0.0)
    if faults.take("robot.wrong_turn") is not None:
        target_deg = target_deg + WHOLE_TURN_DEG
    return Struck(target_deg, frozen, keeps_acknowledge)
