"""Cuts that shares of edges break: subtours, blossoms, and the stars that blossoms grow to.

Found by looking where they lie as a rule, not by proof: among the parts into which edges of
middling and of large shares fall, and among the stretches of a good tour. Where none is found, one
may be broken all the same.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from hilcell.geometry.kinematics import Array
from hilcell.planning.stars import VIOLATED, Bools, Cut, Ints, Stars, star

MOST_STRETCHES = 40  # of one kind, in one round
APART = 3  # nodes by which the ends of such stretches differ at least
LEVELS = (1e-6, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 0.95)  # of shares, that split the graph


class Separation:
    """Seeks cuts, round after round, around one closed tour (M,) of all nodes."""

    def __init__(self, tour: Ints) -> None:
        self._tour, self._place, self._size = tour, np.argsort(tour), len(tour)
        self._stars = Stars()

    def broken(self, edges: Ints, share: Array) -> list[Cut]:
        """Return cuts that the shares (E,) of edges (E, 2) break."""
        used = share > 0.0
        shares = _Shares(edges[used], share[used], self._size)
        found = [*shares.by_parts()]
        for nodes in self._stretches(shares):
            found += shares.cuts_of(nodes)
        self._stars.remember(found)
        found += self._stars.broken(shares.edges, shares.share)
        return list({cut.sets.tobytes(): cut for cut in found}.values())

    def _stretches(self, shares: _Shares) -> Iterator[Bools]:
        """Seek among all stretches of the tour at once, by sums over a table of its places."""
        first, last = np.triu_indices(self._size, 1)
        broken = 2.0 - self._leaving(shares.edges, shares.share)[first, last]
        yield from self._worst(first, last, np.where(last - first < self._size - 2, broken, 0.0))
        odd = self._leaving(shares.edges, (shares.share > 0.5).astype(float))[first, last]
        doubt: Array = np.minimum(shares.share, 1.0 - shares.share)
        broken = 1.0 - self._leaving(shares.edges, doubt)[first, last]
        yield from self._worst(first, last, np.where(np.round(odd) % 2 == 1, broken, 0.0))

    def _leaving(self, edges: Ints, weight: Array) -> Array:
        """Return the weight of the edges that leave the stretch from place i to j, (M, M)."""
        place = self._place[edges]
        table = np.zeros((self._size, self._size))
        table[place.min(axis=1), place.max(axis=1)] = weight
        sums = np.pad(table.cumsum(axis=0).cumsum(axis=1), (1, 0))
        degree = np.pad((table.sum(axis=0) + table.sum(axis=1)).cumsum(), (1, 0))
        corner = sums.diagonal()
        inside = corner[None, 1:] - sums[:-1, 1:] - sums.T[:-1, 1:] + corner[:-1, None]
        leaving: Array = degree[None, 1:] - degree[:-1, None] - 2.0 * inside
        return leaving

    def _worst(self, first: Ints, last: Ints, broken: Array) -> Iterator[Bools]:
        """Yield the nodes of the most broken stretches, no two of nearly the same ends."""
        bad = np.flatnonzero(broken > VIOLATED)
        bad = bad[np.argsort(-broken[bad], kind="stable")]
        taken = np.zeros((2, 0))
        for at in bad[: 50 * MOST_STRETCHES]:
            ends = np.array([[first[at]], [last[at]]])
            if taken.shape[1] < MOST_STRETCHES and not self._near(taken, ends):
                taken = np.hstack([taken, ends])
                nodes = np.zeros(self._size, dtype=bool)
                nodes[self._tour[first[at] : last[at] + 1]] = True
                yield nodes

    @staticmethod
    def _near(taken: Array, ends: Ints) -> bool:
        return bool((np.abs(taken - ends) < APART).all(axis=0).any())


class _Shares:
    """The edges (E, 2) in use between ``size`` nodes, and their shares (E,)."""

    def __init__(self, edges: Ints, share: Array, size: int) -> None:
        self.edges, self.share, self._size = edges, share, size

    def by_parts(self) -> Iterator[Cut]:
        """Seek among the parts into which edges of middling and of large shares fall."""
        for level in LEVELS:
            for nodes in self._parts(self.share > level):
                yield from self._subtour(nodes)
            if level < 0.5:
                for nodes in self._parts((self.share > level) & (self.share < 1.0 - level)):
                    yield from self._blossom(nodes)

    def cuts_of(self, nodes: Bools) -> Iterator[Cut]:
        """Yield the subtour and the blossom around ``nodes`` (M,) that are broken."""
        yield from self._subtour(nodes)
        yield from self._blossom(nodes)

    def _parts(self, chosen: Bools) -> Iterator[Bools]:
        edges = self.edges[chosen]
        ends = (edges[:, 0], edges[:, 1])
        graph = csr_array((np.ones(len(edges)), ends), shape=(self._size, self._size))
        count, label = connected_components(graph, directed=False)
        for each in np.flatnonzero(np.bincount(label) > 1) if count > 1 else ():
            yield label == each

    def _broken(self, cut: Cut) -> Iterator[Cut]:
        if cut.missed(self.edges, self.share) > VIOLATED:
            yield cut

    def _subtour(self, nodes: Bools) -> Iterator[Cut]:
        yield from self._broken(Cut(nodes[None], 2.0))

    def _blossom(self, handle: Bools) -> Iterator[Cut]:
        """Yield the blossom whose teeth are the edges that mostly leave the handle."""
        teeth = self._teeth(handle)
        nodes, count = np.unique(teeth, return_counts=True)
        if (count > 1).any():  # two teeth at one node: it changes sides, and they are none
            handle = handle.copy()
            handle[nodes[count > 1]] ^= True
            teeth = self._teeth(handle)
        if len(teeth) < 3 or len(teeth) % 2 == 0 or len(np.unique(teeth)) < teeth.size:
            return
        sets = np.zeros((len(teeth), self._size), dtype=bool)
        np.put_along_axis(sets, teeth, values=True, axis=1)
        yield from self._broken(star(handle[None], sets))

    def _teeth(self, handle: Bools) -> Ints:
        """Return the edges (T, 2) that mostly leave the handle."""
        leaves = handle[self.edges[:, 0]] != handle[self.edges[:, 1]]
        teeth: Ints = self.edges[leaves & (self.share > 0.5)]
        return teeth
