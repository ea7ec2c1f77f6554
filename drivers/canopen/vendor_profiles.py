"""Units of drives by their makers, for drives that do not state them: a TOML file a make."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from importlib import resources

import msgspec

from drivers.canopen.drive_units import unit_problems
from hilcell.cell.settings import refuse
from hilcell.decoding import typed


class VendorProfile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A make: its vendor number (1018h:01) and the units of its drives as delivered."""

    make: str
    vendor: int
    speed_unit: str
    acceleration_unit: str

    def __post_init__(self) -> None:
        refuse(unit_problems(self.speed_unit, self.acceleration_unit))


def vendor_profiles() -> Iterator[VendorProfile]:
    for entry in (resources.files("drivers.canopen") / "profiles").iterdir():
        if entry.name.endswith(".toml"):
            yield typed(tomllib.loads(entry.read_text("utf-8")), VendorProfile)


def vendor_profile(vendor: int) -> VendorProfile | None:
    return next((each for each in vendor_profiles() if each.vendor == vendor), None)
