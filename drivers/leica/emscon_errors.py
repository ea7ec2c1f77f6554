"""The errors of an emScon tracker, each with the code of its alarm."""

from __future__ import annotations

from drivers.leica import emscon
from drivers.leica.emscon import Command
from drivers.tracker_readings import DEVICE
from hilcell.ports import DeviceError, NoReading

ACT = "look at the tracker, then resume"
ACTS = {"HC-T11": "clear the beam or seat the reflector, then resume"}


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
