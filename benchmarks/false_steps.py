"""How often a study shows what is not there: ``python -m benchmarks.false_steps [STUDIES]``.

Drawn studies of 32 of 81 designs, in which factors a, b and c do nothing; seeds from 5000 on.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

from benchmarks.words import parser
from hilcell.study.analysis import Answers, answers
from tests.hilcell.study.null_studies import (
    THIRTY_TWO,
    THREE_LEVELS,
    Errors,
    alike,
    equal,
    null_studies,
    scattered,
    together,
)
from tests.hilcell.study.studies import study

FIRST_SEED = 5000


def found(machines: int, errors: Errors, studies: int) -> Iterator[Answers]:
    with tempfile.TemporaryDirectory() as folder:
        asked = study(Path(folder), THREE_LEVELS, THIRTY_TWO.format(machines))
    for own in null_studies(asked, errors, range(FIRST_SEED, FIRST_SEED + studies)):
        yield answers(asked, own)


def false_step(of: Answers) -> bool:
    return any(each.shown in {"gain", "loss"} for each in of.purchases if each.factor.name != "d")


def false_interaction(of: Answers) -> bool:
    return any(each.known for each in of.interactions)


def false_better(of: Answers) -> bool:
    """Whether a slower or dearer design of the front is unmarked, though all are equal."""
    return any(slower.equal_to is None for _, slower in pairwise(of.front))


def main() -> None:
    words = parser(__doc__)
    words.add_argument("studies", type=int, nargs="?", default=200)
    count = words.parse_args().studies
    print(f"{count} studies each; shown, though it is not there, in percent of studies")
    print("errors      machines  any step  any interaction  better on the front")
    for errors in (scattered, alike, together, equal):
        for machines in (4, 8):
            steps = interactions = better = 0
            for each in found(machines, errors, count):
                steps += false_step(each)
                interactions += false_interaction(each)
                better += false_better(each)
            there = f"{100 * interactions / count:.1f}" if errors is not together else "there"
            equals = f"{100 * better / count:.1f}" if errors is equal else "-"
            share = f"{100 * steps / count:.1f}"
            print(f"{errors.__name__:10}  {machines:8}  {share:>8}  {there:>15}  {equals:>19}")


if __name__ == "__main__":
    main()
