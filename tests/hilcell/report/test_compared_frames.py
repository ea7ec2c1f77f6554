"""Runs that measured frames and no grid, as re-checks and touches do, compared with others."""

import pytest

from hilcell.journal.journal import Record, read_journal
from hilcell.journal.log import Log
from hilcell.journal.runs import JOURNAL
from hilcell.report.comparison import compare_runs
from tests.hilcell.report.test_comparison import altered, kind_of, of
from tests.whole.golden import GoldenRuns


@pytest.fixture(scope="module")
def whole(golden: GoldenRuns) -> list[Record]:
    return read_journal(golden["small"].folder / JOURNAL)


@pytest.fixture(scope="module")
def framed(whole: list[Record]) -> Log:
    """Return the log of a run without a grid."""
    return altered(whole, lambda each: None if kind_of(each) == "grid" else each)


@pytest.mark.parametrize("turned", [False, True])
def test_a_run_without_a_grid_beside_a_calibration(
    whole: list[Record], framed: Log, turned: bool
) -> None:
    found = compare_runs(framed, Log(whole)) if turned else compare_runs(Log(whole), framed)
    assert of(found, "grid") == []
    assert {each.place for each in of(found, "frames")} >= {"base", "station S1100"}
    assert "only one of the runs measured the grid: it is not compared" in found.notes


def test_two_runs_without_a_grid(framed: Log) -> None:
    assert of(compare_runs(framed, framed), "frames")
