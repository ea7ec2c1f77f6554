"""States of a KUKA controller and its program that work needs, their alarms, and the life sign.

While a motion is under way the program ``hilcell.src`` runs a timer of the controller up to zero;
there it brakes, latches like HC_STOP, and drops the command. The PC sets the timer back with each
sign. A sign comes only from the thread that watches the motion: an engine that hangs gives none.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from drivers.kuka import krl
from drivers.robot_errors import DEVICE
from hilcell.clean import clean
from hilcell.ports import Array, DeviceError, DeviceRefused

AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
SLIDE = "E1"
FRAME = ("X", "Y", "Z", "A", "B", "C")
LOST, STOPPED = 8, 9  # HC_ERR
# HC_ERR in words, and its alarm.
ERRORS = {
    1: ("unknown command", "HC-B20"),
    2: ("target outside the software limits", "HC-B20"),
    3: ("external axis E1 has left the place at which it is held", "HC-R52"),
    4: ("external axis E1 is held", "HC-B20"),
    5: ("external axis E1 is not held, so the arm stays", "HC-B20"),
    LOST: ("the PC's life sign was late, and the robot has braked by itself", "HC-B43"),
    STOPPED: ("stopped by HC_STOP", "HC-B21"),
}
LIFE_S = 1.5  # longer than the PC may be late itself (`Supervision`), so that it reports that first
EVERY_S = 0.2
TIMER = "$TIMER[10]"

# Variable, the values with which work may go on, the alarm otherwise, the next act; causes first.
HEALTH: dict[str, tuple[tuple[str | bool, ...], str, str]] = {
    "$ALARM_STOP": (
        (True,),
        "HC-B10",
        "emergency stop is pressed; release it and acknowledge the message",
    ),
    "$USER_SAF": ((True,), "HC-B11", "the guard is open; close it and acknowledge the message"),
    "$MODE_OP": (
        ("#EX", "#AUT"),
        "HC-B12",
        "the program moves the robot by itself; turn the key to AUT or EXT",
    ),
    "$PERI_RDY": ((True,), "HC-B13", "the drives have no power; switch them on"),
    "$STOPMESS": ((False,), "HC-B14", "a stop message is pending; acknowledge it at the panel"),
    "$PRO_STATE1": (("#P_ACTIVE",), "HC-B15", "start the program hilcell at the panel"),
}


def refused_motion(error: int) -> DeviceError:
    """Return the error for HC_ERR of a motion."""
    text, code = ERRORS.get(error, ("unknown", "HC-B20"))
    return DeviceError(
        code,
        DEVICE,
        "move",
        f"HC_ERR {error}: {text}",
        act="see the panel, resume",
        fields={"error": error},
    )


def unwell(
    code: str, name: str, found: krl.Value, wanted: str, act: str, *, moving: bool
) -> DeviceError:
    """Return the error for a variable that forbids to go on; ``moving`` makes it a fault."""
    text = str(found).upper() if isinstance(found, bool) else clean(str(found))
    kind, operation = (DeviceError, "move") if moving else (DeviceRefused, "check")
    return kind(
        code,
        DEVICE,
        operation,
        f"{name} is {text}",
        wanted=wanted,
        act=act,
        fields={"variable": name},
    )


def joints_text(joints_deg: Array) -> str:
    """Return joints (6,), or all axes (7,) with a slide in mm, in words."""
    joints = ", ".join(f"{n} {v:.3f}" for n, v in zip(AXES, joints_deg[:6], strict=True)) + " deg"
    return joints if len(joints_deg) == len(AXES) else f"{joints}, E1 {joints_deg[6]:.3f} mm"


def frame_text(values: tuple[float, ...] | list[float]) -> str:
    """Return a frame's six values in words."""
    return ", ".join(f"{n} {v:.3f}" for n, v in zip(FRAME, values, strict=True))


class LifeSign:
    """Signs of life to one controller's program, from its first motion on."""

    def __init__(self, write: Callable[[str, str], None]) -> None:
        """``write`` sets a variable of the controller."""
        self._write, self._due_s = write, math.inf

    def begin(self) -> None:
        """A motion is about to begin: tell the program how long the PC may keep silent."""
        if self._due_s == math.inf:
            self._write("HC_LIFE", str(round(LIFE_S * 1000)))
        self._due_s = time.monotonic() + EVERY_S

    def give(self) -> None:
        """Give a sign, if one is due."""
        if time.monotonic() >= self._due_s:
            self._due_s = time.monotonic() + EVERY_S
            self._write(TIMER, str(round(-LIFE_S * 1000)))
