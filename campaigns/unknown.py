"""Halls that nobody has measured, each from `hilcell sim` to corrected programs over the wires.

A case is the seed of a hall. It is commissioned by its sheet, calibrated, and a drawing of holes is
prepared; all is judged by the hall's truth (`tests.whole.halls`): the cell file, the questions, the
time, and that nothing moves beyond what was announced.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from campaigns.spread import print_table, progress, spread
from tests.whole.halls import Calibrated, Commissioned, calibrated, commissioned, unknown_hall

COUNT = 20


class Case(NamedTuple):
    """A hall, what its commissioning was, and its calibration; None where it got not so far."""

    seed: int
    hall: Commissioned
    cell: Calibrated | None

    @property
    def problems(self) -> list[str]:
        return self.hall.problems + (
            ["not calibrated"] if self.cell is None else self.cell.problems
        )


def campaign(seeds: range) -> int:
    return 0 if report(spread(case, seeds)) else 1


def case(seed: int) -> Case:
    """Commission and calibrate one hall."""
    with tempfile.TemporaryDirectory() as name:
        file = Path(name) / "mycell.toml"
        with unknown_hall(Path(name) / "hall", seed) as hall:
            found = commissioned(hall, file)
            cell = calibrated(file) if found.done.returncode == 0 else None
        done = Case(seed, found, cell)
        progress(f"  seed {seed}: {'; '.join(done.problems) or 'ready'}")
        return done


def report(cases: Iterable[Case]) -> bool:
    """Print a row a hall; return whether all are commissioned, calibrated and within the bounds."""
    all_cases = list(cases)
    print_table(
        ("seed", "questions", "robot min", "and person", "mean mm", "largest mm", ""),
        (
            (
                each.seed,
                each.hall.questions,
                f"{each.hall.robot_min:.1f}",
                f"{each.hall.robot_min + each.hall.person_min:.1f}",
                "" if each.cell is None else f"{each.cell.mean_mm:.3f}",
                "" if each.cell is None else f"{each.cell.largest_mm:.3f}",
                "failed" if each.problems else "ready",
            )
            for each in all_cases
        ),
    )
    for each in all_cases:
        for problem in each.problems:
            print(f"seed {each.seed}: {problem}")
    ready = sum(not each.problems for each in all_cases)
    print(f"halls that are ready, in tolerance and moved as announced: {ready} of {len(all_cases)}")
    return bool(all_cases) and ready == len(all_cases)
