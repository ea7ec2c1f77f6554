"""When garbage is collected: never a whole collection while something may move.

A collection over all that a screen holds takes a tenth of a second, in which no thread runs; a stop
may not wait for that. What is young is collected every second, everything while nothing moves.
"""

from __future__ import annotations

import gc

WHOLE_S = 30.0


class Collector:
    """Takes the collection over from the interpreter until `end`."""

    def __init__(self, now_s: float) -> None:
        self._whole_s = now_s
        gc.disable()
        gc.freeze()  # what was loaded stays

    def tick(self, *, at_rest: bool, now_s: float) -> None:
        """Collect what may be collected now."""
        whole = at_rest and now_s - self._whole_s >= WHOLE_S
        if whole:
            self._whole_s = now_s
        gc.collect(2 if whole else 0)

    def end(self) -> None:
        """Give the collection back."""
        gc.unfreeze()
        gc.enable()
