"""A robot's nominal kinematics, and their file for ``hilcell fit``.

``robot.toml``: DH rows, standard, ``Rz(sign q + offset) Tz(d) Tx(a) Rx(alpha)``, or modified
(Craig), ``Rx(alpha) Tx(a) Rz(sign q + offset) Tz(d)``; of a prismatic joint ``Rz(offset)
Tz(sign q + d)``. Modified rows become standard ones: the first Rx and Tx are the base's, those of
the next row end each row.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal, Self, get_args

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import ArrayLike

from hilcell.cell.settings import SettingsError, convert, read_text, unreadable
from hilcell.compensation.targets import MOST, MOST_DEG
from hilcell.geometry.frames import pose_from_zyx
from hilcell.geometry.kinematics import MM, Arm, Array, forward

Length = Annotated[float, Meta(ge=-MOST, le=MOST)]
Angle = Annotated[float, Meta(ge=-MOST_DEG, le=MOST_DEG)]
Convention = Literal["standard-dh", "modified-dh"]
MOST_JOINTS = 9


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot's nominal kinematics: a serial chain of 1 to 9 revolute and prismatic joints.

    ``arm`` has its tool point on the flange behind the last row; ``base`` (4, 4) in the robot's
    root frame; ``tool`` (4, 4) on the flange, the frame of the targets. Joint limits (2, n) of the
    controller's own values and largest speeds (n,), or (2, 1) and (1,) and infinite where none are
    given. A value of a prismatic joint is in m.
    """

    name: str
    arm: Arm
    base: Array = field(default_factory=lambda: np.eye(4))
    tool: Array = field(default_factory=lambda: np.eye(4))
    limits_rad: Array = field(default_factory=lambda: np.array([[-np.inf], [np.inf]]))
    speeds_rad_s: Array = field(default_factory=lambda: np.array([np.inf]))

    @classmethod
    def from_dh(
        cls,
        name: str,
        rows: ArrayLike,
        sign: ArrayLike = 1.0,
        *,
        prismatic: ArrayLike = False,
        coupling: float = 0.0,
        convention: Convention = "standard-dh",
    ) -> Self:
        """Robot of DH rows (n, 4): a_mm, alpha_deg, d_mm, offset_deg.

        Standard row n is ``Rz(sign q + offset) Tz(d) Tx(a) Rx(alpha)``, a modified one
        ``Rx(alpha) Tx(a) Rz(sign q + offset) Tz(d)``. ``sign`` (n,) is -1 for a joint that counts
        backwards, ``prismatic`` (n,) true for one that shifts by sign q, added to d. ``coupling``
        is 1 or -1 where a motion of joint 2 alone turns axis 3 as well, with or against it; only
        revolute joints count as 2 and 3. Raises `ValueError`.
        """
        dh = np.array(rows, dtype=float)
        count = len(dh) if dh.ndim else 0
        if convention not in get_args(Convention):
            raise ValueError(f"convention: expected {get_args(Convention)}, got {convention!r}")
        if not 1 <= count <= MOST_JOINTS:
            raise ValueError(f"expected 1 to {MOST_JOINTS} joints, got {count}")
        if dh.shape != (count, 4) or not np.isfinite(dh).all():
            raise ValueError(f"DH rows: expected finite numbers (n, 4), got shape {dh.shape}")
        signs = np.broadcast_to(np.array(sign, dtype=float), count)
        if not (np.abs(signs) == 1.0).all():
            raise ValueError(f"DH signs: expected 1 or -1, got {signs.tolist()}")
        shifts = np.flatnonzero(np.broadcast_to(np.array(prismatic, dtype=bool), count))
        base, (a_mm, alpha_deg, d_mm, offset_deg) = np.eye(4), dh.T
        if convention == "modified-dh":
            base = pose_from_zyx(a_mm[0], 0.0, 0.0, 0.0, 0.0, alpha_deg[0])
            a_mm, alpha_deg = (np.append(each[1:], 0.0) for each in (a_mm, alpha_deg))
        arm = Arm(
            a_mm,
            np.radians(alpha_deg),
            d_mm,
            np.radians(offset_deg),
            signs,
            np.eye(4),
            np.zeros(count),
            prismatic=tuple(shifts.tolist()),
        )
        return cls(name, coupled(arm, coupling), base)

    @property
    def joint_columns(self) -> list[str]:
        """Names (n) of the joints' columns in lists: ``j1_deg``, of a prismatic joint ``j1_mm``."""
        units = ("mm" if row in self.arm.prismatic else "deg" for row in range(len(self.arm)))
        return [f"j{number}_{unit}" for number, unit in enumerate(units, start=1)]

    @property
    def column_units(self) -> Array:
        """The units (n,) of these columns, in rad or m."""
        return np.where(self.arm.turning, np.radians(1.0), 1.0 / MM)

    def poses(self, joints_rad: ArrayLike) -> Array:
        """Tool frames (N, 4, 4) in the root frame, mm, at nominal joints (N, n)."""
        arm = replace(self.arm, tool=self.tool)
        return self.base @ forward(arm, np.asarray(joints_rad, dtype=float))


def coupled(arm: Arm, coupling: float) -> Arm:
    """The arm with a coupled axis 3; raises `ValueError`."""
    if coupling not in (-1.0, 0.0, 1.0):
        raise ValueError(f"coupling: expected 1 or -1, got {coupling:g}")
    revolute = len(arm) - len(arm.prismatic)
    if coupling and revolute < 3:
        raise ValueError(f"coupling: expected at least 3 revolute joints, got {revolute}")
    return replace(arm, coupling=float(coupling))


class Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One DH row of ``robot.toml``."""

    a_mm: Length
    alpha_deg: Angle
    d_mm: Length
    offset_deg: Angle
    sign: Annotated[int, Meta(ge=-1, le=1)] = 1
    type: Literal["revolute", "prismatic"] = "revolute"


class RobotModel(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The table of ``robot.toml``; targets are meant for the flange."""

    name: str
    convention: Convention
    joint: list[Row]
    coupling: Annotated[int, Meta(ge=-1, le=1)] = 0

    def __post_init__(self) -> None:
        for number, row in enumerate(self.joint, start=1):
            if not row.sign:
                raise ValueError(f"joint {number}: sign must be 1 or -1")
        self.robot()

    def robot(self) -> Robot:
        joints = self.joint
        return Robot.from_dh(
            self.name,
            [[row.a_mm, row.alpha_deg, row.d_mm, row.offset_deg] for row in joints],
            [row.sign for row in joints],
            prismatic=[row.type == "prismatic" for row in joints],
            coupling=self.coupling,
            convention=self.convention,
        )


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
