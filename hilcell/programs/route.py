"""Short routes through holes, and a proven lower bound.

A route is open with free ends: a hub at distance 0 from every hole closes it to a tour. Nearest
neighbours start it, 2-opt and Or-opt over near holes shorten it, and small kicks, counted and drawn
from a fixed seed, repeat that until it is near its bound, which is sharpened first where a few
kicks do not suffice.

Bound: give each hole a price that all its edges cost in addition. A tour has two edges at each
hole, so it costs twice the prices more than its length; and the hub's two cheapest edges with the
least spanning tree of the holes never cost more than a tour. Their cost less twice the prices is a
bound for any prices (Held and Karp's 1-trees), once evaluated on all edges. The best prices leave a
gap, about 1 % for scattered holes, 12 % where single rows meet.

There edges get shares 0..1, two per hole, and cuts that every tour respects: subtours (2 edges
leave any set of holes), blossoms and stars. The solver uses few edges and rounds, so its value is
no proof, but its prices of holes and cuts bound every tour, once the edges that they make cheap are
counted over all pairs.

A star covers an odd number of row ends at one place, where one row has to be passed twice or left
by a jump: handles H, each within the next, and an odd number t of disjoint teeth that each have a
node in the first handle, in every shell between two handles, and outside the last. Every tour
leaves them all together H (t + 1) + 2 t times at least: each tooth that is one piece of the tour
crosses all handles, each further piece spares one crossing and costs two ends, and a handle is left
an even number of times. (Fleischmann 1988; one handle: a comb. A blossom covers only one step along
the rows.)
"""

from __future__ import annotations

import random
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial.distance import cdist

from hilcell.geometry.kinematics import Array, Bools, Ints
from hilcell.ports import HilcellError


@dataclass(frozen=True, slots=True)
class Route:
    """Order of visit (N,), its length, and a length that no order is below."""

    order: Ints
    travel_mm: float
    travel_bound_mm: float


def route(points_mm: Array) -> Route:
    """A short open route with free ends through points (N, 3), N >= 1."""
    good = 1.02  # a route this near to its bound is not worth more search
    far = 1.03  # over its bound: the bound is to blame, as a rule, and worth sharpening
    first_kicks_per_hole = 2  # before the bound is sharpened
    kicks_per_hole = 4  # after that
    most_cut = 1000  # holes up to which sharpening is quick
    distance = cdist(points_mm, points_mm)
    first = _nearest_neighbours(distance)
    bound_mm = lower_bound(distance, first)

    def along(order: Ints) -> Route:
        travel_mm = float(distance[order[:-1], order[1:]].sum())
        return Route(order, travel_mm, min(bound_mm, travel_mm))  # passed by rounding only

    if len(first) < 4:
        return along(first)
    search = _Search(distance, first)
    order = search.run(good * bound_mm, first_kicks_per_hole)
    found = along(order)
    if found.travel_mm > far * bound_mm and len(order) <= most_cut:
        bound_mm = max(bound_mm, cut_bound(distance, order, found.travel_mm / far))
    return along(search.run(good * bound_mm, kicks_per_hole))


def _nearest_neighbours(distance: Array) -> Ints:
    """Order (N,) by nearest neighbours, from the outermost hole."""
    open_ = np.ones(len(distance), dtype=bool)
    order = [int(distance.sum(axis=1).argmax())]
    for _ in range(len(distance) - 1):
        open_[order[-1]] = False
        order.append(int(np.argmin(np.where(open_, distance[order[-1]], np.inf))))
    return np.array(order)


class _Search:
    """A closed tour of holes and the hub (the last node), shortened in place."""

    SLACK = 0.3  # mean steps by which a kicked route may be worse than the best, at first
    KICK_SPAN = 50  # holes within which one kick swaps two stretches
    NEAR = 8  # holes that a new edge may lead to
    LONGEST_STRETCH = 3  # holes that Or-opt moves together
    NEGLIGIBLE_MM = 1e-7

    def __init__(self, distance: Array, order: Ints) -> None:
        self._hub = len(distance)
        padded = np.pad(distance, (0, 1))
        self._rows: list[array[float]] = [array("d", row.tobytes()) for row in padded]
        near = np.argsort(distance, axis=1, kind="stable")[:, : self.NEAR + 1]
        self._near: list[list[int]] = [
            [self._hub, *(hole for hole in row if hole != number)]
            for number, row in enumerate(near.tolist())
        ]
        self._near.append([])  # edges to the hub are found from the other end
        self._tour: list[int] = [*order.tolist(), self._hub]
        self._place = [0] * len(self._tour)
        self._number(0, len(self._tour))
        self._queue: dict[int, None] = {}  # nodes to improve around, the latest first
        self._chance = random.Random(1)  # noqa: S311 - no secret

    def run(self, good_mm: float, kicks_per_hole: int) -> Ints:
        """Shorten until ``good_mm`` or all kicks are spent; another call continues."""
        self._enqueue(self._tour)
        length_mm = self._length() - self._shortened()
        best_mm, best = length_mm, self._tour.copy()
        kicks = kicks_per_hole * self._hub
        for number in range(kicks):
            if best_mm <= good_mm:
                break
            tour, place = self._tour.copy(), self._place.copy()
            gain = self._kick() + self._shortened()
            worse_mm = self.SLACK * best_mm / self._hub * (1.0 - number / kicks)
            if length_mm - gain > best_mm + worse_mm:
                self._tour, self._place = tour, place
                continue
            length_mm -= gain
            if length_mm < best_mm - self.NEGLIGIBLE_MM:
                best_mm, best = length_mm, self._tour.copy()
        self._tour = best
        self._number(0, len(best))
        start = best.index(self._hub)
        return np.array(best[start + 1 :] + best[:start])

    def _length(self) -> float:
        tour = self._tour
        return sum(self._rows[a][b] for a, b in zip(tour, tour[1:] + tour[:1], strict=True))

    def _shortened(self) -> float:
        """Make moves around the queued nodes until none shortens; return the gain in mm."""
        total = 0.0
        while self._queue:
            node, _ = self._queue.popitem()
            while (gain := self._two_opt(node) or self._or_opt(node)) > 0:
                total += gain
        return total

    def _two_opt(self, a: int) -> float:
        """Replace edges a-b, c-d by a-c, b-d where that shortens; return the gain."""
        rows, tour, place = self._rows, self._tour, self._place
        size, row = len(tour), rows[a]
        for step in (1, -1):
            b = tour[(place[a] + step) % size]
            for c in self._near[a]:
                first = row[b] - row[c]
                if first <= self.NEGLIGIBLE_MM:
                    break
                d = tour[(place[c] + step) % size]
                gain = first + rows[c][d] - rows[b][d]
                if gain > self.NEGLIGIBLE_MM:
                    self._reverse(*((b, c) if step > 0 else (a, d)))
                    self._enqueue((a, b, c, d))
                    return gain
        return 0.0

    def _or_opt(self, a: int) -> float:
        """Move a stretch that ends in a between c and a neighbour of c; return the gain."""
        for step in (1, -1):
            stretch = [a]
            for _ in range(self.LONGEST_STRETCH):
                gain = self._moved(stretch, step)
                if gain > 0:
                    return gain
                stretch.append(self._tour[(self._place[stretch[-1]] - step) % len(self._tour)])
        return 0.0

    def _moved(self, stretch: list[int], step: int) -> float:
        """Put ``stretch`` with its first node beside c where that shortens; return the gain."""
        rows, tour, place = self._rows, self._tour, self._place
        size, a, e = len(tour), stretch[0], stretch[-1]
        b, p = tour[(place[a] + step) % size], tour[(place[e] - step) % size]
        if b in stretch or p in stretch or b == p:
            return 0.0
        out = rows[a][b] + rows[e][p] - rows[p][b]
        for c in self._near[a]:
            if rows[a][b] - rows[a][c] <= self.NEGLIGIBLE_MM:
                break
            if c in stretch:
                continue
            for side in (1, -1):
                d = tour[(place[c] + side) % size]
                gain = out - rows[a][c] - rows[e][d] + rows[c][d]
                if gain > self.NEGLIGIBLE_MM and d not in stretch:
                    self._insert(stretch, c, d)
                    self._enqueue((a, b, c, d, e, p))
                    return gain
        return 0.0

    def _insert(self, stretch: list[int], c: int, d: int) -> None:
        """Take ``stretch`` out and put it between neighbours c and d, its first node beside c."""
        tour, place = self._tour, self._place
        forward = tour[(place[c] + 1) % len(tour)] == d
        at = min(place[node] for node in stretch)
        if max(place[node] for node in stretch) - at >= len(stretch):  # round the list's end
            self._tour = tour = tour[len(stretch) :] + tour[: len(stretch)]
            self._number(0, len(tour))
            at = min(place[node] for node in stretch)
        del tour[at : at + len(stretch)]
        beside = place[c] - (len(stretch) if place[c] > at else 0)
        to = beside + 1 if forward else beside
        tour[to:to] = stretch if forward else stretch[::-1]
        self._number(min(at, to), max(at, to) + len(stretch))

    def _reverse(self, first: int, last: int) -> None:
        """Turn round the path from ``first`` forward to ``last``, or all the rest instead."""
        low, high = self._place[first], self._place[last]
        if low > high:
            low, high = high + 1, low - 1
        self._tour[low : high + 1] = self._tour[low : high + 1][::-1]
        self._number(low, high + 1)

    def _kick(self) -> float:
        """Swap two neighbouring stretches somewhere; return the gain, as a rule negative."""
        tour, rows = self._tour, self._rows
        size = len(tour)
        start = self._chance.randrange(size - 3)
        span = min(self.KICK_SPAN, size - 1 - start)
        i, j, k = sorted(self._chance.sample(range(start, start + span), 3))
        ends = (tour[i], tour[i + 1], tour[j], tour[j + 1], tour[k], tour[(k + 1) % size])
        a, b, c, d, e, f = ends
        tour[i + 1 : k + 1] = tour[j + 1 : k + 1] + tour[i + 1 : j + 1]
        self._number(i + 1, k + 1)
        self._enqueue(ends)
        return rows[a][b] + rows[c][d] + rows[e][f] - rows[a][d] - rows[e][b] - rows[c][f]

    def _enqueue(self, nodes: Iterable[int]) -> None:
        self._queue.update(dict.fromkeys(nodes))

    def _number(self, low: int, high: int) -> None:
        tour, place = self._tour, self._place
        for at in range(low, min(high, len(tour))):
            place[tour[at]] = at


CANDIDATES = 10  # near holes whose edges the prices are tuned on
ROUNDING = 1e-9  # share of the bound given away to rounding


def lower_bound(distance: Array, order: Ints) -> float:
    """A lower bound of open routes through distances (N, N).

    ``order`` (N,) is any route: its edges make the tuning's graph connected, its length scales the
    steps. The bound is valid however well the prices were tuned.
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
    """Edges (E, 2), lower hole first: to near holes, and along the route."""
    count = len(distance)
    near = np.argsort(distance, axis=1, kind="stable")[:, : CANDIDATES + 1]
    first = np.repeat(np.arange(count), near.shape[1])
    pairs = np.vstack(
        [np.column_stack([first, near.ravel()]), np.column_stack([order[:-1], order[1:]])]
    )
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    return np.unique(np.sort(pairs, axis=1), axis=0)


def _tuned(distance: Array, edges: Ints, price: Array, target_mm: float) -> Array:
    """Prices (N,) that raise the bound over ``edges``, by subgradient steps."""
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
    """The bound for these prices on all edges, and the tree (N - 1, 2), by Prim."""
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
        return np.asarray(
            (self.sets[:, edges[:, 0]] != self.sets[:, edges[:, 1]]).sum(axis=0) * 1.0
        )

    def missed(self, edges: Ints, share: Array) -> float:
        """Return by how much the shares (E,) of edges (E, 2) break the cut, below 0 if not."""
        return float(self.least - share @ self.row(edges))


def star(handles: Bools, teeth: Bools) -> Cut:
    """Star of handles (H, M), each within the next, and an odd number of teeth."""
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
    """A blossom that grows to a star: shells of one node a tooth, put on outside, then inside."""

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
    """A lower bound of open routes through distances (N, N), up to ``enough_mm``. ``order`` (N,): a
    good route, among whose stretches cuts are searched.
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
        """Optimise shares and prices, return the length; raises `HilcellError` where infeasible."""
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
        """The bound that the prices prove on all edges, and edges (E, 2) that lower it."""
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
