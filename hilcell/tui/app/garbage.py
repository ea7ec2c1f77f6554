"""When garbage is collected: never a whole collection while something may move.

A collection over all that a screen holds takes a tenth of a second, in which no thread runs; a stop
may not wait for that. What is young is collected as always, everything while nothing moves.
"""

from __future__ import annotations

import gc

WHOLE_S = 30.0
NEVER = 1_000_000_000


class Collector:
    """Takes whole collections over from the interpreter until `end`."""

    def __init__(self, now_s: float) -> None:
        self._whole_s = now_s
        self._before = gc.get_threshold()
        gc.set_threshold(self._before[0], self._before[1], NEVER)
        gc.freeze()  # what was loaded stays

    def tick(self, *, at_rest: bool, now_s: float) -> None:
        """Collect everything, where that may be done now and was not done lately."""
        if at_rest and now_s - self._whole_s >= WHOLE_S:
            self._whole_s = now_s
            gc.collect()

    def end(self) -> None:
        """Give the collection back."""
        gc.unfreeze()
        gc.set_threshold(*self._before)
