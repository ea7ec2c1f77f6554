"""Which axes are swept slowly for their transmission errors, and how."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from hilcell.cell.tables import Frozen

Axis = Annotated[int, Meta(ge=1, le=6)]


class SweepsTable(Frozen, frozen=True, kw_only=True):
    """Axes 1 to 6, each swept over what the cube needs of it and ``margin_deg`` more.

    An axis faster than 1 deg/s excites the arm; axes 4 and 6 hardly move a tool point.
    """

    enabled: bool = True
    axes: tuple[Axis, ...] = (1, 2, 3, 5)
    speed_deg_s: Annotated[float, Meta(ge=0.1, le=1.0)] = 1.0
    rate_hz: Annotated[float, Meta(ge=10, le=1000)] = 20.0
    margin_deg: Annotated[float, Meta(ge=0, le=30)] = 1.0

    def __post_init__(self) -> None:
        if len(set(self.axes)) != len(self.axes):
            raise ValueError(f"axes must differ, found {', '.join(map(str, self.axes))}")
