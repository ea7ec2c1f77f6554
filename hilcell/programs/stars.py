"""Star inequalities: the cost for every tour of an odd number of row ends at one place.

Where three rows meet, one has to be gone over twice or left by a jump. A blossom sees that at one
step along the rows; shares avoid it by going over the row one and a third times. A star sees it
at many steps: handles H, each within the next, and an odd number t of disjoint teeth that each
have a node in the first handle, in every shell between two handles, and outside the last. Every
tour leaves them all together H (t + 1) + 2 t times at least: each tooth that is one piece of the
tour crosses all handles, each further piece spares one crossing and costs two ends, and a handle
is left an even number of times. (Fleischmann 1988; one handle: a comb.)
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hilcell.geometry.kinematics import Array

VIOLATED = 1e-3  # less is not worth a cut
CLOSE = 0.3  # a blossom that holds by less may grow into a star that does not
MOST_SHELLS = 12  # in each direction
HELD = 0.05  # share by which a node must hang on a tooth to join it
MOST_STARS = 100  # of one round
Bools = NDArray[np.bool_]
Ints = NDArray[np.int_]


@dataclass(frozen=True, slots=True)
class Cut:
    """Sets (K, M) of nodes that ``least`` edges leave in all, in every tour."""

    sets: Bools
    least: float

    def row(self, edges: Ints) -> Array:
        """Return how many of the sets each edge (E, 2) leaves, (E,)."""
        leaves: Array = (self.sets[:, edges[:, 0]] != self.sets[:, edges[:, 1]]).sum(axis=0) * 1.0
        return leaves

    def missed(self, edges: Ints, share: Array) -> float:
        """Return by how much the shares (E,) of edges (E, 2) break the cut, below 0 if not."""
        return float(self.least - share @ self.row(edges))


def star(handles: Bools, teeth: Bools) -> Cut:
    """Return the star of handles (H, M), each within the next, and an odd number of teeth."""
    least = len(handles) * (len(teeth) + 1.0) + 2.0 * len(teeth)
    return Cut(np.vstack([handles, teeth]), least)


class Stars:
    """Grows stars from blossoms, and remembers the blossoms: later shares break other stars."""

    def __init__(self) -> None:
        self._seeds: dict[bytes, Cut] = {}

    def remember(self, cuts: Iterable[Cut]) -> None:
        """Keep those of the cuts that are blossoms: one handle and then teeth of two nodes."""
        self._seeds.update((cut.sets.tobytes(), cut) for cut in cuts if len(cut.sets) > 1)

    def broken(self, edges: Ints, share: Array) -> list[Cut]:
        """Return the stars most broken by the shares (E,) of edges (E, 2)."""
        if not self._seeds:
            return []
        size = next(iter(self._seeds.values())).sets.shape[1]
        matrix = np.zeros((size, size))
        matrix[edges[:, 0], edges[:, 1]] = share
        matrix += matrix.T
        found: dict[bytes, tuple[float, Cut]] = {}
        for seed in self._seeds.values():
            if seed.missed(edges, share) > -CLOSE:
                grown = _Growth(matrix, seed).star()
                missed = grown.missed(edges, share)
                if missed > VIOLATED:
                    found[grown.sets.tobytes()] = (missed, grown)
        worst = sorted(found.values(), key=lambda each: -each[0])
        return [cut for _, cut in worst[:MOST_STARS]]


class _Growth:
    """A blossom on its way to a star: shells of one node a tooth, put on outside, then inside."""

    def __init__(self, matrix: Array, blossom: Cut) -> None:
        self._matrix = matrix
        self._handles, self._teeth = blossom.sets[:1], blossom.sets[1:]

    def star(self) -> Cut:
        """Return the star of as many shells as pay, those with none too."""
        first = self._handles[0]
        inner, outer = self._tips(first), self._tips(~first)
        self._grow(first, outer)
        self._grow(~first, inner)  # an edge that leaves a handle leaves its complement
        return star(self._handles, self._teeth)

    def _tips(self, side: Bools) -> Ints:
        return np.array((self._teeth & side).argmax(axis=1))

    def _grow(self, handle: Bools, tips: Ints) -> None:
        """Take the handle's rim ``tips`` (T,) in, and new tips to the teeth, while that pays."""
        matrix, each = self._matrix, np.arange(len(tips))
        teeth = self._teeth.copy()
        handles: list[Bools] = []
        pull = np.array([matrix[tooth].sum(axis=0) for tooth in teeth])  # on each node
        pull_in = matrix[handle].sum(axis=0)
        leaving = 2.0 * handle.sum() - pull_in[handle].sum()
        paid, best = 0.0, (0.0, 0, self._teeth)
        while len(handles) < MOST_SHELLS:
            within = matrix[np.ix_(tips, tips)].sum()
            leaving += 2.0 * (len(tips) - pull_in[tips].sum()) - within
            pull_in += matrix[tips].sum(axis=0)
            handle = handle.copy()
            handle[tips] = True
            handles.append(handle)
            next_tips = self._next(pull, teeth.any(axis=0) | handle)
            if next_tips is None:
                break
            tips = next_tips
            paid += leaving - (len(tips) + 1) + 2.0 * (len(tips) - pull[each, tips].sum())
            teeth[each, tips] = True
            pull += matrix[tips]
            if paid < best[0] - VIOLATED:
                best = paid, len(handles), teeth.copy()
        self._teeth = best[2]
        self._handles = np.vstack([self._handles, *handles[: best[1]]])

    @staticmethod
    def _next(pull: Array, taken: Bools) -> Ints | None:
        """Return the free node that hangs most on each tooth, (T,), or None if some has none."""
        free, tips = np.where(taken, 0.0, pull), []
        for row in free:
            tip = int(row.argmax())
            if row[tip] < HELD:
                return None
            free[:, tip] = 0.0
            tips.append(tip)
        return np.array(tips)
