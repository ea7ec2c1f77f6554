"""Names beside their lines: free cells near a series, nearer to it than to any other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
FARTHEST = 3  # rows between a name and its line
EDGE = 1  # free columns around a name
ENOUGH = 4  # rows to another line, beyond which more are no better


@dataclass(frozen=True, slots=True)
class Spot:
    """Row and column of a name's first letter."""

    row: int
    column: int


def place(
    names: Sequence[str], lines: Sequence[Bools], wanted: Sequence[float]
) -> list[Spot | None]:
    """Return a spot for each name, or None where there is no room.

    ``lines``: the cells (rows, columns) that each series covers. ``wanted``: the share of the
    width at which each name had best begin, so that names are apart.
    """
    taken: Bools = np.any(lines, axis=0)
    away = [_rows_away(line) for line in lines]
    spots: list[Spot | None] = []
    for number, name in enumerate(names):
        others = [each for n, each in enumerate(away) if n != number]
        spot = _spot(len(name), lines[number], others, taken, wanted[number])
        if spot is not None:
            around = slice(max(spot.column - EDGE, 0), spot.column + len(name) + EDGE)
            taken[spot.row, around] = True
        spots.append(spot)
    return spots


def _rows_away(line: Bools) -> Ints:
    """Return how many rows each cell (rows, columns) is from a line above or below it."""
    height = len(line)
    away = np.where(line, 0, height)
    for row in range(1, height):
        away[row] = np.minimum(away[row], away[row - 1] + 1)
    for row in reversed(range(height - 1)):
        away[row] = np.minimum(away[row], away[row + 1] + 1)
    return away


def _in_windows(cells: Bools, span: int) -> Bools:
    """Return whether any of ``span`` cells from each start on is set, (rows, starts)."""
    found: Bools = np.any(sliding_window_view(cells, span, axis=1), axis=2)
    return found


def _spot(
    length: int, own: Bools, others: Sequence[Ints], taken: Bools, wanted: float
) -> Spot | None:
    height, width = own.shape
    span = length + 2 * EDGE
    if width < span:
        return None
    covered, busy = _in_windows(own, span), _in_windows(taken, span)
    foreign = np.full(covered.shape, height)
    for away in others:
        foreign = np.minimum(foreign, sliding_window_view(away, span, axis=1).min(axis=2))
    top, bottom = covered.argmax(axis=0), height - 1 - covered[::-1].argmax(axis=0)
    starts = np.arange(covered.shape[1])
    aside = abs(starts / width - wanted) * height / 3
    best, least = None, np.inf
    for far, side in product(range(1, FARTHEST + 1), (-1, 1)):
        rows = (top if side < 0 else bottom) + side * far
        inside = np.clip(rows, 0, height - 1)
        near = foreign[inside, starts]
        fits = (rows == inside) & covered.any(axis=0) & ~busy[inside, starts] & (near > far)
        costs = np.where(fits, far + aside - 0.5 * np.minimum(near, ENOUGH), np.inf)
        at = int(costs.argmin())
        if costs[at] < least:
            best, least = Spot(int(rows[at]), at + EDGE), float(costs[at])
    return best
