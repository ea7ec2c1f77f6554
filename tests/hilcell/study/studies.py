"""Study files for tests, and workers that know the results."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path

from hilcell.cell.file import Cell
from hilcell.study.case import CaseResult, decode_cell
from hilcell.study.cluster import ClusterError
from hilcell.study.design import Case
from hilcell.study.results import Results
from hilcell.study.runner import run_study
from hilcell.study.study_file import Study, read_study
from tests.whole.bench import SMALL

OF_STUDIES = ("plan.quick",)  # which their own files state
SETTINGS = "\n".join(f'"{key}" = {value}' for key, value in SMALL.items() if key not in OF_STUDIES)
TWO_FACTORS = """
[[factor]]
name = "readings"
setting = "layout.nest_samples"
levels = [2, 5]
costs = [0, 100]

[[factor]]
name = "place"
setting = "grid.centre.x_mm"
levels = [1850.0, 3850.0]
labels = ["near", "far"]
"""


def written(
    folder: Path, factors: str = TWO_FACTORS, head: str = "machines = 2", name: str = "study.toml"
) -> Path:
    path = folder / name
    path.write_text(f'name = "trial"\n{head}\n\n[settings]\n{SETTINGS}\n{factors}')
    return path


def study(folder: Path, factors: str = TWO_FACTORS, head: str = "machines = 2") -> Study:
    return read_study(written(folder, factors, head))


@cache
def cell_in(content: bytes) -> Cell:
    """Return the cell of a case; cases of one study share it."""
    return decode_cell(content)


class Bench:
    """Workers that find what ``result`` says of a case; they vanish after ``most`` cases."""

    def __init__(
        self,
        result: Callable[[Case, Cell], CaseResult],
        most: int = 10**9,
        *,
        backwards: bool = False,
    ) -> None:
        self._result, self._most, self._backwards = result, most, backwards
        self.measured: list[int] = []

    def measure(self, waiting: Iterable[tuple[Case, bytes]]) -> Iterator[tuple[Case, CaseResult]]:
        for case, content in reversed(list(waiting)) if self._backwards else waiting:
            if len(self.measured) == self._most:
                raise ClusterError("scheduler tcp://nowhere is gone")
            self.measured.append(case.number)
            yield case, self._result(case, cell_in(content))


def performed(results: Results, bench: Bench) -> dict[str, int]:
    """Run a study to its end; return how many cases ended in each state."""
    with results.held():
        return dict(run_study(results, bench, lambda _: None))  # type: ignore[arg-type] # of Dask
