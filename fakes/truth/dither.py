"""Dither of a servo and a magnetic strip at rest: readings wander about the true value.

A run must give the same figures however often a slow machine looks (decision 6). So every second
step lies at zero and the others on its two sides in turn; the middle of any five steps in a row is
then zero, wherever one begins.
"""

from __future__ import annotations

import numpy as np

STEPS = 240


class Dither:
    """Counts about zero, at most ``reach`` to either side; a step a SYNC."""

    def __init__(self, reach: int, scope: int) -> None:
        sizes = np.random.default_rng(scope).integers(1, reach, STEPS, endpoint=True)
        signs = np.resize((0, 1, 0, -1), STEPS)
        self._counts: list[int] = (sizes * signs).tolist()
        self._step = 0

    def step(self) -> None:
        """Go on by one step."""
        self._step = (self._step + 1) % STEPS

    @property
    def counts(self) -> int:
        """Return how far off the value is now."""
        return self._counts[self._step]

    @property
    def change(self) -> int:
        """Return how far it came in the last step; never 0."""
        return self._counts[self._step] - self._counts[self._step - 1]
