"""Short routes through holes, and a proven bound below which no route can be.

A route is open and its ends are free: a hub at distance 0 from every hole closes it to a tour.
Nearest neighbours start it, 2-opt and Or-opt over near holes shorten it, and small kicks repeat
that until it is near its bound. Where a few kicks do not get it there, the bound is sharpened
first. A search that stops by the clock would answer differently on another machine; this one counts
its kicks and draws them from a fixed seed.
"""

from __future__ import annotations

import random
from array import array
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from hilcell.geometry.kinematics import Array, Ints
from hilcell.programs.bound import cut_bound, lower_bound


@dataclass(frozen=True, slots=True)
class Route:
    """Order of visit (N,), its length, and a length that no order is below."""

    order: Ints
    travel_mm: float
    bound_mm: float


def route(points_mm: Array) -> Route:
    """Return a short open route with free ends through points (N, 3), N >= 1."""
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
    """Return the order (N,) that always goes to the nearest hole left, from the outermost."""
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
        self._queue: dict[int, None] = {}  # nodes around which to look, the latest first
        self._chance = random.Random(1)  # noqa: S311 - no secret

    def run(self, good_mm: float, kicks_per_hole: int) -> Ints:
        """Shorten until ``good_mm`` or all kicks are spent; another run goes on from there."""
        self._look_at(self._tour)
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
        for way in (1, -1):
            b = tour[(place[a] + way) % size]
            for c in self._near[a]:
                first = row[b] - row[c]
                if first <= self.NEGLIGIBLE_MM:
                    break
                d = tour[(place[c] + way) % size]
                gain = first + rows[c][d] - rows[b][d]
                if gain > self.NEGLIGIBLE_MM:
                    self._reverse(*((b, c) if way > 0 else (a, d)))
                    self._look_at((a, b, c, d))
                    return gain
        return 0.0

    def _or_opt(self, a: int) -> float:
        """Move a stretch that ends in a between c and a neighbour of c; return the gain."""
        for way in (1, -1):
            stretch = [a]
            for _ in range(self.LONGEST_STRETCH):
                gain = self._moved(stretch, way)
                if gain > 0:
                    return gain
                stretch.append(self._tour[(self._place[stretch[-1]] - way) % len(self._tour)])
        return 0.0

    def _moved(self, stretch: list[int], way: int) -> float:
        """Put ``stretch`` with its first node beside c where that shortens; return the gain."""
        rows, tour, place = self._rows, self._tour, self._place
        size, a, e = len(tour), stretch[0], stretch[-1]
        b, p = tour[(place[a] + way) % size], tour[(place[e] - way) % size]
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
                    self._look_at((a, b, c, d, e, p))
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
        self._look_at(ends)
        return rows[a][b] + rows[c][d] + rows[e][f] - rows[a][d] - rows[e][b] - rows[c][f]

    def _look_at(self, nodes: Iterable[int]) -> None:
        self._queue.update(dict.fromkeys(nodes))

    def _number(self, low: int, high: int) -> None:
        tour, place = self._tour, self._place
        for at in range(low, min(high, len(tour))):
            place[tour[at]] = at
