"""Answers of a study: known effects are found, and intervals are those of machines."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace
from scipy.stats import t as student

from hilcell.decoding import Json
from hilcell.study.analysis import Interval, Share, answers, on_front
from hilcell.study.case import CaseResult, Row
from hilcell.study.design import Case, cases
from hilcell.study.html import page
from hilcell.study.results import case_row
from hilcell.study.study_file import Study
from hilcell.study.tables import Summary, percent, with_half
from tests.hilcell.study.studies import TWO_FACTORS, study
from tests.hilcell.study.test_design import RANGES, SOBOL

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
    """Return a row of a case that has no result."""
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
        assert {each.factor.title, each.word, with_half(each.mean)} <= {*words[effects]}
        assert percent(each.covered) in covered


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
    assert reasons.texts() == [["cannot be", "grid: out of reach", "8"]]


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
    assert on_front(np.array(place), np.array([place, *others])) is best


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
    assert reasons.texts() == [["failed", "slide +1.50 mm off", "16"]]


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
