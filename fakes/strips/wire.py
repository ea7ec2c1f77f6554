"""The wire of a strip that is not on its drive's: a serial line, or a CAN bus of its own."""

from __future__ import annotations

from fakes.faults import Faults
from fakes.site import Site
from fakes.strips.bus import StripBus
from fakes.strips.line import StripLine
from fakes.truth.rail_truth import RailTruth
from hilcell.cell.settings import SettingsError


def strip_wire(
    rail: RailTruth, faults: Faults, stated: dict[str, object], *, port: int = 0
) -> StripLine | StripBus:
    """Return what serves the strip whose options a cell file states."""
    if stated.get("driver") == "canopen":
        return StripBus(rail, faults, stated, port=port)
    return StripLine(rail, faults, stated, port=port)


def serve(site: Site, port: int) -> StripLine | StripBus:
    """Return the strip of a cell whose slide is the robot's axis; raises `SettingsError`."""
    rail = site.plant.rail
    if not isinstance(rail, RailTruth):
        raise SettingsError("rail", ["this cell has no slide to simulate"])
    return strip_wire(rail, site.faults, dict(site.cell.rail.options.get("strip", {})), port=port)
