"""A robot's nominal kinematics, and their file for ``hilcell fit``.

``robot.toml``: standard DH rows, ``Rz(sign q + offset) Tz(d) Tx(a) Rx(alpha)``.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal, Self

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import ArrayLike

from hilcell.cell.file import Joint, arm_from_joints
from hilcell.cell.settings import SettingsError, convert, read_text, unreadable
from hilcell.compensation.targets import MOST, MOST_DEG
from hilcell.geometry.kinematics import Arm, Array, forward

Length = Annotated[float, Meta(ge=-MOST, le=MOST)]
Angle = Annotated[float, Meta(ge=-MOST_DEG, le=MOST_DEG)]


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot's nominal kinematics.

    ``arm`` has its tool point on the flange behind the sixth row; ``base`` (4, 4) in the robot's
    root frame; ``tool`` (4, 4) on the flange, the frame of the targets. Joint limits (2, 6),
    infinite where none are given.
    """

    name: str
    arm: Arm
    base: Array = field(default_factory=lambda: np.eye(4))
    tool: Array = field(default_factory=lambda: np.eye(4))
    limits_rad: Array = field(default_factory=lambda: np.array([[-np.inf] * 6, [np.inf] * 6]))

    @classmethod
    def from_dh(cls, name: str, rows: ArrayLike, sign: ArrayLike = 1.0) -> Self:
        """Robot of standard DH rows (6, 4): a_mm, alpha_deg, d_mm, offset_deg.

        Row n is ``Rz(sign q + offset) Tz(d) Tx(a) Rx(alpha)``; ``sign`` (6,) is -1 for a joint that
        counts backwards. Raises `ValueError`.
        """
        dh, signs = np.array(rows, dtype=float), np.broadcast_to(np.array(sign, dtype=float), 6)
        if dh.shape != (6, 4) or not np.isfinite(dh).all():
            raise ValueError(f"DH rows: expected finite numbers (6, 4), got shape {dh.shape}")
        if not (np.abs(signs) == 1.0).all():
            raise ValueError(f"DH signs: expected 1 or -1, got {signs.tolist()}")
        joints = [
            Joint(a_mm=a_mm, alpha_deg=alpha_deg, d_mm=d_mm, offset_deg=offset_deg, sign=int(each))
            for (a_mm, alpha_deg, d_mm, offset_deg), each in zip(dh.tolist(), signs, strict=True)
        ]
        return cls(name, arm_from_joints(joints, np.eye(4)))

    def poses(self, joints_rad: ArrayLike) -> Array:
        """Tool frames (N, 4, 4) in the root frame, mm, at nominal joints (N, 6)."""
        arm = replace(self.arm, tool=self.tool)
        return self.base @ forward(arm, np.asarray(joints_rad, dtype=float))


class Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One DH row of ``robot.toml``."""

    a_mm: Length
    alpha_deg: Angle
    d_mm: Length
    offset_deg: Angle
    sign: Annotated[int, Meta(ge=-1, le=1)] = 1


class RobotModel(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The table of ``robot.toml``; targets are meant for the flange."""

    name: str
    convention: Literal["standard-dh"]
    joint: list[Row]

    def __post_init__(self) -> None:
        if len(self.joint) != 6:
            raise ValueError(f"expected six joints, got {len(self.joint)}")
        for number, row in enumerate(self.joint, start=1):
            if not row.sign:
                raise ValueError(f"joint {number}: sign must be 1 or -1")

    def robot(self) -> Robot:
        joints = [Joint(**msgspec.structs.asdict(row)) for row in self.joint]
        return Robot(self.name, arm_from_joints(joints, np.eye(4)))


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    robot: RobotModel


def read_dh(path: Path) -> Robot:
    """Read ``robot.toml``; raises `SettingsError` naming all problems at once."""
    try:
        values = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(str(path), [f"not valid TOML: {error}"]) from error
    except (OSError, UnicodeDecodeError) as error:
        raise unreadable(str(path), error) from error
    return convert(values, _File, str(path)).robot.robot()
