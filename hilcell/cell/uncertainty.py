"""Uncertainties that no run can measure: the laboratory states them in the cell file.

A limit is the half-width of a rectangular distribution (GUM 4.3.7); an angle is 1 sigma.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from hilcell.cell.instrument_dcc import NotRead, read_dcc
from hilcell.cell.settings import SettingsError
from hilcell.cell.tables import Frozen, Point, Rate

Limit = Annotated[float, Meta(ge=0, le=10)]
Urad = Annotated[float, Meta(ge=0, le=100_000)]
ID = "#"  # between a file and the id of a quantity in it
DCC_LIMITS = {"tracker": "tracker_limit_mm", "smr": "smr_centring_limit_mm", "weather": ""}


class UncertaintyTable(Frozen, frozen=True, kw_only=True):
    """Stated contributions, replaced by certificates and data sheets where there are any.

    The tracker's limit is ``tracker_limit_mm`` in each direction, and across the beam
    ``tracker_limit_um_m`` times the range besides. ``arm_growth_um_m_k`` is the most, that
    of aluminium: an arm lags the room. ``drill_offset_mm`` is where the tool works,
    from the reflector's centre, with the axes of {T}. Certificates are numbers and dates, as
    the report's first page shall name them; a DCC file names its own, see `with_certificates`.
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
    tracker_dcc: str = ""
    smr_dcc: str = ""
    weather_dcc: str = ""

    @property
    def tracker_source(self) -> str:
        """Return where the tracker's limit comes from, "" where it is an assumption."""
        return f"certificate {self.tracker_certificate}" if ID in self.tracker_dcc else ""

    @property
    def smr_source(self) -> str:
        """Return where the centring's limit comes from, "" where it is an assumption."""
        return f"certificate {self.smr_certificate}" if ID in self.smr_dcc else ""


def with_certificates(stated: UncertaintyTable, folder: Path) -> UncertaintyTable:
    """Return the table with what the named DCC files say; raises `ValueError` as a table does.

    A file names the certificate; with the id of a quantity of errors behind it, as in
    ``tracker.xml#length_errors``, the largest of them becomes the limit.
    """
    found: dict[str, str | float] = {}
    problems: list[str] = []
    for name, limit in DCC_LIMITS.items():
        place, _, id = getattr(stated, f"{name}_dcc").partition(ID)
        if not place:
            continue
        try:
            if getattr(stated, f"{name}_certificate"):
                raise NotRead(f"names the certificate; so does {name}_certificate: wanted one")
            certificate = read_dcc(folder / place)
            found[f"{name}_certificate"] = certificate.words
            if id and not limit:
                raise NotRead("names a quantity, which nothing is computed from")
            if id:
                found[limit] = certificate.largest_error_mm(id)
        except NotRead as reason:
            problems.append(f"uncertainty.{name}_dcc: {place} {reason}")
    if problems:
        raise SettingsError("uncertainty", problems)
    return msgspec.structs.replace(stated, **found) if found else stated
