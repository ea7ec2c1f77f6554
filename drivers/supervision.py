"""Deadlines that count a device's silence, not the time in which this PC did not run.

The trap: a thread that the system held up for a second finds every deadline passed, though the
answer has long arrived. So one look counts for at most ``look_s``, and a miss is declared only by
a look made after the time was up. Being late excuses the device, never the motion: nobody watches
it meanwhile, so a gap longer than `LATE_S` between two looks at something that moves ends the run.
"""

from __future__ import annotations

import time

from hilcell.ports import DeviceError

LOOK_S = 0.1  # several times the period of a wait on a wire
LATE_S = 1.0


class Patience:
    """How long a device may still keep silent."""

    def __init__(self, limit_s: float, look_s: float = LOOK_S) -> None:
        self._left_s, self._look_s = limit_s, look_s
        self._looked_s = time.monotonic()

    def over(self) -> bool:
        """Take the time since the last look off; return whether none is left.

        Whoever is told so looks once more before the device is said to be silent.
        """
        now_s = time.monotonic()
        self._left_s -= min(now_s - self._looked_s, self._look_s)
        self._looked_s = now_s
        return not self._left_s > 0


class Supervision:
    """Sees to it that a moving device is looked at; ``look`` belongs into every wait."""

    def __init__(self, device: str) -> None:
        self._device = device
        self._looked_s: float | None = None

    def begin(self) -> None:
        """Something begins to move."""
        self._looked_s = time.monotonic()

    def end(self) -> None:
        """It stands."""
        self._looked_s = None

    def look(self) -> None:
        """Note a look; raises `DeviceError` where the last one is too long ago."""
        if self._looked_s is None:
            return
        now_s, before_s = time.monotonic(), self._looked_s
        self._looked_s = now_s
        if not now_s - before_s <= LATE_S:
            raise DeviceError(
                self._device,
                "move",
                f"PC late: {now_s - before_s:.2f} s without a look at the motion",
                wanted=f"<= {LATE_S:.2f} s",
                act="give the engine a PC of its own, or end what keeps this one busy; resume",
            )
