"""Estimable effects have figures; others have none, and a line says why."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
import numpy as np
import pytest

from hilcell.decoding import Json, typed
from hilcell.ports import Array
from hilcell.study.analysis import Additive, Answers, answers
from hilcell.study.case import Row
from hilcell.study.design import Case, Point, choices_at, points
from hilcell.study.html import page
from hilcell.study.study_file import Study
from hilcell.study.tables import Summary
from tests.hilcell.study.studies import study
from tests.hilcell.study.test_analysis import FOUR, ended, rows, shares
from tests.hilcell.study.test_study_file import factor

READINGS = factor(name="readings", setting="layout.nest_samples", levels=[2, 5, 9])
PITCH = factor(name="pitch", setting="grid.pitch_mm", levels=[450.0, 300.0, 225.0])
RANGE = factor(name="x", setting="grid.centre.x_mm", low=1800.0, high=1900.0)
SPAN = factor(name="r", setting="tracker.find_radius_mm", low=5.0, high=6.0)
EIGHT = 'design = "sobol"\nsamples = 8\nmachines = 4'


def judged(
    asked: Study, error_mm: Callable[[Case], float], works: Callable[[Row], bool]
) -> tuple[Answers, list[Row]]:
    measured = [
        row if works(row) else ended(row, "cannot be", "grid: out of reach")
        for row in rows(asked, error_mm)
    ]
    return answers(asked, measured), measured


def changes_of(found: Answers) -> dict[tuple[str, str], float]:
    return {(each.factor.name, each.word): each.change.mean for each in found.purchases}


def errors(case: Case) -> float:
    """A machine's own, and effects that add up: each factor's share by its number."""
    effects = sum(0.01 * n * share for n, share in enumerate(shares(case), start=1))
    return 0.1 + 0.01 * case.machine + effects


def test_a_range_of_which_one_end_gave_no_result(tmp_path: Path) -> None:
    """No effect of it; the other factor's is what it is, and so are the errors at its levels."""
    asked = study(tmp_path, RANGE + READINGS, FOUR)
    found, measured = judged(asked, errors, lambda row: typed(row.levels["x"], float) == 1900.0)
    summary = Summary(asked, measured)
    assert changes_of(found) == pytest.approx({("readings", "5"): 0.02, ("readings", "9"): 0.04})
    means = {each.word: each.mean.mean for each in found.effects}
    assert means["2"] == pytest.approx(0.1 + 0.025 + 0.01)
    assert means["1900"] == pytest.approx(0.1 + 0.025 + 0.01 + 0.02)
    assert math.isnan(means["1800"])
    assert len(found.not_estimable) == 2
    assert "1900" in found.not_estimable[0]
    said: Json = msgspec.json.decode(msgspec.json.encode(summary.facts()))
    none = {"mean": None, "half95": None}
    low, high = said["effects"][:2]
    assert (low["accuracy_mm"], low["change_mm"], low["minutes"]) == (none, none, None)
    assert low["covered"] == {"mean": None, "low95": None, "high95": None}
    assert (high["change_mm"], high["minutes"]) == (none, None)
    assert said["not_estimable"] == found.not_estimable
    sheet = summary.effects()
    assert sheet.texts()[0] == ["x mm", "1800", "–", "", "–", "–"]
    html = page(summary)
    for line in found.not_estimable:
        assert f'<p class="note">{line}</p>' in html
    assert not re.search(r"\bnan\b", html)


def test_a_first_level_without_a_result(tmp_path: Path) -> None:
    """Changes, minutes and money are counted from the first that has one."""
    costly = PITCH + "\ncosts = [10, 30, 70]\n"
    asked = study(tmp_path, costly + READINGS, FOUR)
    found, measured = judged(asked, errors, lambda row: row.levels["pitch"] != 450.0)
    assert changes_of(found)["pitch", "225"] == pytest.approx(0.01)
    step = next(each for each in found.purchases if each.word == "225")
    assert (step.start, step.cost) == ("300", 40.0)
    assert step.minutes == pytest.approx(3.0)
    said: Json = msgspec.json.decode(msgspec.json.encode(Summary(asked, measured).facts()))
    assert said["effects"][0]["from"] == "300"


def test_what_only_machines_together_would_tell(tmp_path: Path) -> None:
    asked = study(tmp_path, READINGS + PITCH, FOUR)
    found, _ = judged(asked, errors, lambda row: (row.levels["readings"] == 2) is (row.machine > 2))
    assert {each.factor.name for each in found.purchases} == {"pitch"}
    assert len(found.not_estimable) == 1


def test_a_range_beyond_its_results(tmp_path: Path) -> None:
    asked = study(tmp_path, RANGE + READINGS, EIGHT.replace("8", "16"))
    found, _ = judged(asked, errors, lambda row: typed(row.levels["x"], float) < 1860.0)
    assert changes_of(found)["x", "1900"] == pytest.approx(0.01)
    assert ["1856.25" in each for each in found.not_estimable] == [True]


def reduced(asked: Study, found: Sequence[Point]) -> Array:
    """Return the model's matrix written otherwise: dummies against the first level."""
    columns: list[Array] = [np.ones(len(found))]
    for n, each in enumerate(asked.factor):
        at = np.array([point.choices[n].share for point in found])
        columns += [at] if each.is_range else [at == m for m in range(1, len(each.ends))]
    return np.stack(columns, axis=1).astype(float)


@pytest.mark.parametrize("seed", range(0, 16, 2))
def test_what_is_told_is_told_by_the_rank_of_any_matrix(tmp_path: Path, seed: int) -> None:
    """A step is known where its row adds no rank; its figure is then the truth's."""
    random = np.random.default_rng(seed)
    asked = study(tmp_path, READINGS + PITCH + RANGE + SPAN, FOUR)
    all_points = points(asked)
    some = [all_points[n] for n in random.choice(len(all_points), 1 + seed % 8, replace=False)]
    model, A = Additive(asked.factor, some), reduced(asked, some)
    truth = random.normal(size=(A.shape[1],))
    figures = (A @ truth).reshape(-1, 1)
    at = 1
    for n, each in enumerate(asked.factor):
        for level in range(1, len(each.ends)):
            row = np.eye(A.shape[1])[at]
            known = np.linalg.matrix_rank(np.vstack([A, row])) == np.linalg.matrix_rank(A)
            contrast = model.change(n, level, 0)
            assert model.estimable(contrast) is bool(known)
            value = model.values(contrast, figures)[0]
            assert value == pytest.approx(float(truth[at])) if known else math.isnan(value)
            at += 1


def test_factors_in_two_pairs_are_two_groups(tmp_path: Path) -> None:
    """Readings go with pitch, x goes with r; the pairs themselves are crossed."""
    asked = study(tmp_path, READINGS + RANGE + PITCH + SPAN, FOUR)
    some = [
        Point(n, choices_at(asked, [a, 1800.0 + 100.0 * b, a, 5.0 + b]))
        for n, (a, b) in enumerate([(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1)], start=1)
    ]
    assert Additive(asked.factor, some).inseparable() == [[0, 2], [1, 3]]
