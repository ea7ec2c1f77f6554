"""The traps of a hall (`hilcell sim --traps`): each is named by its step, or its value is mended.

A case is the number of a row of `tests.whole.trapped`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from campaigns.spread import print_table, spread
from tests.whole.halls import Commissioned
from tests.whole.trapped import TRAPPED, Trapped, trapped

COUNT = len(TRAPPED)


class Case(NamedTuple):
    """A trap in its hall, what the commissioning was, and what is wrong with it."""

    row: Trapped
    hall: Commissioned
    problems: list[str]


def campaign(numbers: range) -> int:
    """Judge the rows by their numbers, from 1 on."""
    return 0 if report(spread(case, (n for n in numbers if n <= COUNT))) else 1


def case(number: int) -> Case:
    row = TRAPPED[number - 1]
    with tempfile.TemporaryDirectory() as name:
        return Case(row, *trapped(row, Path(name)))


def report(cases: Iterable[Case]) -> bool:
    """Print a row a trap; return whether each was named, and nothing moved unannounced."""
    all_cases = list(cases)
    print_table(
        ("trap", "hall", "step", "exit", "robot min", "", "proof"),
        (
            (
                row.trap,
                row.seed,
                row.step,
                hall.done.returncode,
                f"{hall.robot_min:.1f}",
                "failed" if problems else "named",
                row.proof,
            )
            for row, hall, problems in all_cases
        ),
    )
    for row, _, problems in all_cases:
        for problem in problems:
            print(f"{row.trap}: {problem}")
    named = sum(not each.problems for each in all_cases)
    print(f"traps named in the right step, without a motion beyond: {named} of {len(all_cases)}")
    return bool(all_cases) and named == len(all_cases)
