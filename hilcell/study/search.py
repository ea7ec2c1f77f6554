"""The optimiser: differential evolution over the factors of a study, a generation at a time.

Every point is measured on the same machines with the same targets, so differences between points
are not those between draws, and the same point is never measured twice. A generation is asked for
as a whole before the next is thought of: the search is the same with one worker or many, and one
that goes on takes the path again through the points that are kept.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from hilcell.ports import Array
from hilcell.study.design import Point, generation, placed, places, shares_of
from hilcell.study.study_file import Optimum, Study

AGREE_MM = 1e-4  # the standard deviation of points that agree
Measure = Callable[[Sequence[Point]], Mapping[int, float]]


class _SpentError(Exception):
    """All trials are used."""


def search(study: Study, wanted: Optimum, measure: Measure) -> None:
    """Ask ``measure`` for the values of points, by number, until the search ends."""
    from scipy.optimize import Bounds, differential_evolution

    known: dict[tuple[float, ...], float] = {}

    def values(found: Array) -> Array:
        asked = {shares_of(each): each for place in found.T for each in [placed(study, place)]}
        fresh = [shares for shares in asked if shares not in known]
        room = fresh[: wanted.trials - len(known)]
        points = [Point(n, asked[each]) for n, each in enumerate(room, start=len(known) + 1)]
        measured = measure(points) if points else {}
        known.update(zip(room, (measured[each.number] for each in points), strict=True))
        if len(room) < len(fresh):
            raise _SpentError
        return np.array([known[shares_of(placed(study, place))] for place in found.T])

    ends = [
        factor.ends if factor.is_range else (0, len(factor.ends) - 1) for factor in study.factor
    ]
    of_generation: Callable[..., Any] = values  # scipy's types know no vectorized function
    try:
        differential_evolution(
            of_generation,
            Bounds([low for low, _ in ends], [high for _, high in ends]),
            integrality=[not each.is_range or each.is_whole for each in study.factor],
            init=np.array(places(study, generation(study, wanted))),
            rng=wanted.seed,
            maxiter=wanted.trials,
            tol=0.0,  # a share of the mean: points that are all too long would agree
            atol=AGREE_MM,
            polish=False,
            vectorized=True,
            updating="deferred",
        )
    except _SpentError:
        return
