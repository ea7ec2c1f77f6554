"""A machine before its errors are drawn: the designed arm, and the poses that state its sizes."""

from __future__ import annotations

from functools import lru_cache

import msgspec
import numpy as np

from fakes.truth.joint_errors import Loads, slopes
from fakes.truth.machine import Machine
from fakes.truth.repeatability import unit_rp_mm
from fakes.truth.screws import Chain
from fakes.truth.transforms import Array, frame
from hilcell.cell.tables import Point

KNOWN = 4  # designs that are kept: a study has few, and draws many robots of each


class Design:
    """An arm as designed; its last frame is the reflector's, mounted at ``smr_mm`` (3,)."""

    def __init__(self, machine: Machine, smr_mm: Point) -> None:
        self.chain = machine.chain(smr_mm)
        self.slopes = slopes(self.chain)
        self.targets_mm, self.commands_rad = reference_cube(machine, self.chain)
        for shared in (self.targets_mm, self.commands_rad):
            shared.flags.writeable = False
        self.loads = Loads(self.chain, self.commands_rad)
        jacobians_mm = self.chain.jacobian(self.commands_rad)[:, :3]
        self.unit_rp_mm = float(unit_rp_mm(jacobians_mm).mean())
        self.axis_6_rad: Array = np.radians(machine.reference.axis_6_deg)
        self.axis_6_mm = axis_6(self.chain, self.axis_6_rad)[1]


def design_of(machine: Machine, smr_mm: Point) -> Design:
    """Return a machine's design; raises `HilcellError` where a reference pose is out of reach."""
    return _known(msgspec.json.encode(machine), smr_mm)


@lru_cache(KNOWN)
def _known(machine: bytes, smr_mm: Point) -> Design:
    return Design(msgspec.json.decode(machine, type=Machine), smr_mm)


def reference_cube(machine: Machine, chain: Chain) -> tuple[Array, Array]:
    """Return targets (N, 3) in {B} through the machine's cube, and joints (N, 6) to command."""
    reference = machine.reference
    centre = frame(reference.centre)
    axes = [
        middle_mm + size_mm * np.linspace(-0.5, 0.5, reference.points)
        for middle_mm, size_mm in zip(centre[:3, 3], reference.size_mm, strict=True)
    ]
    targets_mm = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    poses = np.tile(centre, (len(targets_mm), 1, 1))
    poses[:, :3, 3] = targets_mm
    return targets_mm, chain.solve(poses, np.radians(reference.start_deg))


def axis_6(chain: Chain, joints_rad: Array) -> tuple[Array, Array]:
    """Return axis 6 (3,) and the centre (3,) of the reflector's circle about it."""
    axis, on_axis_mm = chain.axis(5, joints_rad)
    reflector_mm = chain.pose(joints_rad)[:3, 3]
    return axis, on_axis_mm + ((reflector_mm - on_axis_mm) @ axis) * axis
