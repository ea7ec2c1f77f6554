"""Network management (CiA 301, 7.2.8): commands, and states by name. Nothing here does I/O."""

from __future__ import annotations

COMMAND = 0x000  # the identifier of NMT commands
START, ENTER_PRE_OPERATIONAL = 0x01, 0x80
BOOT_UP, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0x00, 0x04, 0x05, 0x7F
_NAMES = {
    BOOT_UP: "boot-up",
    STOPPED: "stopped",
    OPERATIONAL: "operational",
    PRE_OPERATIONAL: "pre-operational",
}


def state_text(state: int | None) -> str:
    """Return a state as a heartbeat carries it with its name; None is a node not heard."""
    return "not heard" if state is None else f"{_NAMES.get(state, 'unknown')} (0x{state:02X})"
