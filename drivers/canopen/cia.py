"""Objects, states, words and error codes of CiA 301, 402 and 406; no I/O.

The trap: bit 10 "target reached" and bit 12 keep their value from the motion before, so a motion
has ended only when the set-point was acknowledged in between and the slide is at rest. A velocity
of zero does not show that: a servo that holds a position dithers (`drivers.slide`).

A strip's measuring step is an array on some makes and a plain value on others, in nm. Error codes:
EMCY (CiA 301, table 26) and drives (CiA 402-2, annex).
"""

from __future__ import annotations

from enum import Enum, IntEnum

NMT = 0x000  # the identifier of NMT commands


class NodeCommand(IntEnum):
    """NMT commands that are used here (7.2.8.2)."""

    START = 0x01
    ENTER_PRE_OPERATIONAL = 0x80


class NodeState(IntEnum):
    """States of a node, as its heartbeat carries them (7.2.8.3)."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


def state_text(state: int | None) -> str:
    """Name of a state as a heartbeat carries it; None: no heartbeat yet."""
    if state is None:
        return "not heard"
    known = {each.value: each.name.lower().replace("_", "-") for each in NodeState}
    return f"{known.get(state, 'unknown')} (0x{state:02X})"


class Object(IntEnum):
    """Objects of every node (CiA 301, 7.5.2), a drive (CiA 402-2, -3) and an encoder (CiA 406)."""

    DEVICE_TYPE = 0x1000
    ERROR_REGISTER = 0x1001
    DEVICE_NAME = 0x1008
    CONSUMER_HEARTBEAT = 0x1016
    PRODUCER_HEARTBEAT = 0x1017
    IDENTITY = 0x1018

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

    STRIP_POSITION = 0x6004
    MEASURING_STEP = 0x6005
    POSITION_STEP = 0x6501
    STRIP_ALARMS = 0x6503
    SUPPORTED_ALARMS = 0x6504


class Mode(IntEnum):
    """Modes of operation that are used here (6060h)."""

    PROFILE_POSITION = 1
    HOMING = 6


class Option(IntEnum):
    """Values of objects that are options."""

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


BRAKING = frozenset({State.QUICK_STOP_ACTIVE, State.FAULT_REACTION})
POWERED = BRAKING | {State.ENABLED}


def state_of(statusword: int) -> State:
    """Return the state of a status word (CiA 402-2, table 32)."""
    state = {
        0x21: State.READY,
        0x23: State.SWITCHED_ON,
        0x27: State.ENABLED,
        0x07: State.QUICK_STOP_ACTIVE,
    }.get(statusword & 0x6F)
    return state or {
        0x00: State.NOT_READY,
        0x40: State.SWITCH_ON_DISABLED,
        0x0F: State.FAULT_REACTION,
        0x08: State.FAULT,
    }.get(statusword & 0x4F, State.UNKNOWN)


def next_control(state: State) -> int | None:
    """Return the control word of the next transition to operation enabled; none from a fault."""
    return {  # with the transition's number
        State.SWITCH_ON_DISABLED: Control.SHUTDOWN,  # 2
        State.READY: Control.SWITCH_ON,  # 3
        State.SWITCHED_ON: Control.ENABLE_OPERATION,  # 4
        State.QUICK_STOP_ACTIVE: Control.DISABLE_VOLTAGE,  # 12
    }.get(state)


def enables(controlword: int) -> bool:
    """Whether a control word lets the drive move or keeps it moving."""
    return controlword & 0x0F in (Control.SWITCH_ON, Control.ENABLE_OPERATION)


DRIVE_PROFILE, ENCODER_PROFILE = 402, 406  # low word of 1000h
SENSOR_ERRORS = 0x73  # family of the EMCY that announces an alarm
POSITION_ERROR = 1 << 0  # of 6503h


def alarm_text(alarms: int) -> str:
    """Return the text of the alarm bits of 6503h."""
    texts = [f"alarm bit {bit} (see the sensor's manual)" for bit in range(16)]
    texts[0] = "position error: missing magnet, or the head too far from the strip"
    return "; ".join(text for bit, text in enumerate(texts) if alarms >> bit & 1)


def step_nm(counts_per_mm: float) -> int:
    """Return the measuring step that belongs to ``counts_per_mm``."""
    return round(1e6 / counts_per_mm)


HEARTBEAT_LOST = 0x8130
ERRORS = {
    0x1000: "generic error",
    0x2310: "continuous over-current",
    0x2320: "short circuit or earth leakage",
    0x3110: "mains over-voltage",
    0x3120: "mains under-voltage",
    0x3210: "DC link over-voltage",
    0x3220: "DC link under-voltage",
    0x4210: "excess temperature of the device",
    0x4310: "excess temperature of the drive",
    0x5441: "emergency stop input",
    0x6320: "parameter error",
    0x7121: "motor blocked",
    0x7305: "incremental sensor 1 fault",
    0x7320: "position sensor",
    0x8110: "CAN overrun: frames lost",
    0x8120: "CAN in error passive mode",
    HEARTBEAT_LOST: "heartbeat or life guard error",
    0x8140: "recovered from bus off",
    0x8150: "collision of COB identifiers",
    0x8210: "PDO not processed: wrong length",
    0x8220: "PDO too long",
    0x8500: "position controller",
    0x8611: "following error",
    0x8612: "reference limit",
}
FAMILIES = {
    0x10: "generic error",
    0x20: "current",
    0x21: "current at the input",
    0x22: "current inside",
    0x23: "current at the output",
    0x30: "voltage",
    0x31: "mains voltage",
    0x32: "voltage inside",
    0x33: "output voltage",
    0x40: "temperature",
    0x41: "ambient temperature",
    0x42: "device temperature",
    0x43: "drive temperature",
    0x50: "device hardware",
    0x60: "device software",
    0x70: "additional modules",
    0x71: "motor",
    0x73: "sensor",
    0x80: "monitoring",
    0x81: "communication",
    0x82: "protocol error",
    0x86: "positioning",
    0x90: "external error",
    0xF0: "additional functions",
    0xFF: "device specific",
}
# Which alarm a code raises: by the code, by its family (its first byte), by the first half of it.
ALARMS = {0x5441: "HC-R20", 0x7121: "HC-R21", 0x8612: "HC-R32"}
ALARMS_OF_FAMILIES = {
    0x20: "HC-R21",
    0x30: "HC-R22",
    0x40: "HC-R23",
    0x73: "HC-R24",
    0x81: "HC-R25",
    0x82: "HC-R25",
    0x85: "HC-R26",
    0x86: "HC-R26",
}


def error_alarm(code: int) -> str:
    """Return the code of the alarm that an error code raises."""
    family = code >> 8
    of_family = ALARMS_OF_FAMILIES.get(family) or ALARMS_OF_FAMILIES.get(family & 0xF0)
    return ALARMS.get(code) or of_family or "HC-R27"


def is_error(code: int) -> bool:
    """Whether a code reports an error; 00xxh reports that errors are reset."""
    return code & 0xFF00 != 0


def error_text(code: int) -> str:
    meaning = ERRORS.get(code) or FAMILIES.get(code >> 8) or FAMILIES.get(code >> 8 & 0xF0)
    return f"0x{code:04X} ({meaning or 'unknown'})"
