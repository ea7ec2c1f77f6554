"""Cases of a campaign, spread over all processors."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

Case = TypeVar("Case")
Found = TypeVar("Found")


def spread(
    work: Callable[[Case], Found], cases: Iterable[Case], *, at_once: int = 1
) -> Iterator[Found]:
    """Yield what ``work`` finds for each case, in the order of the cases.

    ``at_once``: on each processor, where cases mostly wait.
    """
    with ProcessPoolExecutor(at_once * len(os.sched_getaffinity(0))) as pool:
        yield from pool.map(work, cases)


def progress(text: str) -> None:
    """Print a line of progress, which is no figure."""
    print(text, file=sys.stderr, flush=True)


def print_table(head: tuple[str, ...], rows: Iterable[tuple[object, ...]]) -> None:
    """Print a table, its first column flush left, the others flush right."""
    lines = [head, *(tuple(str(cell) for cell in row) for row in rows)]
    widths = [max(len(line[n]) for line in lines) for n in range(len(head))]
    for line in lines:
        first, *others = (cell for cell in line)
        cells = [f"{cell:>{width}}" for cell, width in zip(others, widths[1:], strict=True)]
        print("  ".join([f"{first:<{widths[0]}}", *cells]).rstrip())
