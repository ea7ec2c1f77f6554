"""States of a Universal Robots controller with which work may go on, and the alarms of all others.

Every package carries them; causes are looked at before their consequences: a protective stop ends
the script as well.
"""

from __future__ import annotations

from enum import IntEnum

from drivers.robot_errors import DEVICE
from drivers.universal_robots.rtde import UrState
from hilcell.ports import Array, DeviceError, DeviceRefused

RUNNING, NORMAL = 7, 1
LOST, STOPPED = 8, 9  # errors of the script
ROBOT_MODES = {
    -1: "no controller",
    0: "disconnected",
    1: "confirm safety",
    2: "booting",
    3: "power off",
    4: "power on",
    5: "idle, brakes closed",
    6: "backdrive",
    8: "updating firmware",
}
# Status, its words, its alarm, the next act.
SAFETY: dict[int, tuple[str, str, str]] = {
    2: (
        "reduced",
        "HC-B61",
        "an unattended run needs the normal limits; leave the reduced zone or its input",
    ),
    3: ("protective stop", "HC-B62", "find out what the arm has hit; unlock it at the panel"),
    4: ("recovery", "HC-B65", "move the arm back within its limits at the panel"),
    5: ("safeguard stop", "HC-B11", "the guard is open; close it and reset the safeguard"),
    6: ("system emergency stop", "HC-B10", "release the cell's emergency stop, switch on again"),
    7: ("robot emergency stop", "HC-B10", "release the emergency stop, switch on again"),
    8: ("violation", "HC-B63", "a safety limit was passed; see the log at the panel, restart"),
    9: ("fault", "HC-B64", "see the log at the panel; restart the controller"),
}
ERRORS = {
    1: ("HC-B20", "unknown command"),
    2: ("HC-B20", "target outside the safety limits"),
    LOST: ("HC-B43", "the PC's sign of life was late, and the robot has braked by itself"),
    STOPPED: ("HC-B21", "stopped"),
}


class Runtime(IntEnum):
    """States of the program, whichever plays."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


def unwell(state: UrState, *, moving: bool) -> DeviceError | None:
    """Return the error of a state that forbids to go on; ``moving`` makes it a fault."""
    code, field, found, wanted, act = "", "", "", "", ""
    if state.safety_status != NORMAL:
        number = state.safety_status
        words, code, act = SAFETY.get(number, ("unknown", "HC-B65", "see the panel"))
        field, found, wanted = "safety_status", f"{number} ({words})", f"{NORMAL} (normal)"
    elif state.robot_mode != RUNNING:
        number = state.robot_mode
        words = ROBOT_MODES.get(number, "unknown")
        code, act = "HC-B13", "switch the robot on at the panel and release its brakes"
        field, found, wanted = "robot_mode", f"{number} ({words})", f"{RUNNING} (running)"
    elif not state.speed_fraction > 0.0:
        code, act = "HC-B16", "raise the speed slider at the panel"
        field, wanted = "target_speed_fraction", "above 0"
        found = f"{state.speed_fraction:g}"
    if not code:
        return None
    kind, operation = (DeviceError, "move") if moving else (DeviceRefused, "check")
    text = f"{field} is {found}"
    return kind(code, DEVICE, operation, text, wanted=wanted, act=act, fields={"variable": field})


def refused_motion(error: int) -> DeviceError:
    """Return the error for the script's error of a motion."""
    code, words = ERRORS.get(error, ("HC-B20", "unknown"))
    return DeviceError(
        code,
        DEVICE,
        "move",
        f"error {error} of the script: {words}",
        act="see the panel, resume",
        fields={"error": error},
    )


def runtime_text(state: UrState) -> str:
    """Return the state of the program in words."""
    known = {each.value: each.name.lower() for each in Runtime}
    return f"{state.runtime_state} ({known.get(state.runtime_state, 'unknown')})"


def joints_text(joints_deg: Array) -> str:
    """Return joints (6,) in words."""
    return ", ".join(f"A{n} {v:.3f}" for n, v in enumerate(joints_deg, 1)) + " deg"


def frame_text(values: Array) -> str:
    """Return a frame's values (6,), mm and rad, in words."""
    names = ("X", "Y", "Z", "RX", "RY", "RZ")
    return ", ".join(f"{n} {v:.3f}" for n, v in zip(names, values, strict=True))
