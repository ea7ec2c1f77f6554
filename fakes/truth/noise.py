"""Noise that depends on the event and its count, never on the time or the thread.

A draw is keyed by the seeds of machine and run, the event ("robot lands on these joints") and its
count: a run gives the same figures on any PC, while two visits of one target differ.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable

import numpy as np

from fakes.truth.transforms import Array


class KeyedNoise:
    """Draws of unit normal noise for one machine's seed; ``scope`` keeps devices apart.

    ``run_seed``: of a run, which has draws of its own unless its seed is the machine's.
    """

    def __init__(self, seed: int, scope: str = "", run_seed: int | None = None) -> None:
        own = run_seed is not None and run_seed != seed
        self._root = f"{seed}/run {run_seed}/{scope}" if own else f"{seed}/{scope}"
        self._occurrences: Counter[str] = Counter()

    def normal(self, key: str, size: int) -> Array:
        """Return ``size`` unit normal draws for the next occurrence of ``key``."""
        return self.next_generator(key).standard_normal(size)

    def later_normal(self, key: str, size: int) -> Callable[[], Array]:
        """Return a function that draws as `normal` would now; the occurrence counts in any case."""
        occurrence = self._next(key)
        return lambda: self.generator(occurrence).standard_normal(size)

    def next_generator(self, key: str) -> np.random.Generator:
        """Return the generator that belongs to the next occurrence of ``key``."""
        return self.generator(self._next(key))

    def _next(self, key: str) -> str:
        self._occurrences[key] += 1
        return f"{key}#{self._occurrences[key]}"

    def generator(self, key: str) -> np.random.Generator:
        """Return the generator that belongs to ``key`` alone."""
        digest = hashlib.sha256(f"{self._root}/{key}".encode()).digest()
        return np.random.Generator(np.random.PCG64(np.frombuffer(digest, dtype=np.uint32)))


class Dither:
    """Counts of a servo or a strip at rest about zero, at most ``reach`` to either side.

    One step a SYNC. Every second step is zero, and the others alternate in sign, so the median of
    any five consecutive steps is zero: a run gives the same figures however often a slow PC polls.
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


def readout_noise(key: bytes, poll: int, size: int) -> Array:
    """The last digit of a controller at rest, (size,) between -1 and 1.

    It changes from poll to poll, not with time. ``key``: where and how the robot landed; ``poll``:
    count since the program last answered.
    """
    digest = hashlib.blake2b(b"%d/%b" % (poll, key), digest_size=size).digest()
    return np.frombuffer(digest, dtype=np.uint8) / 127.5 - 1.0
