"""Tables of the procedures that use a calibration which was made before."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from hilcell.cell.tables import Frozen


class RecheckTable(Frozen, frozen=True, kw_only=True):
    """Which calibration is re-checked, "" for the cell's current one, and by how many poses."""

    calibration: str = ""
    poses: Annotated[int, Meta(ge=4, le=10)] = 7


class TouchTable(Frozen, frozen=True, kw_only=True):
    """Poses by which a station is measured again after each stop, 0: none.

    For the procedure of that name: the station ("" for the grid's), the calibration as above.
    """

    poses: Annotated[int, Meta(ge=0, le=100)] = 8
    station: str = ""
    calibration: str = ""


class TargetsTable(Frozen, frozen=True, kw_only=True):
    """Targets to measure: a CSV, the station ("" for the grid's), the calibration as above."""

    file: str
    station: str = ""
    calibration: str = ""
