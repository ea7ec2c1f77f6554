"""The head of a magnetic strip, whichever wire it is read by: counts that flicker, and alarms.

A head without its magnet goes on with its last position; only its alarm shows it.
"""

from __future__ import annotations

from fakes.faults import Faults
from fakes.truth.dither import Dither
from fakes.truth.rail_truth import RailState

COUNTS_PER_MM = 100.0
FLICKER = 6


class StripSensor:
    """The head of one strip; ``strike`` before each look."""

    def __init__(self, slide: RailState, faults: Faults) -> None:
        self._faults = faults
        self.position = round(slide.strip_mm * COUNTS_PER_MM)
        self.velocity_mm_s = 0.0
        self.missing = False  # the magnet
        self._frozen = False
        self._jump_mm = 0.0
        self._flicker = Dither(1, FLICKER)
        self._jitter = 0

    def observe(self, slide: RailState) -> None:
        """Take the slide's state of now."""
        self.velocity_mm_s = slide.velocity_mm_s
        if not self._frozen and not self.missing:
            at_mm = slide.strip_mm + self._jump_mm
            self.position = round(at_mm * COUNTS_PER_MM) + self._jitter

    def strike(self) -> None:
        """Let the faults of a look come and go."""
        self._jump_mm += self._faults.number("rail.strip_jump") or 0.0
        self._frozen = self._faults.take("rail.strip_frozen") is not None
        jitter = int(self._faults.number("rail.strip_jitter") or 0)
        self._flicker.step()
        # Under the fault it alternates, so that any two looks show both sides.
        alternate = -jitter if self._jitter > 0 else jitter
        self._jitter = alternate if jitter else self._flicker.counts
        self.missing = self._faults.take("rail.missing_magnet") is not None
