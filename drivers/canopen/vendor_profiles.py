"""Drives by their makers: their units where they state none, and objects that differ from CiA 402.

A TOML file a make in `profiles`; its comments name the source of each fact.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import replace
from importlib import resources

import msgspec

from drivers.canopen.cia import Object
from drivers.canopen.drive_units import unit_problems
from drivers.canopen.requirements import DRIVE, Requirement, object_name
from drivers.canopen.sdo import SdoChannel
from hilcell.cell.settings import refuse
from hilcell.decoding import typed

TURN = (0x6090, 1)  # counts a turn


class VendorProfile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A make: its vendor number (1018h:01) and the units of its drives as delivered.

    ``turn`` and ``home_offset`` are objects in place of 6090h:01 and 607Ch. ``lacks`` are objects
    of `requirements.DRIVE` that its drives do not have.
    """

    make: str = "another"
    vendor: int = 0
    speed_unit: str = "counts/s"
    acceleration_unit: str = "counts/s^2"
    turn: tuple[int, int] = TURN
    home_offset: int = Object.HOME_OFFSET
    lacks: list[int] = []

    def __post_init__(self) -> None:
        refuse(unit_problems(self.speed_unit, self.acceleration_unit))

    def objects(self) -> Iterator[Requirement]:
        """Return what the driver needs of such a drive."""
        own = {TURN: self.turn, (Object.HOME_OFFSET, 0): (self.home_offset, 0)}
        for each in DRIVE:
            index, sub = own.get((each.index, each.sub), (each.index, each.sub))
            yield replace(each, index=index, sub=sub)


def vendor_profiles() -> Iterator[VendorProfile]:
    for entry in (resources.files("drivers.canopen") / "profiles").iterdir():
        if entry.name.endswith(".toml"):
            yield typed(tomllib.loads(entry.read_text("utf-8")), VendorProfile)


def make_of(drive: SdoChannel) -> VendorProfile:
    """Return the profile of a drive, by its vendor number; its own objects can be used then."""
    vendor = drive.read(Object.IDENTITY, 1)
    make = next((each for each in vendor_profiles() if each.vendor == vendor), VendorProfile())
    drive.alias(*make.turn, *TURN)
    drive.alias(make.home_offset, 0, Object.HOME_OFFSET, 0)
    return make


def table() -> str:
    """Return the makes in Markdown."""
    rows = [
        f"| {each.make} | {each.vendor:X}h | {each.speed_unit}, {each.acceleration_unit} | "
        f"{object_name(*each.turn)} | {object_name(each.home_offset, 0)} | "
        f"{', '.join(object_name(index, 0) for index in each.lacks) or '-'} |"
        for each in sorted(vendor_profiles(), key=lambda each: each.make.casefold())
    ]
    head = (
        "| make | 1018h:01 | units, where none are stated | a turn | home offset | lacks |",
        "|---|---|---|---|---|---|",
    )
    return "\n".join((*head, *rows)) + "\n"
