"""A proven lower bound on the length of open routes: 1-trees, and cuts that every tour respects.

A hub at distance 0 from every hole closes a route with free ends to a tour. Give each hole a price
that all its edges cost in addition: a tour has two edges at each hole, so it costs twice the prices
more than its length; and the hub's two cheapest edges with the least spanning tree of the holes
never cost more than a tour. Their cost less twice the prices is a bound for any prices (Held and
Karp's 1-trees). Prices may be tuned on few edges, but a bound counts only when evaluated on all;
and the best prices still leave a gap, about 1 % for scattered holes, 12 % where single rows meet.

There edges get shares 0..1, two per hole, and cuts that every tour respects: subtours (2 edges
leave any set of holes), blossoms and stars. The solver's value is no proof, for it saw few edges
and rounds. Its prices are one: any prices of holes and cuts bound every tour, once the edges that
they make cheap are counted over all pairs.

A star is the cost for every tour of an odd number of row ends at one place. Where three rows meet,
one has to be gone over twice or left by a jump. A blossom sees that at one step along the rows;
shares avoid it by going over the row one and a third times. A star sees it at many steps: handles
H, each within the next, and an odd number t of disjoint teeth that each have a node in the first
handle, in every shell between two handles, and outside the last. Every tour leaves them all
together H (t + 1) + 2 t times at least: each tooth that is one piece of the tour crosses all
handles, each further piece spares one crossing and costs two ends, and a handle is left an even
number of times. (Fleischmann 1988; one handle: a comb.)
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

from hilcell.geometry.kinematics import Array, Bools, Ints
from hilcell.ports import HilcellError

CANDIDATES = 10  # near holes whose edges the prices are tuned on
ROUNDING = 1e-9  # share of the bound given away to rounding


def lower_bound(distance: Array, order: Ints) -> float:
    """Return a length that no open route through distances (N, N) is below.

    ``order`` (N,) is any route: its edges make the tuning's graph connected, its length scales
    the steps. The bound holds however well the prices were tuned.
    """
    trees = 4  # of tuning, each on the edges that the full tree of the last one used as well
    if len(distance) < 3:
        return float(distance[order[:-1], order[1:]].sum())
    edges = candidates(distance, order)
    target_mm = float(distance[order[:-1], order[1:]].sum())
    price, best = np.zeros(len(distance)), 0.0
    for _ in range(trees):
        price = _tuned(distance, edges, price, target_mm)
        bound_mm, tree = _evaluated(distance, price)
        best = max(best, bound_mm)
        more = np.unique(np.vstack([edges, tree]), axis=0)
        if len(more) == len(edges):
            break
        edges = more
    return float(best * (1.0 - ROUNDING))


def candidates(distance: Array, order: Ints) -> Ints:
    """Return edges (E, 2), lower hole first: to near holes, and along the route."""
    count = len(distance)
    near = np.argsort(distance, axis=1, kind="stable")[:, : CANDIDATES + 1]
    first = np.repeat(np.arange(count), near.shape[1])
    pairs = np.vstack(
        [np.column_stack([first, near.ravel()]), np.column_stack([order[:-1], order[1:]])]
    )
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    return np.unique(np.sort(pairs, axis=1), axis=0)


def _tuned(distance: Array, edges: Ints, price: Array, target_mm: float) -> Array:
    """Return prices (N,) that raise the bound over ``edges``, by subgradient steps."""
    tuning_steps = 400
    patience = 15  # steps without a better bound before the step is halved
    inertia = 0.3  # share of the step before in the next one
    count, (one, other) = len(price), edges.T
    plain = distance[one, other]
    starts = np.searchsorted(one, np.arange(count + 1))
    best, best_price, direction = -np.inf, price, np.zeros(count)
    scale, idle = 1.0, 0
    for _ in range(tuning_steps):
        weight = plain + price[one] + price[other]
        low = weight.min() - 1.0  # csgraph takes a weight of 0 for no edge
        graph = csr_array((weight - low, other, starts), shape=(count, count))
        tree = minimum_spanning_tree(graph).tocoo()
        hub = np.argpartition(price, 1)[:2]
        bound_mm = tree.data.sum() + low * (count - 1) + price[hub].sum() - 2 * price.sum()
        if bound_mm > best:
            best, best_price, idle = bound_mm, price, 0
        elif (idle := idle + 1) >= patience:
            scale, idle = scale / 2, 0
        excess = np.bincount(np.concatenate([tree.row, tree.col, hub]), minlength=count) - 2.0
        if not excess.any():
            break  # the tree is a route: nothing is better
        direction = excess + inertia * direction
        step = scale * max(target_mm - bound_mm, 1e-3 * target_mm) / (excess @ excess)
        price = price + step * direction
    return best_price


def _evaluated(distance: Array, price: Array) -> tuple[float, Ints]:
    """Return the bound for these prices on all edges, and the tree (N - 1, 2), by Prim."""
    count = len(price)
    outside = np.ones(count, dtype=bool)
    cheapest, parent = np.full(count, np.inf), np.zeros(count, dtype=int)
    tree, total, newest = [], 0.0, 0
    for _ in range(count - 1):
        outside[newest] = False
        weight = distance[newest] + price[newest] + price
        nearer = outside & (weight < cheapest)
        cheapest[nearer], parent[nearer] = weight[nearer], newest
        newest = int(np.argmin(np.where(outside, cheapest, np.inf)))
        total += cheapest[newest]
        tree.append(sorted((int(parent[newest]), newest)))
    return total + np.partition(price, 1)[:2].sum() - 2 * price.sum(), np.array(tree)


VIOLATED = 1e-3  # less is not worth a cut


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

    CLOSE = 0.3  # a blossom that holds by less may grow into a star that does not
    MOST_STARS = 100  # of one round

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
            if seed.missed(edges, share) > -self.CLOSE:
                grown = _Growth(matrix, seed).star()
                missed = grown.missed(edges, share)
                if missed > VIOLATED:
                    found[grown.sets.tobytes()] = (missed, grown)
        worst = sorted(found.values(), key=lambda each: -each[0])
        return [cut for _, cut in worst[: self.MOST_STARS]]


class _Growth:
    """A blossom on its way to a star: shells of one node a tooth, put on outside, then inside."""

    MOST_SHELLS = 12  # in each direction
    HELD = 0.05  # share by which a node must hang on a tooth to join it

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
        while len(handles) < self.MOST_SHELLS:
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
            if row[tip] < _Growth.HELD:
                return None
            free[:, tip] = 0.0
            tips.append(tip)
        return np.array(tips)


# Cuts are sought where they lie as a rule, not by proof: among the parts into which edges of
# middling and of large shares fall, and among the stretches of a good tour. Where none is found,
# one may be broken all the same.


class Separation:
    """Seeks cuts, round after round, around one closed tour (M,) of all nodes."""

    MOST_STRETCHES = 40  # of one kind, in one round
    APART = 3  # nodes by which the ends of such stretches differ at least

    def __init__(self, tour: Ints) -> None:
        self._tour, self._place, self._size = tour, np.argsort(tour), len(tour)
        self._stars = Stars()

    def broken(self, edges: Ints, share: Array) -> list[Cut]:
        """Return cuts that the shares (E,) of edges (E, 2) break."""
        used = share > 0.0
        shares = _Shares(edges[used], share[used], self._size)
        sought = [*shares.by_parts()]
        for nodes in self._stretches(shares):
            sought += shares.cuts_of(nodes)
        found = [cut for cut in sought if cut.missed(shares.edges, shares.share) > VIOLATED]
        self._stars.remember(found)
        found += self._stars.broken(shares.edges, shares.share)
        return list({cut.sets.tobytes(): cut for cut in found}.values())

    def _stretches(self, shares: _Shares) -> Iterator[Bools]:
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
        return np.asarray(degree[None, 1:] - degree[:-1, None] - 2.0 * inside)

    def _worst(self, first: Ints, last: Ints, broken: Array) -> Iterator[Bools]:
        """Yield the nodes of the most broken stretches, no two of nearly the same ends."""
        bad = np.flatnonzero(broken > VIOLATED)
        bad = bad[np.argsort(-broken[bad], kind="stable")]
        taken = np.zeros((2, 0))
        for at in bad[: 50 * self.MOST_STRETCHES]:
            ends = np.array([[first[at]], [last[at]]])
            if taken.shape[1] < self.MOST_STRETCHES and not self._near(taken, ends):
                taken = np.hstack([taken, ends])
                nodes = np.zeros(self._size, dtype=bool)
                nodes[self._tour[first[at] : last[at] + 1]] = True
                yield nodes

    @staticmethod
    def _near(taken: Array, ends: Ints) -> bool:
        return bool((np.abs(taken - ends) < Separation.APART).all(axis=0).any())


class _Shares:
    """The edges (E, 2) in use between ``size`` nodes, and their shares (E,)."""

    LEVELS = (1e-6, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 0.95)  # of shares, that split the graph

    def __init__(self, edges: Ints, share: Array, size: int) -> None:
        self.edges, self.share, self._size = edges, share, size

    def by_parts(self) -> Iterator[Cut]:
        """Yield cuts of the parts into which edges of middling and of large shares fall."""
        for level in self.LEVELS:
            for nodes in self._parts(self.share > level):
                yield Cut(nodes[None], 2.0)
            if level < 0.5:
                for nodes in self._parts((self.share > level) & (self.share < 1.0 - level)):
                    yield from self._blossom(nodes)

    def cuts_of(self, nodes: Bools) -> Iterator[Cut]:
        """Yield the subtour and the blossom around ``nodes`` (M,)."""
        yield Cut(nodes[None], 2.0)
        yield from self._blossom(nodes)

    def _parts(self, chosen: Bools) -> Iterator[Bools]:
        edges = self.edges[chosen]
        ends = (edges[:, 0], edges[:, 1])
        graph = csr_array((np.ones(len(edges)), ends), shape=(self._size, self._size))
        count, label = connected_components(graph, directed=False)
        for each in np.flatnonzero(np.bincount(label) > 1) if count > 1 else ():
            yield label == each

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
        yield star(handle[None], sets)

    def _teeth(self, handle: Bools) -> Ints:
        """Return the edges (T, 2) that mostly leave the handle."""
        leaves = handle[self.edges[:, 0]] != handle[self.edges[:, 1]]
        return np.asarray(self.edges[leaves & (self.share > 0.5)])


def cut_bound(distance: Array, order: Ints, enough_mm: float) -> float:
    """Return a length below every open route through distances (N, N), up to ``enough_mm``.

    ``order`` (N,) is a good route, among whose stretches cuts are sought.
    """
    rounds = 25
    proven = 1e-4  # share of the bound that is not worth another edge
    program, separation = _Program(distance, order), Separation(np.append(order, len(order)))
    for _ in range(rounds):
        if program.solve() >= enough_mm:
            break
        cuts = separation.broken(program.edges, program.share)
        if not cuts:
            break
        program.add(cuts)
    best_mm = 0.0
    for _ in range(rounds):
        solved_mm = program.solve()
        bound_mm, missing = program.proven()
        best_mm = max(best_mm, bound_mm)
        if not len(missing) or best_mm >= solved_mm * (1.0 - proven):
            break
        program.edges = np.vstack([program.edges, missing])
    return best_mm * (1.0 - ROUNDING)


class _Program:
    """Shares of edges between holes and a hub, the last node, at distance 0 from each."""

    PRICED = 1e-9  # cuts with less price are dropped

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
        """Find shares and prices, return the length; raises `HilcellError` where there are none."""
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
            raise HilcellError(f"lower bound: {found.message}", code="HC-C10")
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
        self._cuts = [cut for cut, price in priced if price > self.PRICED] + cuts

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
