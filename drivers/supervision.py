"""Deadlines that count a device's silence, not the time in which this PC did not run.

A thread that the system held up for a second finds every deadline passed, though the answer has
long arrived. So one look counts for at most ``look_s``, and a miss is declared only by a look made
after the time was up. Being late excuses the device, never the motion: nobody watches it meanwhile,
so a gap longer than `LATE_S` between two looks at something that moves ends the run. An engine that
hangs cannot say so: a heartbeat asks here, too, and pauses.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from drivers.device_errors import Device
from hilcell.ports import Clock

LOOK_S = 0.1  # several times the period of a wait on a wire
LATE_S = 1.0
LIFE_S = 1.5  # of a program without a sign of life: the PC reports first that it is late


def go_on() -> None:
    """Let a wait go on while the run stops: it is that of a stop, or ends at its own deadline."""


class Patience:
    """How long a device may still keep silent."""

    def __init__(self, limit_s: float, look_s: float = LOOK_S) -> None:
        self._left_s, self._look_s = limit_s, look_s
        self._looked_s = time.monotonic()

    def over(self) -> bool:
        """Take the time since the last look off; return whether none is left.

        The caller then looks once more before it reports the device as silent.
        """
        now_s = time.monotonic()
        self._left_s -= min(now_s - self._looked_s, self._look_s)
        self._looked_s = now_s
        return not self._left_s > 0


def looks(limit_s: float, look_s: float = LOOK_S) -> Iterator[bool]:
    """Yield before each look at a device, until it has kept silent for ``limit_s``.

    True marks the last look, which is made after the time was up.
    """
    patience = Patience(limit_s, look_s)
    yield False
    while not patience.over():
        yield False
    yield True


class Supervision:
    """Sees to it that a moving device is looked at; ``look`` belongs into every wait."""

    ATTENDED_S = 0.4  # the heartbeat pauses then, so that the device stops an unobserved motion

    def __init__(self, device: Device, code: str, clock: Clock, late_s: float = LATE_S) -> None:
        """``code`` is that of the alarm where nobody looked."""
        self._device, self._code, self._clock, self._late_s = device, code, clock, late_s
        self._looked_s: float | None = None

    @property
    def begun(self) -> bool:
        """Whether something moves."""
        return self._looked_s is not None

    def begin(self) -> None:
        """Something begins to move."""
        self._looked_s = self._clock.pc_s()

    def end(self) -> None:
        """It stands."""
        self._looked_s = None

    @contextmanager
    def motion(self) -> Iterator[None]:
        """Supervise a motion from before its start until it has ended, or was given up."""
        self.begin()
        try:
            yield
        finally:
            self.end()

    def look(self) -> None:
        """Note a look; raises `DeviceError` where the last one is too long ago."""
        if self._looked_s is None:
            return
        gap_s = self._clock.pc_s() - self._looked_s
        self._looked_s += gap_s
        self._check(gap_s)

    def check(self) -> None:
        """Raise `DeviceError` where the last look is too long ago."""
        if self._looked_s is not None:
            self._check(self._clock.pc_s() - self._looked_s)

    def attended(self) -> bool:
        """Whether a heartbeat may go on: nothing moves, or it was looked at just now."""
        looked_s = self._looked_s
        return looked_s is None or self._clock.pc_s() - looked_s <= self.ATTENDED_S

    def _check(self, gap_s: float) -> None:
        if not gap_s <= self._late_s:
            raise self._device.failed(
                self._code,
                "move",
                f"PC late: {gap_s:.2f} s without a look at the motion",
                expected=f"<= {self._late_s:.2f} s",
                gap_s=gap_s,
                limit_s=self._late_s,
            )


@contextmanager
def on_failure(take_back: Callable[[], None]) -> Iterator[None]:
    """Call ``take_back`` where the body raises, a stop included; the error goes on."""
    try:
        yield
    except BaseException:  # also a stop or Ctrl-C: no wire and no motion is left behind
        take_back()
        raise
