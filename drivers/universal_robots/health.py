"""States of a Universal Robots controller with which work may go on, and the alarms of all others.

Every package carries them; causes are looked at before their consequences: a protective stop ends
the script as well.
"""

from __future__ import annotations

from enum import IntEnum

from drivers.device_errors import ROBOT
from drivers.motion_limits import unwell
from drivers.universal_robots.rtde import UrState
from hilcell.ports import Array, DeviceError

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
# Status, its words, its alarm.
SAFETY: dict[int, tuple[str, str]] = {
    2: ("reduced", "HC-B61"),
    3: ("protective stop", "HC-B62"),
    4: ("recovery", "HC-B65"),
    5: ("safeguard stop", "HC-B11"),
    6: ("system emergency stop", "HC-B10"),
    7: ("robot emergency stop", "HC-B10"),
    8: ("violation", "HC-B63"),
    9: ("fault", "HC-B64"),
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


def problem(state: UrState, *, moving: bool) -> DeviceError | None:
    """Return the error of a state that forbids to go on; ``moving`` makes it a fault."""
    number = state.safety_status
    if number != NORMAL:
        words, code = SAFETY.get(number, ("unknown", "HC-B65"))
        wanted = f"{NORMAL} (normal)"
        return unwell(code, "safety_status", f"{number} ({words})", wanted, moving=moving)
    number = state.robot_mode
    if number != RUNNING:
        found = f"{number} ({ROBOT_MODES.get(number, 'unknown')})"
        return unwell("HC-B13", "robot_mode", found, f"{RUNNING} (running)", moving=moving)
    share = state.speed_fraction
    if not share > 0.0:
        return unwell("HC-B16", "target_speed_fraction", f"{share:g}", "above 0", moving=moving)
    return None


def refused_motion(error: int) -> DeviceError:
    """Return the error for the script's error of a motion."""
    code, words = ERRORS.get(error, ("HC-B20", "unknown"))
    found, act = f"error {error} of the script: {words}", "see the panel, resume"
    return ROBOT.failed(code, "move", found, act=act, error=error)


def runtime_text(state: UrState) -> str:
    known = {each.value: each.name.lower() for each in Runtime}
    return f"{state.runtime_state} ({known.get(state.runtime_state, 'unknown')})"


def frame_text(values: Array) -> str:
    """Return a frame's values (6,), mm and rad, in words."""
    names = ("X", "Y", "Z", "RX", "RY", "RZ")
    return ", ".join(f"{n} {v:.3f}" for n, v in zip(names, values, strict=True))
