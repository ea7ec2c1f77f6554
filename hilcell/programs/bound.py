"""A proven lower bound on the length of open routes: Held and Karp's 1-trees.

A hub at distance 0 from every hole closes a route with free ends to a tour. Give each hole a price
that all its edges cost in addition: a tour has two edges at each hole, so it costs twice the prices
more than its length; and the hub's two cheapest edges with the least spanning tree of the holes
never cost more than a tour. Their cost less twice the prices is a bound for any prices. Prices may
be tuned on few edges, but a bound counts only when evaluated on all; and the best prices still
leave a gap, about 1 % for scattered holes, 12 % where single rows meet. `hilcell.programs.route`
narrows that.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import minimum_spanning_tree

from hilcell.geometry.kinematics import Array

CANDIDATES = 10  # near holes whose edges the prices are tuned on
TUNING_STEPS = 400
PATIENCE = 15  # steps without a better bound before the step is halved
INERTIA = 0.3  # share of the step before in the next one
ROUNDS = 4  # of tuning, each on the edges that the full tree of the last one used as well
ROUNDING = 1e-9  # share of the bound given away to rounding
Ints = NDArray[np.int_]


def lower_bound(distance: Array, order: Ints) -> float:
    """Return a length that no open route through distances (N, N) is below.

    ``order`` (N,) is any route: its edges make the tuning's graph connected, its length scales
    the steps. The bound holds however well the prices were tuned.
    """
    if len(distance) < 3:
        return float(distance[order[:-1], order[1:]].sum())
    edges = candidates(distance, order)
    target_mm = float(distance[order[:-1], order[1:]].sum())
    price, best = np.zeros(len(distance)), 0.0
    for _ in range(ROUNDS):
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
    count, (one, other) = len(price), edges.T
    plain = distance[one, other]
    starts = np.searchsorted(one, np.arange(count + 1))
    best, best_price, direction = -np.inf, price, np.zeros(count)
    scale, idle = 1.0, 0
    for _ in range(TUNING_STEPS):
        weight = plain + price[one] + price[other]
        low = weight.min() - 1.0  # csgraph takes a weight of 0 for no edge
        graph = csr_array((weight - low, other, starts), shape=(count, count))
        tree = minimum_spanning_tree(graph).tocoo()
        hub = np.argpartition(price, 1)[:2]
        bound_mm = tree.data.sum() + low * (count - 1) + price[hub].sum() - 2 * price.sum()
        if bound_mm > best:
            best, best_price, idle = bound_mm, price, 0
        elif (idle := idle + 1) >= PATIENCE:
            scale, idle = scale / 2, 0
        excess = np.bincount(np.concatenate([tree.row, tree.col, hub]), minlength=count) - 2.0
        if not excess.any():
            break  # the tree is a route: nothing is better
        direction = excess + INERTIA * direction
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
