"""Drive and strip of a simulated rail: their numbers, scales, signs and units.

These are properties of the devices as they were sold, wired and set up. A cell file may state them
wrongly: the devices keep to their own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

SpeedUnit = Literal["counts/s", "0.1 counts/s", "rpm"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RailDevice:
    """Drive and strip sensor on one bus.

    ``counts_per_mm`` is of 6064h and 607Ah, ``strip_counts_per_mm`` of 6004h; a negative one counts
    down where the slide moves up its rail. The strip reads ``strip_zero_mm`` where the truth's
    strip reads 0. ``speed_unit`` is of 6081h, 6099h, 607Fh and 606Ch, and per second of 6083h to
    6085h and 609Ah; rpm are of a motor with ``counts_per_turn``. ``motor_mm_s`` and
    ``motor_mm_s2`` are the most that the motor can do, whatever is ordered.

    An ``absolute`` drive reads the motor's true position from power-on. Homing of a drive that
    counts down takes its own directions: the negative limit switch is at the rail's upper end.
    Where it has homed, the drive reads 607Ch times ``home_offset_sign``, which differs by maker.
    ``states_units``: 6090h, 60A8h and 60A9h exist. A drive that is not ``watchful`` takes 1016h and
    6007h, and notices nothing when the PC's heartbeat ends.
    """

    PER_MINUTE: ClassVar[float] = 60.0

    drive_node: int = 5
    strip_node: int = 6
    counts_per_mm: float = 1000.0
    strip_counts_per_mm: float = 100.0
    strip_zero_mm: float = 0.0
    speed_unit: SpeedUnit = "counts/s"
    counts_per_turn: int = 10_000
    states_units: bool = False
    motor_mm_s: float = math.inf
    motor_mm_s2: float = math.inf
    absolute: bool = False
    homing_methods: tuple[int, ...] = (17,)
    home_offset_sign: Literal[1, -1] = 1
    watchful: bool = True

    @property
    def unit_counts_s(self) -> float:
        """Return how many counts/s one unit of speed is."""
        if self.speed_unit == "rpm":
            return self.counts_per_turn / self.PER_MINUTE
        return {"counts/s": 1.0, "0.1 counts/s": 0.1}[self.speed_unit]

    @property
    def unit_mm_s(self) -> float:
        """Return how many mm/s one unit of speed is."""
        return self.unit_counts_s / abs(self.counts_per_mm)

    @property
    def sense(self) -> int:
        """Return 1 for a drive that counts up where the slide moves up its rail, else -1."""
        return 1 if self.counts_per_mm > 0 else -1

    @property
    def speed_code(self) -> int:
        """Return 60A9h: prefix, numerator, denominator (CiA 303-2)."""
        increments_s, tenths, turns_min = 0x00B50300, 0xFFB50300, 0x00B44700
        units = {"counts/s": increments_s, "0.1 counts/s": tenths, "rpm": turns_min}
        return units[self.speed_unit]
