"""Uncertainties that no run can measure: the laboratory states them in the cell file.

A limit is the half-width of a rectangular distribution (GUM 4.3.7); an angle is 1 sigma.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from hilcell.cell.tables import Frozen, Point, Rate

Limit = Annotated[float, Meta(ge=0, le=10)]
Urad = Annotated[float, Meta(ge=0, le=100_000)]


class UncertaintyTable(Frozen, frozen=True, kw_only=True):
    """Stated contributions, replaced by certificates and data sheets where there are any.

    The tracker's limit is ``tracker_limit_mm`` in each direction, and across the beam
    ``tracker_limit_um_m`` times the range besides. ``arm_growth_um_m_k`` is the most, that
    of aluminium: an arm lags the room. ``drill_offset_mm`` is where the tool works,
    from the reflector's centre, with the axes of {T}. Certificates are numbers and dates, as
    the report's first page shall name them.
    """

    tracker_limit_mm: Limit = 0.015  # the paper's tracker within 10 m (section 5.1)
    tracker_limit_um_m: Rate = 0.0
    smr_centring_limit_mm: Limit = 0.0127  # half a thousandth of an inch, a common grade
    drift_limit_mm: Limit = 0.02  # where the floor nests were not measured again
    arm_growth_um_m_k: Rate = 23.0
    air_range_k: Annotated[float, Meta(ge=0, le=60)] = 4.0  # without a weather station
    lost_motion_urad: Urad = 100.0  # of an axis that reverses, by the robot's data sheet
    reversal_limit_mm: Limit = 0.0  # programs approach from below on every axis, as the run does
    drill_offset_mm: Point = (0.0, 0.0, 0.0)
    orientation_urad: Urad = 1000.0
    tracker_certificate: str = ""
    smr_certificate: str = ""
    weather_certificate: str = ""
