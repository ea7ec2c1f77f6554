"""Number ranges, base class and pose shared by the tables of the cell file; mm and deg."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Self

import msgspec
import numpy as np
from msgspec import Meta

from hilcell.geometry.frames import from_zyx, zyx_from_pose
from hilcell.geometry.kinematics import Array

Length = Annotated[float, Meta(ge=-1e6, le=1e6)]
Size = Annotated[float, Meta(gt=0, le=1e6)]
Tolerance = Annotated[float, Meta(gt=0, le=10)]  # mm; a greater one would accept anything
Step = Annotated[float, Meta(ge=0.01, le=1e6)]
Turn = Annotated[float, Meta(gt=0, le=180)]  # deg
Angle = Annotated[float, Meta(ge=-3600, le=3600)]
Speed = Annotated[float, Meta(ge=0.1, le=1e5)]
Rate = Annotated[float, Meta(ge=0, le=1000)]  # um/m, um/(m K)
Wait = Annotated[float, Meta(ge=0, le=3600)]
Percent = Annotated[float, Meta(ge=1, le=100)]
Count = Annotated[int, Meta(ge=1, le=1000)]
Name = Annotated[
    str,
    Meta(
        pattern=r"^[^\W_][\w.\- ]{0,63}$",
        description="a letter or digit, then up to 63 letters, digits, '_', '.', '-', spaces",
    ),
]
Point = tuple[Length, Length, Length]
Sweep = tuple[Angle, Angle]
Six = tuple[Angle, Angle, Angle, Angle, Angle, Angle]


UNPLACED_MM = 1e5  # of a draft, a place that no strip reads and no nest has


class Frozen(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, dict=True):
    """A table of the cell file."""


def refuse_descending(table: Frozen, low: str, high: str) -> None:
    """Raise `ValueError` unless the lower end is below the upper."""
    least, most = getattr(table, low), getattr(table, high)
    if not least < most:
        raise ValueError(f"{low} {least} must be below {high} {most}")


class Pose(Frozen, frozen=True, kw_only=True):
    """A frame: position in mm and Z-Y-X angles in deg."""

    x_mm: Length
    y_mm: Length
    z_mm: Length
    a_deg: Angle = 0.0
    b_deg: Angle = 0.0
    c_deg: Angle = 0.0

    @classmethod
    def of(cls, T: Array) -> Self:
        """Return the pose of a homogeneous matrix (4, 4), to 0.001 mm and 0.00001 deg."""
        x, y, z, a, b, c = zyx_from_pose(T).tolist()
        lengths = {"x_mm": round(x, 3), "y_mm": round(y, 3), "z_mm": round(z, 3)}
        return cls(**lengths, a_deg=round(a, 5), b_deg=round(b, 5), c_deg=round(c, 5))

    @property
    def toml(self) -> str:
        """Return it as the value of a key of a cell file."""
        values = {name: getattr(self, name) + 0.0 for name in self.__struct_fields__}
        return "{ " + ", ".join(f"{name} = {value}" for name, value in values.items()) + " }"

    def off(self, T: Array) -> tuple[float, float]:
        """Return how far a homogeneous matrix (4, 4) is from it: mm, and deg about any axis."""
        turn = self._matrix[:3, :3].T @ T[:3, :3]
        cosine = np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)
        shift_mm = float(np.linalg.norm(T[:3, 3] - self._matrix[:3, 3]))
        return shift_mm, float(np.degrees(np.arccos(cosine)))

    def matrix(self) -> Array:
        """Return the homogeneous matrix (4, 4)."""
        return self._matrix.copy()

    @cached_property
    def _matrix(self) -> Array:
        T = np.eye(4)
        T[:3, :3] = from_zyx((self.a_deg, self.b_deg, self.c_deg))
        T[:3, 3] = (self.x_mm, self.y_mm, self.z_mm)
        return T
