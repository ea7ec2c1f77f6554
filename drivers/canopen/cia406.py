"""CiA 406 linear encoders: the magnetic strip's sensor. Nothing here does I/O.

The measuring step is an array on some makes and a plain value on others, in nanometres (multiples
of 0.001 um).
"""

from __future__ import annotations

from enum import IntEnum

DEVICE_PROFILE = 0x0196  # low word of 1000h: 406 decimal
SENSOR_ERRORS = 0x73  # family of the EMCY that announces an alarm
POSITION_ERROR = 1 << 0  # of 6503h


class Object(IntEnum):
    """Objects of an encoder (CiA 406)."""

    POSITION = 0x6004
    MEASURING_STEP = 0x6005
    POSITION_STEP = 0x6501
    ALARMS = 0x6503
    SUPPORTED_ALARMS = 0x6504


def alarm_text(alarms: int) -> str:
    """Return the alarm bits of 6503h in words."""
    texts = [f"alarm bit {bit} (see the sensor's manual)" for bit in range(16)]
    texts[0] = "position error: missing magnet, or the head too far from the strip"
    return "; ".join(text for bit, text in enumerate(texts) if alarms >> bit & 1)


def step_nm(counts_per_mm: float) -> int:
    """Return the measuring step that belongs to ``counts_per_mm``."""
    return round(1e6 / counts_per_mm)
