"""The table of the room: which change of its temperature suspends a run, and lets it go on."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from hilcell.cell.tables import Frozen, Wait, refuse_descending

Kelvin = Annotated[float, Meta(gt=0, le=60)]


class RoomTable(Frozen, frozen=True, kw_only=True):
    """From the grid's first point on: suspended beyond ``range_k``, resumed within ``back_k`` for
    ``steady_s``.
    """

    range_k: Kelvin = 3.0
    back_k: Kelvin = 2.0
    steady_s: Wait = 120.0

    def __post_init__(self) -> None:
        refuse_descending(self, "back_k", "range_k")
