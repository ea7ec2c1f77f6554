"""A stronger lower bound where Held and Karp's is weak: linear programming with cuts.

Single rows of holes that cross leave 1-trees 7 % below any tour. Here edges get shares 0..1, two
per hole, and cuts that every tour respects: subtours (2 edges leave any set of holes) and
blossoms (a handle and an odd number t of teeth: 3 t + 1 edges leave them in all). The trap: what
the solver returns is no proof, it saw few edges and rounds. Its prices are one: any prices of
holes and cuts bound every tour, once the edges that they make cheap are counted over all pairs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from hilcell.geometry.kinematics import Array
from hilcell.planning.bound import ROUNDING, candidates
from hilcell.ports import HilcellError

ROUNDS = 40
VIOLATED = 1e-3  # less is not worth a cut
PRICED = 1e-9  # cuts with less price are dropped
MOST_STRETCHES = 40  # of one kind, in one round
APART = 3  # holes by which the ends of such stretches differ at least
LEVELS = (1e-6, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 0.95)  # of shares, that split the graph
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


def cut_bound(distance: Array, order: Ints) -> float:
    """Return a length that no open route through distances (N, N) is below.

    ``order`` (N,) is a good route: cuts are sought among its stretches.
    """
    program = _Program(distance, order)
    for _ in range(ROUNDS):
        program.solve()
        cuts = program.violated()
        if not cuts:
            break
        program.add(cuts)
    best_mm = 0.0
    for _ in range(ROUNDS):
        program.solve()
        bound_mm, missing = program.proven()
        best_mm = max(best_mm, bound_mm)
        if not len(missing):
            break
        program.edges = np.vstack([program.edges, missing])
    return best_mm * (1.0 - ROUNDING)


class CutError(HilcellError):
    """A linear program that the solver gave up."""


class _Program:
    """Shares of edges between holes and a hub, the last node, at distance 0 from each."""

    def __init__(self, distance: Array, order: Ints) -> None:
        count = len(distance)
        self._size = count + 1
        self._cost = np.pad(distance, (0, 1))
        self._tour = np.append(order, count)
        spokes = np.column_stack([np.arange(count), np.full(count, count)])
        self.edges = np.vstack([candidates(distance, order), spokes])
        self._cuts: list[Cut] = []
        self._share = np.zeros(len(self.edges))
        self._node_price, self._cut_price = np.zeros(self._size), np.zeros(0)

    def solve(self) -> None:
        """Find shares and prices for the cuts so far; raises `CutError` where there are none."""
        edges, count = self.edges, len(self.edges)
        ends = (edges.T.ravel(), np.tile(np.arange(count), 2))
        degree = csr_array((np.ones(2 * count), ends), shape=(self._size, count))
        rows = self._rows()
        found = linprog(  # type: ignore[call-overload] # the stubs know no sparse matrices
            self._cost[edges[:, 0], edges[:, 1]],
            A_eq=degree,
            b_eq=np.full(self._size, 2.0),
            A_ub=-rows,
            b_ub=[-cut.least for cut in self._cuts],
            bounds=(0, 1),
            method="highs",
        )
        if not found.success:
            raise CutError(f"lower bound: {found.message}")
        self._share, self._node_price = found.x, found.eqlin.marginals
        self._cut_price = np.maximum(-found.ineqlin.marginals, 0.0)

    def _sets(self) -> tuple[Bools, Ints]:
        """Return the sets (K, M) of all cuts, and how many each cut has."""
        count = np.array([len(cut.sets) for cut in self._cuts], dtype=int)
        none = np.zeros((0, self._size), dtype=bool)
        return np.vstack([none, *(cut.sets for cut in self._cuts)]), count

    def _rows(self) -> csr_array:
        """Return how many sets of each cut each edge leaves, (cuts, E)."""
        sets, count = self._sets()
        leaves = csr_array(sets[:, self.edges[:, 0]] != sets[:, self.edges[:, 1]], dtype=float)
        cut = np.repeat(np.arange(len(count)), count)
        sums = csr_array((np.ones(len(cut)), (cut, np.arange(len(cut)))), (len(count), len(cut)))
        return csr_array(sums @ leaves)

    def add(self, cuts: list[Cut]) -> None:
        """Keep the cuts that have a price, and take new ones."""
        priced = zip(self._cuts, self._cut_price, strict=True)
        self._cuts = [cut for cut, price in priced if price > PRICED] + cuts

    def proven(self) -> tuple[float, Ints]:
        """Return the bound that the prices prove on all edges, and edges (E, 2) that lower it."""
        sets, count = self._sets()
        price = np.repeat(self._cut_price, count)
        # An edge leaves a set that has one end of it: a + b - 2 a b for memberships a, b.
        node = self._node_price + price @ sets
        reduced = self._cost - node[:, None] - node + 2.0 * (sets.T * price) @ sets
        one, other = np.triu_indices(self._size, 1)
        cheap = np.minimum(reduced[one, other], 0.0)
        least = np.array([cut.least for cut in self._cuts])
        bound_mm = 2 * self._node_price.sum() + self._cut_price @ least + cheap.sum()
        known = np.zeros_like(reduced, dtype=bool)
        known[self.edges.min(axis=1), self.edges.max(axis=1)] = True
        missing = (cheap < -VIOLATED) & ~known[one, other]
        return float(bound_mm), np.column_stack([one, other])[missing]

    def violated(self) -> list[Cut]:
        """Return cuts that the shares break."""
        found = [*self._by_parts(), *self._by_stretches()]
        return list({cut.sets.tobytes(): cut for cut in found}.values())

    def _by_parts(self) -> Iterator[Cut]:
        """Seek among the parts into which edges of middling and of large shares fall."""
        for level in LEVELS:
            for nodes in self._parts(self._share > level):
                yield from self._subtour(nodes)
            if level < 0.5:
                for nodes in self._parts((self._share > level) & (self._share < 1.0 - level)):
                    yield from self._blossom(nodes)

    def _parts(self, chosen: Bools) -> Iterator[Bools]:
        edges = self.edges[chosen]
        graph = csr_array((np.ones(len(edges)), edges.T), shape=(self._size, self._size))
        count, label = connected_components(graph, directed=False)
        for each in np.flatnonzero(np.bincount(label) > 1) if count > 1 else ():
            yield label == each

    def _by_stretches(self) -> Iterator[Cut]:
        """Seek among all stretches of the tour at once, by sums over a table of its places."""
        first, last, leaving = self._leaving(self._share)
        broken = np.where(last - first < self._size - 2, 2.0 - leaving, 0.0)
        for nodes in self._worst(first, last, broken):
            yield from self._subtour(nodes)
        _, _, odd = self._leaving((self._share > 0.5).astype(float))
        doubt: Array = np.minimum(self._share, 1.0 - self._share)
        _, _, slack = self._leaving(doubt)
        broken = np.where(np.round(odd) % 2 == 1, 1.0 - slack, 0.0)
        for nodes in self._worst(first, last, broken):
            yield from self._blossom(nodes)

    def _leaving(self, weight: Array) -> tuple[Ints, Ints, Array]:
        """Return every stretch's first and last place, and the weight of edges that leave it."""
        place = np.argsort(self._tour)[self.edges]
        table = np.zeros((self._size, self._size))
        table[place.min(axis=1), place.max(axis=1)] = weight
        sums = np.pad(table.cumsum(axis=0).cumsum(axis=1), (1, 0))
        degree = np.pad((table.sum(axis=0) + table.sum(axis=1)).cumsum(), (1, 0))
        first, last = np.triu_indices(self._size, 1)
        end = last + 1
        inside = sums[end, end] - sums[first, end] - sums[end, first] + sums[first, first]
        return first, last, degree[end] - degree[first] - 2.0 * inside

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

    def _subtour(self, nodes: Bools) -> Iterator[Cut]:
        cut = Cut(nodes[None], 2.0)
        if self._share @ cut.row(self.edges) < cut.least - VIOLATED:
            yield cut

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
        sets = np.zeros((1 + len(teeth), self._size), dtype=bool)
        sets[0] = handle
        np.put_along_axis(sets[1:], teeth, values=True, axis=1)
        cut = Cut(sets, 3.0 * len(teeth) + 1.0)
        if self._share @ cut.row(self.edges) < cut.least - VIOLATED:
            yield cut

    def _teeth(self, handle: Bools) -> Ints:
        """Return the edges (T, 2) that mostly leave the handle."""
        leaves = handle[self.edges[:, 0]] != handle[self.edges[:, 1]]
        teeth: Ints = self.edges[leaves & (self._share > 0.5)]
        return teeth
