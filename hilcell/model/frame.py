"""A frame in {W}: its matrix, its covariance, the points that it rests on, its quality."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import msgspec

from hilcell.decoding import Json, typed
from hilcell.model.events import Three

if TYPE_CHECKING:
    from hilcell.ports import Array

Matrix = list[list[float]]


class Frame(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, dict=True):
    """A homogeneous matrix (4, 4) in {W} and its covariance (6, 6): shift (mm), rotation (rad). A
    frame from an earlier calibration has only these, and the run of its ``calibration``.
    """

    matrix: Matrix
    points: list[str] = []
    covariance: Matrix = []
    calibration: str = ""

    @property
    def T(self) -> Array:  # noqa: N802 - the paper's symbol
        return self._matrix.copy()

    @cached_property
    def _matrix(self) -> Array:  # many a point asks for it
        import numpy as np  # most readers of a journal do without arrays

        return np.array(self.matrix, dtype=float)

    @property
    def C(self) -> Array:  # noqa: N802 - the paper's symbol
        """Covariance (6, 6), 0 where unknown."""
        import numpy as np

        return np.array(self.covariance, dtype=float) if self.covariance else np.zeros((6, 6))


class MeasuredBase(Frame, frozen=True, kw_only=True, omit_defaults=True):
    """{B}, by the circles of axes 1 and 6."""

    circle_rms_mm: list[float]
    radius_mm: list[float]


class MeasuredStation(Frame, frozen=True, kw_only=True, omit_defaults=True):
    """{S} of a station, the strip's reading there, and U of a tool point and of the cube's."""

    rms_mm: float
    strip_mm: float
    tool_uncertainty_mm: float
    cube_uncertainty_mm: float
    left_out: list[str]


class TouchedBase(Frame, frozen=True, kw_only=True, omit_defaults=True):
    """{B} touched on one visit of a station: its shift at the cube's centre and the uncertainty
    there. ``growth``: of the arm since the grid; ``pull`` and ``misfit`` in sigma.
    """

    visit: int
    growth: float
    poses: int
    left_out: list[str]
    pull: float
    misfit: float
    shift_mm: Three
    along_rail_mm: float
    turn_urad: Three
    growth_um_m: float
    u_before_mm: float
    u_after_mm: float


def frame_type(key: str) -> type[Frame]:
    if key == "base":
        return MeasuredBase
    kinds: dict[str, type[Frame]] = {"station": MeasuredStation, "touch": TouchedBase}
    return kinds.get(key.partition(".")[0], Frame)


def decode_frame(key: str, body: Json) -> Frame:
    return typed(body, Frame if "calibration" in body else frame_type(key))
