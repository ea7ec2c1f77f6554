"""Objects and network management that every node has (CiA 301). Nothing here does I/O."""

from __future__ import annotations

from enum import IntEnum

NMT = 0x000  # the identifier of NMT commands


class NodeObject(IntEnum):
    """Objects of the communication profile (CiA 301, 7.5.2)."""

    DEVICE_TYPE = 0x1000
    ERROR_REGISTER = 0x1001
    DEVICE_NAME = 0x1008
    CONSUMER_HEARTBEAT = 0x1016
    PRODUCER_HEARTBEAT = 0x1017
    IDENTITY = 0x1018


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
    """Return a state as a heartbeat carries it with its name; None is a node not heard."""
    if state is None:
        return "not heard"
    known = {each.value: each.name.lower().replace("_", "-") for each in NodeState}
    return f"{known.get(state, 'unknown')} (0x{state:02X})"
