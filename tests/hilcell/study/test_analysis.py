"""Answers of a study: known effects are found, and intervals are those of machines."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace
from scipy.stats import t as student

from hilcell.decoding import Json, typed
from hilcell.ports import Array
from hilcell.study.additive import Additive
from hilcell.study.analysis import Answers, answers, front_of
from hilcell.study.case import CaseResult, Row
from hilcell.study.design import Case, Point, cases, choices_at, points
from hilcell.study.html import page
from hilcell.study.inference import Interval, Share
from hilcell.study.results import case_row
from hilcell.study.study_file import Study
from hilcell.study.tables import Summary
from tests.hilcell.study.studies import TWO_FACTORS, study
from tests.hilcell.study.test_design import RANGES, SOBOL
from tests.hilcell.study.test_study_file import factor

FOUR = "machines = 4"


def rows(asked: Study, error_mm: Callable[[Case], float]) -> list[Row]:
    """Return rows of a study whose errors are known."""
    return [
        case_row(
            case,
            CaseResult(
                "done",
                "",
                20.0 + case.point.number,
                {"mean_mm": error_mm(case), "covered": 0.95, "targets": 100.0},
            ),
            asked,
        )
        for case in cases(asked)
    ]


def ended(row: Row, state: str, reason: str) -> Row:
    none = dict.fromkeys(row.figures)
    return replace(row, state=state, reason=reason, minutes=None, figures=none)


def shares(case: Case) -> tuple[float, ...]:
    return tuple(each.share for each in case.point.choices)


def additive(case: Case) -> float:
    """A machine's own level, 0.03 less with more readings, a little more at the far place."""
    readings, place = shares(case)
    return 0.1 + 0.01 * case.machine - 0.03 * readings + 0.002 * place


def test_effects_that_add_up_are_found_exactly(tmp_path: Path) -> None:
    asked = study(tmp_path, head=FOUR)
    found = answers(asked, rows(asked, additive))
    changes = {(each.factor.name, each.word): each.change.mean for each in found.effects}
    assert changes == {
        ("readings", "2"): 0.0,
        ("readings", "5"): pytest.approx(-0.03),
        ("place", "near"): 0.0,
        ("place", "far"): pytest.approx(0.002),
    }
    assert found.share == pytest.approx(1.0)
    assert [each.change.half for each in found.effects] == pytest.approx([0.0] * 4, abs=1e-12)
    assert [each.change.known for each in found.effects] == [False, True, False, True]


def test_an_interval_is_that_of_the_mean_over_machines(tmp_path: Path) -> None:
    """Each machine gains something else: 0.01, 0.02, 0.03, 0.04."""
    asked = study(tmp_path, head=FOUR)
    found = answers(asked, rows(asked, lambda c: 0.1 - 0.01 * c.machine * shares(c)[0]))
    step = next(each for each in found.purchases if each.factor.name == "readings")
    gains = np.array([0.01, 0.02, 0.03, 0.04])
    assert step.change.mean == pytest.approx(-gains.mean())
    assert step.change.half == pytest.approx(student.ppf(0.975, 3) * gains.std(ddof=1) / 2.0)
    assert step.cost == 100.0


def test_intervals_cover_as_often_as_they_promise() -> None:
    drawn = np.random.default_rng(1).normal(3.0, 1.0, (2000, 5))
    found = [Interval.of(row) for row in drawn]
    covered = np.mean([abs(each.mean - 3.0) <= each.half for each in found])
    assert covered == pytest.approx(0.95, abs=0.015)


def test_one_machine_gives_no_interval(tmp_path: Path) -> None:
    asked = study(tmp_path, head="machines = 1")
    summary = Summary(asked, rows(asked, additive))
    assert all(math.isnan(each.change.half) for each in summary.found.effects)
    sheet = summary.purchases()
    assert [row[4] for row in sheet.texts()] == ["no", "no"]
    said: Json = msgspec.json.decode(msgspec.json.encode(summary.facts()))
    assert said["effects"][0]["accuracy_mm"]["half95"] is None
    assert "<svg" in page(summary)


def test_the_page_draws_the_front_and_each_level(tmp_path: Path) -> None:
    asked = study(tmp_path, head=FOUR)
    summary = Summary(asked, rows(asked, additive))
    text = page(summary)
    assert page(summary) == text
    _, front, effects, covered = text.split("<svg")
    words = {plot: re.findall(r"<text[^>]*>([^<]*)</text>", plot) for plot in (front, effects)}
    assert {str(each.point.number) for each in summary.found.front} <= {*words[front]}
    for each in summary.found.effects:
        assert {each.factor.title, each.word, each.mean.text()} <= {*words[effects]}
        assert each.covered.text() in covered


@pytest.mark.filterwarnings("error")
def test_the_page_draws_words_of_any_script_and_no_control(tmp_path: Path) -> None:
    factors = TWO_FACTORS.replace('"near"', r'"\u001b[31mnear"').replace('"far"', '"远"')
    asked = study(tmp_path, factors, head=FOUR)
    text = page(Summary(asked, rows(asked, additive)))
    assert "\x1b" not in text
    assert ">远<" in text


def test_ranges_of_a_sobol_design(tmp_path: Path) -> None:
    """The effect of a range is that from its low to its high end."""
    asked = study(tmp_path, RANGES, SOBOL)
    found = answers(asked, rows(asked, lambda c: 0.2 - 0.05 * shares(c)[0] + 0.01 * shares(c)[2]))
    changes = {each.factor.name: each.change.mean for each in found.purchases}
    assert changes == pytest.approx({"readings": -0.05, "x": 0.0, "sweeps": 0.01})


def test_the_shown_gain_comes_first(tmp_path: Path) -> None:
    asked = study(tmp_path, head=FOUR)

    def swinging(case: Case) -> float:
        """The far place gains more on average, on some machines only."""
        readings, place = shares(case)
        gain_mm = 0.15 if case.machine % 2 == 0 else -0.05
        return 0.3 - 0.01 * readings - gain_mm * place

    summary = Summary(asked, rows(asked, swinging))
    assert [each.factor.name for each in summary.found.purchases] == ["readings", "place"]
    sheet = summary.purchases()
    assert [(row[0], row[4]) for row in sheet.texts()] == [("readings", "gain"), ("place", "no")]


def test_cases_that_cannot_be_are_no_zeros(tmp_path: Path) -> None:
    asked = study(tmp_path, head=FOUR)
    measured = rows(asked, additive)
    reason = "refused\ngrid: out of reach: pose 1 by 3 mm"
    measured = [
        ended(row, "cannot be", reason) if row.levels["place"] == "far" else row for row in measured
    ]
    summary = Summary(asked, measured)
    known = {each.word: math.isfinite(each.mean.mean) for each in summary.found.effects}
    assert known == {"2": True, "5": True, "near": True, "far": False}
    assert summary.counts() == "16 cases: 8 done, 8 cannot be"
    reasons = summary.tables()["reasons"]
    assert reasons.texts() == [["cannot be", "grid: out of reach", "8", "4"]]


@pytest.mark.parametrize(
    ("place", "best"),
    [
        ((1.0, 5.0, 0.0), True),
        ((2.0, 4.0, 0.0), True),
        ((2.0, 5.0, 0.0), False),  # beaten by both
        ((2.0, 5.0, -1.0), True),  # but cheaper
    ],
)
def test_the_front(place: tuple[float, ...], best: bool) -> None:
    others = [(1.0, 5.0, 0.0), (2.0, 4.0, 0.0)]
    assert (0 in front_of(np.array([place, *others]))) is best


def test_the_front_in_the_table(tmp_path: Path) -> None:
    """Minutes grow with the number of the point: a point is on it only where it is better."""
    asked = study(tmp_path, head=FOUR)
    errors_mm = (0.1, 0.09, 0.2, 0.05)
    sheet = Summary(asked, rows(asked, lambda c: errors_mm[c.point.number - 1])).front()
    assert [row[0] for row in sheet.texts()] == ["1", "2", "4"]
    assert "EUR" in sheet.headers


def test_a_machine_without_a_level_does_not_spoil_the_others(tmp_path: Path) -> None:
    """Machine 4 did no case at the far place: its effect of readings counts, undistorted."""
    asked = study(tmp_path, head=FOUR)
    measured = rows(asked, additive)
    measured = [
        ended(row, "failed", "the beam broke")
        if (row.machine, row.levels["place"]) == (4, "far")
        else row
        for row in measured
    ]
    found = {(each.factor.name, each.word): each for each in answers(asked, measured).effects}
    assert found["readings", "5"].change.mean == pytest.approx(-0.03)
    assert found["readings", "5"].change.half == pytest.approx(0.0, abs=1e-12)
    assert found["place", "far"].change.mean == pytest.approx(0.002)
    near_mm = [0.1 + 0.01 * machine - 0.015 for machine in (1, 2, 3, 4)]
    assert found["place", "near"].mean.mean == pytest.approx(np.mean(near_mm))
    assert found["readings", "2"].mean.mean == pytest.approx(0.1 + 0.025 + 0.001 * 3 / 4)


def test_reasons_that_differ_in_figures_are_one_kind(tmp_path: Path) -> None:
    asked = study(tmp_path, head=FOUR)
    measured = [
        ended(row, "failed", f"slide {-n / 2:+.2f} mm off; put it right")
        for n, row in enumerate(rows(asked, additive), start=-3)
    ]
    tables = Summary(asked, measured).tables()
    (reasons,) = filter(None, tables.values())
    assert reasons.texts() == [["failed", "slide +1.50 mm off", "16", "4"]]


@pytest.mark.parametrize("shares", [[1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 0.98, 1.0], [0.0, 0.0, 0.02]])
def test_an_interval_is_between_none_and_all(shares: list[float]) -> None:
    found = Share.of(shares, 50.0 * len(shares))
    assert 0.0 <= found.low <= found.mean <= found.high <= 1.0
    assert found.low < found.high


def test_it_is_clopper_and_pearson_s_where_machines_do_not_differ() -> None:
    """98 of 100; of many machines, so that Student's factor is nearly the normal one."""
    many = [0.98] * 400
    found = Share.of(many, 100.0)
    assert (found.low, found.high) == pytest.approx((0.9296, 0.9976), abs=0.001)


@pytest.mark.parametrize("spread", [0.0, 0.04])
def test_it_covers_as_often_as_it_promises(spread: float) -> None:
    """Machines of 50 targets each, whose own shares differ: 0.93 on average."""
    rng, true = np.random.default_rng(1), 0.93
    hits = []
    for _ in range(600):
        own = np.clip(rng.uniform(true - spread, true + spread, 6), 0.0, 1.0)
        found = Share.of(rng.binomial(50, own) / 50.0, 300.0)
        hits.append(found.low <= true <= found.high)
    assert 0.93 <= np.mean(hits) <= 1.0


def test_one_machine_gives_none() -> None:
    found = Share.of([0.95], 100.0)
    assert found.mean == 0.95
    assert math.isnan(found.low)
    assert found.ends == (0.95, 0.95)


def test_machines_that_differ_widen_it() -> None:
    alike, different = Share.of([0.9] * 4, 400.0), Share.of([0.8, 1.0, 0.8, 1.0], 400.0)
    assert alike.mean == pytest.approx(different.mean)
    assert different.high - different.low > 1.5 * (alike.high - alike.low)


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
