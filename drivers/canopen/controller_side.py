"""The object dictionaries that the CANopen rail uses, as EDS files, and the steps at the drive."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources

from drivers.controller_steps import steps
from hilcell.ports import ControllerFile, ControllerSide

STEPS = """
Wire one bus of drive, strip sensor and PC, with 120 ohm at both ends. Bit rate: {bitrate} bit/s at
all three.

Set the node numbers: drive {drive}, strip sensor {strip}. Number {own} is the PC's, of no other
device.

Compare the objects of the EDS files with those of your drive and sensor: the manual says which of
them may be missing.

Set the limit switches of the travel, the following error and the current limits with the maker's
software: hilcell does not.

Once, in a slow motion, unplug the PC's bus cable: the slide must brake within two seconds.
"""


def drive_and_strip(options: Mapping[str, object]) -> ControllerSide:
    """Return files and steps; nothing is loaded into drive or sensor."""
    folder = resources.files("drivers.canopen") / "eds"
    names = ("drive.eds", "strip.eds")
    filled = steps(
        STEPS,
        bitrate=options.get("bitrate", 500_000),
        drive=options.get("drive_node", 5),
        strip=options.get("strip_node", 6),
        own=options.get("heartbeat_node", 127),
    )
    files = [ControllerFile(name, "", (folder / name).read_bytes()) for name in names]
    return ControllerSide("CANopen drive and strip sensor", "CiA 402, CiA 406", files, filled)
