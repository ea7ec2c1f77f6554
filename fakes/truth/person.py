"""The person in the hall, who carries a tracker's beam that was let go to the next reflector.

A habit of the simulated world, of which no device and no wire knows: a tracker only notices a
reflector in its beam. The nests of floor and bars come in an order drawn from the machine's seed,
then the flange, then those of the slide, then corners of volumes with a reflector in the hand, the
last one twice, then all of them in the same order again.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle

import numpy as np

from fakes.time import CellTime


class Person:
    """Carries one beam at a time."""

    TAKES_S = (2.0, 6.0)  # to the next reflector

    def __init__(
        self,
        groups: Sequence[Sequence[str]],
        corners: Sequence[str],
        rng: np.random.Generator,
        time: CellTime,
    ) -> None:
        self._rng, self._time = rng, time
        ordered = [rng.permutation(np.array(group, dtype=object)).tolist() for group in groups]
        nests: list[str] = [nest for group in ordered for nest in group]
        self._round = [*nests, *corners, *corners[-1:]]
        self._places = cycle(self._round)
        self._arrives_s: float | None = None

    def begin_again(self) -> None:
        """Begin the round again: somebody asks for the first nest."""
        self._places = cycle(self._round)

    def take_beam(self) -> None:
        """Take a beam that was just let go; one that is on its way starts again."""
        self._arrives_s = self._time.now_s() + float(self._rng.uniform(*self.TAKES_S))

    def leave_beam(self) -> None:
        """Step back from a beam that the tracker has moved by itself."""
        self._arrives_s = None

    def put_down(self) -> str | None:
        """Return, once, the place that the beam was put on; None before, and without a beam."""
        if self._arrives_s is None or self._time.now_s() < self._arrives_s:
            return None
        self._arrives_s = None
        return next(self._places)
