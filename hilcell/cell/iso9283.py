"""The table of the pose test of ISO 9283: its conditions, and limits where there are any."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from hilcell.cell.tables import Frozen, Percent, Size, Turn

Mass = Annotated[float, Meta(ge=0, le=10_000)]
Minutes = Annotated[float, Meta(ge=0, le=100_000)]


class Iso9283Table(Frozen, frozen=True, kw_only=True):
    """How the test is made, and what the laboratory states of it.

    ``velocity_percent`` of the rated velocity, None for `robot.speed_percent`. ``calibration``: a
    run whose correction the commanded poses carry, "" for the robot as it is. Limits of AP_p, RP_l,
    AD and RD are judged where they are stated, and with several reflectors on the flange those of
    the largest AP and RP of an angle (deg); AP of angles wants a calibration.
    """

    cycles: Annotated[int, Meta(ge=3, le=1000)] = 30
    velocity_percent: Percent | None = None
    load_kg: Mass | None = None
    rated_load_kg: Mass | None = None
    warm_up_min: Minutes | None = None
    calibration: str = ""
    ap_limit_mm: Size | None = None
    rp_limit_mm: Size | None = None
    ad_limit_mm: Size | None = None
    rd_limit_mm: Size | None = None
    ap_limit_deg: Turn | None = None
    rp_limit_deg: Turn | None = None
