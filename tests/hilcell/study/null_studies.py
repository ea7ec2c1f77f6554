"""Studies whose figures are drawn by chance: what they show of factors a, b and c is false."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np
from msgspec.structs import replace

from hilcell.ports import Array
from hilcell.study.case import Row
from hilcell.study.study_file import Study
from tests.hilcell.study.test_analysis import rows
from tests.hilcell.study.test_study_file import factor

THREE_LEVELS = (
    factor(name="a", setting="layout.nest_samples", levels=[2, 5, 9])
    + factor(name="b", setting="grid.pitch_mm", levels=[450.0, 300.0, 225.0])
    + factor(name="c", setting="touch.poses", levels=[0, 4, 8])
    + factor(name="d", setting="base_frame.points", levels=[8, 12, 16])
)
THIRTY_TWO = 'design = "sobol"\nsamples = 32\nmachines = {}'  # of 81 combinations

# Errors in mm of points (P, 4), by their levels, on machines (P, M).
Errors = Callable[[np.random.Generator, Array, int], Array]


def scattered(random: np.random.Generator, points: Array, machines: int) -> Array:
    """One level of d scatters four times as much as the others, and shifts by machine."""
    noisy = points[:, 3] == 2
    sigma_mm = np.where(noisy, 0.02, 0.005)[:, None]
    shift_mm = noisy[:, None] * random.normal(0.06, 0.02, machines)
    return np.asarray(shift_mm + sigma_mm * random.standard_normal((len(points), machines)))


def alike(random: np.random.Generator, points: Array, machines: int) -> Array:
    """Half of the scatter is the same on all machines: that of the point."""
    own = np.where(points[:, 3] == 2, 0.02, 0.005)[:, None] * random.standard_normal(
        (len(points), 1)
    )
    return scattered(random, points, machines) + own


def together(random: np.random.Generator, points: Array, machines: int) -> Array:
    """Factors a and d act together; averaged over the other, neither does anything."""
    both = random.normal(0.0, 0.02, (3, 3))
    both -= both.mean(axis=0)
    both -= both.mean(axis=1)[:, None]
    both_mm = both[points[:, 0].astype(int), points[:, 3].astype(int)][:, None]
    return np.asarray(scattered(random, points, machines) + both_mm)


def equal(random: np.random.Generator, points: Array, machines: int) -> Array:
    """No factor does anything, and all designs scatter alike."""
    return np.asarray(random.normal(0.0, 0.005, (len(points), machines)))


def null_studies(asked: Study, errors: Errors, seeds: Iterable[int]) -> Iterator[list[Row]]:
    """Yield the rows of one study a seed: machines differ by 0.01 mm (1 sigma), and ``errors``."""
    model = rows(asked, lambda _: 0.0)
    numbers = sorted({row.point for row in model})
    points = np.array([
        [each.ends.index(row.levels[each.name]) for each in asked.factor]
        for row in model if row.machine == 1
    ])  # fmt: skip
    for seed in seeds:
        random = np.random.default_rng(seed)
        figures = 0.1 + random.normal(0.0, 0.01, asked.machines)
        figures = figures + errors(random, points, asked.machines)
        yield [
            replace(row, figures=row.figures
                    | {"mean_mm": figures[numbers.index(row.point), row.machine - 1]})
            for row in model
        ]  # fmt: skip
