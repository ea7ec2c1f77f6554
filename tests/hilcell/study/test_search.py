"""The optimiser finds what is best, within its trials, and goes on where it was stopped."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from hilcell.cell.file import Cell
from hilcell.study.analysis import answers
from hilcell.study.case import CaseResult
from hilcell.study.cluster import ClusterError
from hilcell.study.design import Case, cases
from hilcell.study.html import page
from hilcell.study.results import Results, open_results
from hilcell.study.study_file import Study
from hilcell.study.tables import Summary
from tests.hilcell.study.studies import Bench, performed, study
from tests.hilcell.study.test_design import RANGES
from tests.hilcell.study.test_study_file import factor, refused

FACTORS = RANGES.replace("costs = [0, 700]\n", "").replace("minutes = [0, 30]\n", "")
HEAD = 'design = "optimise"\nmachines = 2\noptimise = { trials = 60, mm_per_minute = 0.001 }'
LIMITED = HEAD.replace("mm_per_minute = 0.001", "most_minutes = 25.0")


def truth(case: Case, cell: Cell) -> CaseResult:
    """Best at 1870 mm with sweeps; readings cost minutes."""
    readings, x_mm = cell.layout.nest_samples, cell.grid.centre.x_mm
    error_mm = 0.1 + ((x_mm - 1870.0) / 100.0) ** 2 + 0.04 / readings + 0.01 * case.machine
    error_mm -= 0.05 * cell.sweeps.enabled
    minutes = 10.0 + 4.0 * readings
    figures = {"mean_mm": error_mm, "covered": 0.95, "targets": 50.0}
    return CaseResult("done", "", minutes, figures)


def best(asked: Study, results: Results) -> dict[str, object]:
    found = answers(asked, results.rows()).best
    assert found is not None
    return {each.factor.name: each.value for each in found.point.choices}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Results:
    folder = tmp_path_factory.mktemp("search")
    results = Results(folder / "r", study(folder, FACTORS, HEAD))
    performed(results, Bench(truth))
    return results


def test_it_finds_the_best_within_its_trials(whole: Results) -> None:
    """0.04 mm / readings against 0.004 mm each: three readings are best, two nearly."""
    numbers = whole.table()["case"].to_pylist()
    assert len(numbers) == len(set(numbers)) <= 60 * 2
    found = best(whole.study, whole)
    assert found["sweeps"] is True
    assert found["readings"] in (2, 3, 4)
    assert found["x"] == pytest.approx(1870.0, abs=6.0)


def test_a_limit_on_minutes_is_kept(tmp_path: Path) -> None:
    """Three readings take 22 minutes, four take 26."""
    asked = study(tmp_path, FACTORS, LIMITED)
    results = Results(tmp_path / "r", asked)
    performed(results, Bench(truth))
    assert best(asked, results)["readings"] == 3
    assert Summary(asked, results.rows()).counts().endswith(" done")


def test_no_design_within_the_limit(tmp_path: Path) -> None:
    asked = study(tmp_path, FACTORS, LIMITED.replace("25.0", "5.0"))
    results = Results(tmp_path / "r", asked)
    performed(results, Bench(truth))
    summary = Summary(asked, results.rows())
    assert summary.found.best is None
    assert [each.title for each in summary.tables().values() if each] == ["Pareto front"]
    words = summary.counts()
    assert "5 minutes" in words
    assert words.endswith(" 18")
    assert words.partition("; ")[2] in page(summary)


def test_a_limit_that_none_of_the_first_points_keeps(tmp_path: Path) -> None:
    """All of them are too long, which is no agreement: the search goes on to shorter ones."""

    def slow(case: Case, cell: Cell) -> CaseResult:
        minutes = 10.0 + abs(cell.grid.centre.x_mm - 1859.3)
        return replace(truth(case, cell), minutes=minutes)

    asked = study(tmp_path, FACTORS, LIMITED.replace("25.0", "12.0"))
    results = Results(tmp_path / "r", asked)
    performed(results, Bench(slow))
    first = [row.figure("minutes") for row in results.rows()[: 2 * 12]]
    assert min(first) > 12.0
    assert best(asked, results)["x"] == pytest.approx(1859.3, abs=2.0)


def test_the_cases_that_are_listed_are_those_that_it_begins_with(tmp_path: Path) -> None:
    """Sobol points fall on the same few levels more than once; each is one point."""
    few = factor(levels=[2, 5]) + factor(name="g", setting="sweeps.enabled", levels=[True, False])
    asked = study(tmp_path, few, HEAD)
    listed = list(cases(asked))
    assert len(listed) == 4 * 2
    results = Results(tmp_path / "r", asked)
    performed(results, Bench(truth))
    rows = results.rows()
    wanted = [(case.number, *(each.shown for each in case.point.choices)) for case in listed]
    assert [(row.case, row.levels["f"], row.levels["g"]) for row in rows] == wanted


def test_all_points_have_the_same_machines(whole: Results) -> None:
    by_point: dict[int, list[int]] = {}
    for row in whole.rows():
        by_point.setdefault(row.point, []).append(row.machine)
    assert all(machines == [1, 2] for machines in by_point.values())
    assert list(by_point) == list(range(1, len(by_point) + 1))


def test_the_order_of_answers_does_not_matter(tmp_path: Path, whole: Results) -> None:
    other = Results(tmp_path / "other", study(tmp_path, FACTORS, HEAD))
    performed(other, Bench(truth, backwards=True))
    assert whole.table() == other.table()


def test_it_goes_on_where_it_was_stopped(tmp_path: Path, whole: Results) -> None:
    asked = study(tmp_path, FACTORS, HEAD)
    results = Results(tmp_path / "r", asked)
    with pytest.raises(ClusterError):
        performed(results, Bench(truth, most=41))
    rest = Bench(truth)
    performed(Results(tmp_path / "r", asked), rest)
    assert results.table() == whole.table()
    assert len(rest.measured) == whole.table().num_rows - 41
    assert open_results(tmp_path / "r").study == asked
    assert performed(results, again := Bench(truth)) == {}
    assert again.measured == []


def test_a_point_that_cannot_be_is_not_the_best(tmp_path: Path) -> None:
    def picky(case: Case, cell: Cell) -> CaseResult:
        good = cell.grid.centre.x_mm < 1850.0 or case.machine == 1
        return truth(case, cell) if good else CaseResult("failed", "the beam broke")

    asked = study(tmp_path, FACTORS, HEAD)
    results = Results(tmp_path / "r", asked)
    counts = performed(results, Bench(picky))
    assert counts["failed"] > 0
    assert best(asked, results)["x"] == pytest.approx(1850.0, abs=4.0)


@pytest.mark.parametrize(
    ("head", "key"),
    [
        ('design = "optimise"', "optimise"),
        ("optimise = { trials = 9, mm_per_minute = 1 }", "optimise"),
        ('design = "optimise"\noptimise = { trials = 9 }', "optimise"),
        ('design = "optimise"\noptimise = { trials = 2, most_minutes = 9 }', "optimise.trials"),
        ('design = "optimise"\noptimise = { trails = 9 }', "optimise.trails"),
    ],
)
def test_an_optimiser_without_an_aim(tmp_path: Path, head: str, key: str) -> None:
    assert key in refused(tmp_path, factor(levels=[2, 5]), head)
