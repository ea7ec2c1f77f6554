"""Noise that depends on the act and its count, never on the time or the thread.

A draw is keyed by the seed, by the act ("robot lands on these joints") and by how many times it has
happened before. So a run is the same figure for figure on a slow and on a fast machine, while two
visits of one target still differ.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray


class KeyedNoise:
    """Draws of unit normal noise for one seed; ``scope`` keeps devices apart."""

    def __init__(self, seed: int, scope: str = "") -> None:
        self._root = f"{seed}/{scope}"
        self._seen: Counter[str] = Counter()

    def normal(self, key: str, size: int) -> NDArray[np.float64]:
        """Return ``size`` unit normal draws for the next occurrence of ``key``."""
        return self.next_generator(key).standard_normal(size)

    def later_normal(self, key: str, size: int) -> Callable[[], NDArray[np.float64]]:
        """Return what draws as `normal` would now: the occurrence counts, drawn or not."""
        occurrence = self._next(key)
        return lambda: self.generator(occurrence).standard_normal(size)

    def next_generator(self, key: str) -> np.random.Generator:
        """Return the generator that belongs to the next occurrence of ``key``."""
        return self.generator(self._next(key))

    def _next(self, key: str) -> str:
        self._seen[key] += 1
        return f"{key}#{self._seen[key]}"

    def generator(self, key: str) -> np.random.Generator:
        """Return the generator that belongs to ``key`` alone."""
        digest = hashlib.sha256(f"{self._root}/{key}".encode()).digest()
        return np.random.default_rng(np.frombuffer(digest, dtype=np.uint32))


class Dither:
    """Counts of a servo or a strip at rest about zero, at most ``reach`` to either side.

    One step a SYNC. A run must give the same figures however often a slow machine looks (decision
    6). So every second step lies at zero and the others on its two sides in turn; the middle of any
    five steps in a row is then zero, wherever one begins.
    """

    STEPS = 240

    def __init__(self, reach: int, scope: int) -> None:
        sizes = np.random.default_rng(scope).integers(1, reach, self.STEPS, endpoint=True)
        signs = np.resize((0, 1, 0, -1), self.STEPS)
        self._counts: list[int] = (sizes * signs).tolist()
        self._step = 0

    def step(self) -> None:
        self._step = (self._step + 1) % self.STEPS

    @property
    def counts(self) -> int:
        """Return how far off the value is now."""
        return self._counts[self._step]

    @property
    def change(self) -> int:
        """Return how far it came in the last step; never 0."""
        return self._counts[self._step] - self._counts[self._step - 1]
