"""The additive model of a study, of the points that were done: which effects are estimable.

A point's figure is a constant, and a part of each factor: one of each level, or in proportion along
a range. A question to it is a contrast, a row of weights of these unknowns. It is estimable where
it is a weighted sum of the points' own rows. Any other has no value here; least squares would give
it one, with the unknowns that are smallest together.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.sparse.csgraph import connected_components

from hilcell.ports import Array
from hilcell.study.design import Point
from hilcell.study.factor import Factor

SAME = 1e-9  # of numbers that rounding alone sets apart


class Additive:
    """The model of points (N, one or more), whose figures may stand beside one another."""

    def __init__(self, factors: Sequence[Factor], points: Sequence[Point]) -> None:
        self._factors = factors
        widths = [1 if each.is_range else len(each.ends) for each in factors]
        ends = np.cumsum([1, *widths])
        self._parts = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        self._rows = np.zeros((len(points), ends[-1]))
        self._rows[:, 0] = 1.0
        for n, part in enumerate(self._parts):
            shares = np.array([[each.choices[n].share] for each in points])
            self._rows[:, part] = (
                2.0 * shares - 1.0 if factors[n].is_range else shares == range(widths[n])
            )
        self._u, sizes, rows = np.linalg.svd(self._rows, full_matrices=False)
        some = sizes > SAME * sizes[0]
        self._u, self._sizes, self._basis = self._u[:, some], sizes[some], rows[some]
        self._average = self._averaged()

    @property
    def rank(self) -> int:
        """Return how many independent contrasts are estimable."""
        return len(self._basis)

    @property
    def unknowns(self) -> int:
        """Return how many unknowns it has, of what varies."""
        varies = np.ptp(self._rows, axis=0) > 0.0
        return 1 + sum(
            max(0, int(varies[part].sum()) - (not each.is_range))  # of levels one is the others'
            for each, part in zip(self._factors, self._parts, strict=True)
        )

    def start(self, n: int) -> int:
        """Return the level that changes of a factor are counted from: the first that occurs."""
        if self._factors[n].is_range:
            return 0
        return int(self._rows[:, self._parts[n]].any(axis=0).argmax())

    def mean(self, n: int, level: int) -> Array:
        """Return the contrast of a level, or an end, of a factor with all else averaged."""
        found = self._average.copy()
        found[self._parts[n]] = self._of_end(n, level)
        return found

    def change(self, n: int, level: int, start: int) -> Array:
        """Return the contrast of a level, or an end, against another."""
        return self.mean(n, level) - self.mean(n, start)

    def estimable(self, contrast: Array) -> bool:
        """Whether a contrast lies in the space of the points' rows."""
        rest = contrast - self._basis.T @ (self._basis @ contrast)
        return bool(np.linalg.norm(rest) <= SAME * max(1.0, float(np.linalg.norm(contrast))))

    def values(self, contrast: Array, figures: Array) -> Array:
        """Return the contrast of the points' figures (N, K); NaN where it is not estimable."""
        if not self.estimable(contrast):
            return np.full(figures.shape[1], np.nan)
        weights: Array = self._u @ ((self._basis @ contrast) / self._sizes)
        return weights @ figures

    def explained(self, figures: Array) -> float:
        """Return how much of the differences between figures (N,) it explains, 0 to 1.

        NaN where the points leave nothing to check that by.
        """
        if not self.rank < len(figures):
            return float("nan")
        total = float(((figures - figures.mean()) ** 2).sum())
        rest = figures - self._u @ (self._u.T @ figures)
        return 1.0 - float((rest**2).sum()) / total if total > 0.0 else 1.0

    def inseparable(self) -> list[list[int]]:
        """Return groups of factors, by number, whose parts the points cannot separate.

        The unknowns fall into the finest groups between which nothing is mixed: those of the
        projector on what is not estimable. The constant is taken off before.
        """
        moved = self._rows - self._rows.mean(axis=0)
        _, sizes, rows = np.linalg.svd(moved[:, 1:], full_matrices=False)
        some = rows[sizes > SAME * max(1.0, float(sizes[0]))]
        mixing = np.abs(np.eye(moved.shape[1] - 1) - some.T @ some) > SAME
        mixed = np.array([
            [mixing[a.start - 1 : a.stop - 1, b.start - 1 : b.stop - 1].any() for b in self._parts]
            for a in self._parts
        ])  # fmt: skip
        count, labels = connected_components(mixed, directed=False)
        groups = [np.flatnonzero(labels == label).tolist() for label in range(count)]
        return [group for group in groups if len(group) > 1]

    def _averaged(self) -> Array:
        """Return all levels that occur alike and the middle of ranges, where that is estimable.

        Else the factors as often as they occur.
        """
        found = np.zeros(self._rows.shape[1])
        found[0] = 1.0
        for factor, part in zip(self._factors, self._parts, strict=True):
            if not factor.is_range:
                occurs = self._rows[:, part].any(axis=0)
                found[part] = occurs / occurs.sum()
        return found if self.estimable(found) else self._rows.mean(axis=0)

    def _of_end(self, n: int, level: int) -> Array:
        if self._factors[n].is_range:
            return np.array([2.0 * level - 1.0])
        found: Array = np.eye(len(self._factors[n].ends))[level]
        return found
