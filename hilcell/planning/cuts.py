"""A stronger lower bound where Held and Karp's is weak: linear programming with cuts.

Single rows of holes that meet leave 1-trees up to 12 % below any tour. Here edges get shares 0..1,
two per hole, and cuts that every tour respects: subtours (2 edges leave any set of holes), blossoms
and stars. The solver's value is no proof, for it saw few edges and rounds. Its prices are one: any
prices of holes and cuts bound every tour, once the edges that they make cheap are counted over all
pairs.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_array

from hilcell.geometry.kinematics import Array
from hilcell.planning.bound import ROUNDING, candidates
from hilcell.planning.separation import Separation
from hilcell.planning.stars import VIOLATED, Bools, Cut, Ints
from hilcell.ports import HilcellError

ROUNDS = 25
PROVEN = 1e-4  # share of the bound that is not worth another edge
PRICED = 1e-9  # cuts with less price are dropped


def cut_bound(distance: Array, order: Ints, enough_mm: float) -> float:
    """Return a length that no open route through distances (N, N) is below.

    ``order`` (N,) is a good route: cuts are sought among its stretches, until the bound is near
    ``enough_mm``.
    """
    program, separation = _Program(distance, order), Separation(np.append(order, len(order)))
    for _ in range(ROUNDS):
        if program.solve() >= enough_mm:
            break
        cuts = separation.broken(program.edges, program.share)
        if not cuts:
            break
        program.add(cuts)
    best_mm = 0.0
    for _ in range(ROUNDS):
        solved_mm = program.solve()
        bound_mm, missing = program.proven()
        best_mm = max(best_mm, bound_mm)
        if not len(missing) or best_mm >= solved_mm * (1.0 - PROVEN):
            break
        program.edges = np.vstack([program.edges, missing])
    return best_mm * (1.0 - ROUNDING)


class CutError(HilcellError):
    """A linear program that the solver gave up."""

    code = "HC-C10"


class _Program:
    """Shares of edges between holes and a hub, the last node, at distance 0 from each."""

    def __init__(self, distance: Array, order: Ints) -> None:
        count = len(distance)
        self._size = count + 1
        self._cost = np.pad(distance, (0, 1))
        spokes = np.column_stack([np.arange(count), np.full(count, count)])
        self.edges = np.vstack([candidates(distance, order), spokes])
        self._cuts: list[Cut] = []
        self.share = np.zeros(len(self.edges))
        self._node_price, self._cut_price = np.zeros(self._size), np.zeros(0)

    def solve(self) -> float:
        """Find shares and prices for the cuts so far, and return the length of these shares.

        Raises `CutError` where there are none.
        """
        edges, count = self.edges, len(self.edges)
        ends = (edges.T.ravel(), np.tile(np.arange(count), 2))
        degree = csr_array((np.ones(2 * count), ends), shape=(self._size, count))
        rows = self._rows()
        found = linprog(  # type: ignore[call-overload] # stubs know no sparse matrices
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
        self.share, self._node_price = found.x, found.eqlin.marginals
        self._cut_price = np.maximum(-found.ineqlin.marginals, 0.0)
        return float(found.fun)

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
