"""The tracker's errors, each with the code of its alarm."""

from __future__ import annotations

from drivers import emscon
from drivers.emscon import Command
from drivers.tcp import Alarms
from hilcell.ports import DeviceError, DeviceRefused, NoReading

DEVICE = "Tracker"
ACT = "look at the tracker, then resume"
ACTS = {"HC-T11": "clear the beam or seat the reflector, then resume"}
ALARMS = Alarms(unreachable="HC-T01", lost="HC-T02")


def no_reading(
    code: str, found: str, *, wanted: str = "", act: str = "", **fields: object
) -> NoReading:
    """Return the error of one measurement that may be tried again."""
    return NoReading(code, DEVICE, "measure", found, wanted=wanted, act=act, fields=fields)


def refused(
    code: str, operation: str, found: str, *, wanted: str = "", act: str = "", **fields: object
) -> DeviceRefused:
    """Return why this tracker is not worked with."""
    return DeviceRefused(code, DEVICE, operation, found, wanted=wanted, act=act, fields=fields)


def failed(command: Command, status: int) -> DeviceError:
    """Return the error of a refused command."""
    kind = NoReading if status in emscon.RECOVERABLE else DeviceError
    code = emscon.alarm(status)
    return kind(
        code,
        DEVICE,
        spoken(command),
        emscon.status_text(status),
        act=ACTS.get(code, ACT),
        fields={"status": status},
    )


def spoken(command: Command) -> str:
    """Return a command in words."""
    return command.name.lower().replace("_", " ")
