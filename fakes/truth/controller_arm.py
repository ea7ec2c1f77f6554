"""The arm as its controller knows it and states it: the design, never the truth.

Status and turn are KUKA's: status bit 0, the wrist lies behind axis 1; bit 1, axis 3 is at or
beyond the stretched arm; bit 2, A5 < 0. Turn bit i: joint i + 1 is below 0.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from fakes.truth.machine import chain_of_cell, machine_of
from fakes.truth.transforms import Array, Chain, components
from hilcell.cell.file import Cell


@dataclass(frozen=True, slots=True)
class ControllerArm:
    """The nominal arm, its name and the serial number of its controller."""

    chain: Chain
    model: str
    serial: int

    def components(self, joints_rad: Array) -> Array:
        """Return X, Y, Z in mm and A, B, C in deg (6,) of the reflector's frame."""
        return components(self.chain.pose(joints_rad))

    def status(self, joints_rad: Array) -> int:
        """Return the status of joints (6,)."""
        lines = self.chain.lines(joints_rad)
        (axis_2, shoulder_mm), (axis_3, elbow_mm), (_, wrist_mm) = lines[1], lines[2], lines[4]
        ahead = self._cross(axis_2, np.array([0.0, 0.0, 1.0]))
        bent = self._cross(elbow_mm - shoulder_mm, wrist_mm - elbow_mm) @ axis_3
        behind, beyond, flipped = 1, 2, 4
        status = behind * bool(ahead @ wrist_mm < 0) + beyond * bool(bent >= 0)
        return int(status + flipped * bool(joints_rad[4] < 0))

    def turn(self, joints_rad: Array) -> int:
        """Return the turn of joints (6,)."""
        return sum(1 << joint for joint, angle in enumerate(joints_rad) if angle < 0)

    @staticmethod
    def _cross(a: Array, b: Array) -> Array:
        """Return the cross product of two vectors (3,); numpy's takes ten times as long for two."""
        (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
        return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def controller_arm(cell: Cell) -> ControllerArm:
    """Return the arm as the controller of a simulated cell knows it; raises `SettingsError`.

    A replayed cell has no machine: there the cell file's rows are the robot's.
    """
    replayed_serial = 860112  # the data name none
    if cell.simulation is not None and cell.simulation.data:
        name = cell.robot.name.replace(" ", "").replace("-", "_")
        return ControllerArm(chain_of_cell(cell), f"#{name} C4 FLR", replayed_serial)
    machine = machine_of(cell)
    return ControllerArm(machine.chain(cell.robot.smr_mm), machine.model, machine.serial)


def flicker(key: bytes, look: int, size: int) -> Array:
    """Return the last digit of a controller that holds still, (size,) between -1 and 1.

    It flickers from one look to the next. A run must give the same figures on any machine. So
    ``key`` says where and how the robot landed, and ``look`` counts since the program last
    answered; the time has no part in it.
    """
    digest = hashlib.blake2b(b"%d/%b" % (look, key), digest_size=size).digest()
    return np.frombuffer(digest, dtype=np.uint8) / 127.5 - 1.0
