"""The additive model of a study's points, and what two factors do together.

A point's figure is a constant, and a part of each factor: one of each level, or in proportion along
a range. A question to it is a contrast, a row of weights of these unknowns. It is estimable where
it is a weighted sum of the points' own rows. Any other has no value here; least squares would give
it one, with the unknowns that are smallest together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.sparse.csgraph import connected_components

from hilcell.ports import Array
from hilcell.study.design import Point
from hilcell.study.factor import Factor
from hilcell.study.inference import SAME


class Additive:
    """The additive model of points (N, one or more), whose figures may stand beside one another."""

    caution = 0.5  # power of leverage by which its residuals grow: HC2

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
    def unknowns(self) -> int:
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
        is_range = self._factors[n].is_range
        found[self._parts[n]] = (
            2.0 * level - 1.0 if is_range else np.eye(len(self._factors[n].ends))[level]
        )
        return found

    def change(self, n: int, level: int, start: int) -> Array:
        return self.mean(n, level) - self.mean(n, start)

    def estimable(self, contrast: Array) -> bool:
        rest = contrast - self._basis.T @ (self._basis @ contrast)
        return bool(np.linalg.norm(rest) <= SAME * max(1.0, float(np.linalg.norm(contrast))))

    def weights(self, contrast: Array) -> Array:
        """Return the weights (N,) of the points' figures; NaN where it is not estimable."""
        if not self.estimable(contrast):
            return np.full(len(self._u), np.nan)
        weights: Array = self._u @ ((self._basis @ contrast) / self._sizes)
        return weights

    def values(self, contrast: Array, figures: Array) -> Array:
        """Return the contrast of the points' figures (N, K); NaN where it is not estimable."""
        return self.weights(contrast) @ figures

    @property
    def freedom(self) -> int:
        """How many points are left to check whether effects add up."""
        return len(self._u) - len(self._basis)

    def rest(self, figures: Array) -> Array:
        """Return what effects that add up leave of figures (N, K)."""
        return figures - self._u @ (self._u.T @ figures)

    @property
    def leverage(self) -> Array:
        """How much (N,) of each point's figure goes into its own fit, 0 to 1."""
        return np.asarray((self._u**2).sum(axis=1))

    def explained(self, figures: Array) -> float:
        """Return how much of the differences between figures (N,) it explains, 0 to 1.

        NaN where the points leave nothing to check that by.
        """
        if self.freedom <= 0:
            return math.nan
        total = float(((figures - figures.mean()) ** 2).sum())
        return 1.0 - float((self.rest(figures) ** 2).sum()) / total if total > 0.0 else 1.0

    def crossed(self, n: int, other: int) -> Crossed:
        """Return the model with what two factors do together as well."""
        return Crossed(self, n, other)

    def part(self, n: int) -> Array:
        """Return the columns (N, levels) of a factor, one for a range."""
        return self._rows[:, self._parts[n]]

    def own(self, n: int, level: int) -> Array:
        """Return the weights of a factor's columns at a level, or an end."""
        return self.mean(n, level)[self._parts[n]]

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


class Crossed:
    """The additive model, and the products of two factors: each level of one beside the other's.

    Only what products add to the model is decomposed: there are many pairs of factors.
    """

    caution = 1.0  # HC3: few points show what two levels do together

    def __init__(self, model: Additive, n: int, other: int) -> None:
        self._model, self._n, self._other = model, n, other
        one, two = model.part(n), model.part(other)
        self._products = (one[:, :, None] * two[:, None, :]).reshape(len(one), -1)
        u, sizes, rows = np.linalg.svd(model.rest(self._products), full_matrices=False)
        some = sizes > SAME * max(1.0, float(sizes[0]))
        self._u, self._sizes, self._basis = u[:, some], sizes[some], rows[some]

    @property
    def freedom(self) -> int:
        return self._model.freedom - len(self._basis)

    def rest(self, figures: Array) -> Array:
        additive = self._model.rest(figures)
        rest: Array = additive - self._u @ (self._u.T @ additive)
        return rest

    @property
    def leverage(self) -> Array:
        of_products: Array = (self._u**2).sum(axis=1)
        return self._model.leverage + of_products

    def change(self, level: int, start: int, beside: int) -> Array:
        """Return the weights (N,) of a change of the one at a level of the other, or NaN."""
        own = self._model.change(self._n, level, start)
        return self._weights(self._model.weights(own), self._own(level, start, self._at(beside)))

    def difference(self, level: int, start: int, beside: int, first: int) -> Array:
        """Return the weights (N,) by which a change differs between two levels of the other."""
        apart = self._at(beside) - self._at(first)
        return self._weights(np.zeros(len(self._u)), self._own(level, start, apart))

    def _at(self, level: int) -> Array:
        return self._model.own(self._other, level)

    def _own(self, level: int, start: int, other: Array) -> Array:
        n, model = self._n, self._model
        return np.outer(model.own(n, level) - model.own(n, start), other).ravel()

    def _weights(self, main: Array, product: Array) -> Array:
        """Return weights of figures: those of the additive part, and of products beside it."""
        left = product - self._products.T @ main
        across = self._basis @ left
        missed = float(np.linalg.norm(left - self._basis.T @ across))
        if not missed <= SAME * max(1.0, float(np.linalg.norm(left))):
            return np.full(len(main), np.nan)
        weights: Array = main + self._u @ (across / self._sizes)
        return weights
