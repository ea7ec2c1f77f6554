"""CiA 402 drives: states, status and control words, modes of operation. Nothing here does I/O.

The trap: bit 10 "target reached" and bit 12 keep their value from the motion before, so a motion
has ended only when the set-point was acknowledged in between and the slide stands. Nor does "the
velocity is zero" say that: a servo that holds a position dithers (`drivers.standstill`).
"""

from __future__ import annotations

from enum import Enum, IntEnum


class Object(IntEnum):
    """Objects of a drive (CiA 402-2 and -3)."""

    ABORT_CONNECTION_OPTION = 0x6007
    ERROR_CODE = 0x603F
    CONTROLWORD = 0x6040
    STATUSWORD = 0x6041
    QUICK_STOP_OPTION = 0x605A
    FAULT_REACTION_OPTION = 0x605E
    MODES_OF_OPERATION = 0x6060
    MODE_DISPLAY = 0x6061
    POSITION_ACTUAL = 0x6064
    POSITION_WINDOW = 0x6067
    POSITION_WINDOW_TIME = 0x6068
    VELOCITY_ACTUAL = 0x606C
    VELOCITY_THRESHOLD = 0x606F
    VELOCITY_THRESHOLD_TIME = 0x6070
    TARGET_POSITION = 0x607A
    HOME_OFFSET = 0x607C
    PROFILE_VELOCITY = 0x6081
    PROFILE_ACCELERATION = 0x6083
    PROFILE_DECELERATION = 0x6084
    QUICK_STOP_DECELERATION = 0x6085
    HOMING_METHOD = 0x6098
    HOMING_SPEEDS = 0x6099
    HOMING_ACCELERATION = 0x609A
    DIGITAL_INPUTS = 0x60FD


class Mode(IntEnum):
    """Modes of operation that are used here (6060h)."""

    PROFILE_POSITION = 1
    HOMING = 6


class Option(IntEnum):
    """Values of objects that are options."""

    HOME_NEGATIVE_LIMIT = 17  # 6098h
    # 605Ah: then switch on disabled, so that the brake closes. 605Eh: then fault.
    SLOW_DOWN_RAMP = 1  # 6084h
    QUICK_STOP_RAMP = 2  # 6085h
    QUICK_STOP_ON_LOST_CONNECTION = 3  # 6007h


class Control(IntEnum):
    """Control words (CiA 402-2, table 30)."""

    DISABLE_VOLTAGE = 0x0000
    QUICK_STOP = 0x0002
    SHUTDOWN = 0x0006
    SWITCH_ON = 0x0007
    ENABLE_OPERATION = 0x000F
    START = 0x001F  # enable operation with bit 4: new set-point, or start of homing
    FAULT_RESET = 0x0080


class Bit(IntEnum):
    """Bits of the status word."""

    VOLTAGE_ENABLED = 1 << 4
    REMOTE = 1 << 9
    TARGET_REACHED = 1 << 10
    INTERNAL_LIMIT = 1 << 11
    ACKNOWLEDGED = 1 << 12  # profile position; in homing: homing attained
    MODE_ERROR = 1 << 13  # profile position: following error; homing: homing error


LIMIT_SWITCHES = 0b11  # of 60FD: bit 0 the negative one, bit 1 the positive one


class State(Enum):
    """States of the power drive system (CiA 402-2, figure 8)."""

    NOT_READY = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    ENABLED = "operation enabled"
    QUICK_STOP_ACTIVE = "quick stop active"
    FAULT_REACTION = "fault reaction active"
    FAULT = "fault"
    UNKNOWN = "no state of CiA 402"


_BY_4F = {
    0x00: State.NOT_READY,
    0x40: State.SWITCH_ON_DISABLED,
    0x0F: State.FAULT_REACTION,
    0x08: State.FAULT,
}
_BY_6F = {
    0x21: State.READY,
    0x23: State.SWITCHED_ON,
    0x27: State.ENABLED,
    0x07: State.QUICK_STOP_ACTIVE,
}
BRAKING = frozenset({State.QUICK_STOP_ACTIVE, State.FAULT_REACTION})
POWERED = BRAKING | {State.ENABLED}

# The next control word on the way to OPERATION ENABLED, with the transition's number.
_UPWARD = {
    State.SWITCH_ON_DISABLED: Control.SHUTDOWN,  # 2
    State.READY: Control.SWITCH_ON,  # 3
    State.SWITCHED_ON: Control.ENABLE_OPERATION,  # 4
    State.QUICK_STOP_ACTIVE: Control.DISABLE_VOLTAGE,  # 12
}


def state_of(statusword: int) -> State:
    """Return the state that a status word tells (CiA 402-2, table 32)."""
    found = _BY_6F.get(statusword & 0x6F) or _BY_4F.get(statusword & 0x4F)
    return found or State.UNKNOWN


def next_control(state: State) -> int | None:
    """Return the control word that leads on towards operation enabled; none from a fault."""
    return _UPWARD.get(state)


def enables(controlword: int) -> bool:
    """Whether a control word lets the drive move or keeps it moving."""
    return controlword & 0x0F in (Control.SWITCH_ON, Control.ENABLE_OPERATION)
