"""States of a KUKA controller and of the program hilcell that work needs, and their alarms."""

from __future__ import annotations

from drivers.kuka import krl
from drivers.kuka.life import LOST
from hilcell.clean import clean
from hilcell.ports import Array, DeviceError, DeviceRefused

DEVICE = "Robot"
AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
SLIDE = "E1"
FRAME = ("X", "Y", "Z", "A", "B", "C")
STOPPED = 9
ERRORS = {
    1: "unknown command",
    2: "target outside the software limits",
    3: "external axis E1 has left the place at which it is held",
    4: "external axis E1 is held",
    5: "external axis E1 is not held, so the arm stays",
    LOST: "the PC's life sign was late, and the robot has braked by itself",
    STOPPED: "stopped by HC_STOP",
}
CODES = {3: "HC-R52", LOST: "HC-B43", STOPPED: "HC-B21"}  # all others: refused

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
    code = CODES.get(error, "HC-B20")
    return DeviceError(
        code,
        DEVICE,
        "move",
        f"HC_ERR {error}: {ERRORS.get(error, 'unknown')}",
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
