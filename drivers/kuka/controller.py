"""The wire to a KUKA controller and its program hilcell, as the driver of the robot uses it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Protocol

from drivers.kuka import krl
from drivers.robot_errors import DEVICE
from hilcell.ports import Array, DeviceError

PROGRESS = "$AXIS_ACT"
PROGRAM_VERSION = 4  # of hilcell.src


class Access(Protocol):
    """Variables of the controller by their names, and brake and override."""

    def look(self) -> None:
        """From here on, values are to be as new as this call."""

    def value(self, name: str) -> krl.Value:
        """Return a single value; raises `DeviceError`."""

    def numbers(self, name: str, components: tuple[str, ...]) -> list[float]:
        """Return components of a structure; raises `DeviceError`."""

    def brake(self) -> None:
        """Stop the robot; the program has heard it."""

    def release(self) -> None:
        """Take a stop back; nothing moves by it."""

    def lower_override(self, found: int, wanted: int) -> None:
        """Lower $OV_PRO so that the controller itself knows its old value."""

    def give_back_override(self) -> None:
        """Give back an override that was lowered; the robot must stand."""

    def lowered_override(self) -> bool:
        """Whether an override is still to be given back."""


class Controller(Access, Protocol):
    """The open wires to one controller."""

    @property
    def address(self) -> str:
        """Return where the controller is."""

    @property
    def versions(self) -> Mapping[str, int]:
        """Return what must be installed: the number of each."""

    @property
    def rounds(self) -> Sequence[tuple[str, ...]]:
        """Return what to look at: each poll of a motion looks at the next of these."""

    @property
    def ready(self) -> tuple[str, ...]:
        """Return what to look at before a motion is ordered."""

    @property
    def measured(self) -> str:
        """Return the variable of the measured joints, or of the ordered ones without it."""

    def text(self, name: str) -> str:
        """Return a text, cleaned."""

    def start(self, number: int, target_deg: Array, speed_percent: int) -> None:
        """Hand a motion to joints (6,) over; a held slide's place (mm) may follow (7,)."""

    def sign(self) -> None:
        """Give the program a sign of life, if one is due."""

    def undisturbed(self) -> AbstractContextManager[Access]:
        """Return an access whose waits a stop does not end."""

    def stop(self) -> None:
        """Brake; any thread; waits for no answer."""

    def check(self) -> None:
        """Raise what an idle wire has failed by."""

    def close(self) -> None:
        """Close the wires."""


class SlidingController(Controller, Protocol):
    """The wires to a controller whose program moves external axis E1 as well."""

    def has_slide(self) -> bool:
        """Whether the controller has an external axis."""

    def mastered(self) -> bool:
        """Whether E1 is; True where the controller does not tell, for then it refuses itself."""

    def start_slide(self, number: int, place_mm: float, speed_percent: int) -> None:
        """Hand a motion of E1 alone over."""

    def hold_slide(self, held: bool) -> None:
        """Have the program refuse every motion of E1, or allow it."""

    def slide(self) -> tuple[float, bool]:
        """Return where E1 is in mm, and whether it is held."""


def integer(access: Access, name: str) -> int:
    """Return a whole number that the controller has; raises `DeviceError`."""
    value = access.value(name)
    if isinstance(value, bool) or not isinstance(value, int):
        raise unreadable(name, f"a whole number is expected, found {value!r}")
    return value


def unreadable(name: str, found: object) -> DeviceError:
    """Return the error for a value that is not what belongs there."""
    return DeviceError(
        "HC-B26",
        DEVICE,
        f"read {name}",
        str(found),
        act="check the server's version, resume",
        fields={"variable": name},
    )


def override_held(found: int, wanted: int) -> None:
    """Raise `DeviceError` where an override did not become what was wanted."""
    if found != wanted:
        raise DeviceError(
            "HC-B40",
            DEVICE,
            "sweep",
            f"$OV_PRO is {found}",
            wanted=f"{wanted}",
            act="the panel holds the override; release it, resume",
            fields={"override": found, "wanted_override": wanted},
        )
