"""Conclusions of a study: none out of noise, failures or the instrument; a buyer's question."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace
from scipy.stats import beta, binom

from hilcell.decoding import Json
from hilcell.study.analysis import answers, front_of
from hilcell.study.case import Row
from hilcell.study.design import Case
from hilcell.study.html import page
from hilcell.study.inference import Interval, OneMachine, Share, Within, holm, tolerance_limit
from hilcell.study.study_file import Study
from hilcell.study.tables import Summary
from tests.hilcell.study.null_studies import (
    THIRTY_TWO,
    THREE_LEVELS,
    Errors,
    alike,
    null_studies,
    scattered,
    together,
)
from tests.hilcell.study.studies import TWO_FACTORS, study
from tests.hilcell.study.test_analysis import ended, rows, shares
from tests.hilcell.study.test_study_file import factor, refused

FOUR = "machines = 4"
ASKED = "[question]\nlimit_mm = 0.1\nshare = 0.95\nconfidence = 0.95"
SWEEPS = factor(name="s", setting="sweeps.enabled", levels=[False, True])


def with_truth(found: list[Row], truth_mm: Callable[[Row], float]) -> list[Row]:
    return [replace(row, figures=row.figures | {"true_mean_mm": truth_mm(row)}) for row in found]


def said(summary: Summary) -> Json:
    facts: Json = msgspec.json.decode(msgspec.json.encode(summary.facts()))
    return facts


def step(asked: Study, found: list[Row], name: str) -> Json:
    return next(each for each in said(Summary(asked, found))["buy_next"] if each["factor"] == name)


# -- failures --------------------------------------------------------------------------------------


def failing_far(asked: Study) -> list[Row]:
    """Far from the reference is better by far, and fails on machine 4."""
    measured = rows(asked, lambda c: 0.1 - 0.05 * shares(c)[1] + 0.01 * c.machine)
    return [
        ended(row, "failed", "refused\nslide 1.5 mm off; put it right")
        if (row.machine, row.levels["place"]) == (4, "far")
        else row
        for row in measured
    ]


def test_a_design_that_fails_on_a_machine_beats_none(tmp_path: Path) -> None:
    asked = study(tmp_path, head=FOUR)
    summary = Summary(asked, failing_far(asked))
    assert {each.point.choices[1].word for each in summary.found.front} == {"near"}
    assert [each.whole for each in summary.found.designs] == [True, False, True, False]
    assert "Crosses" in page(summary)


def test_a_level_that_fails_is_no_gain(tmp_path: Path) -> None:
    """It is counted by level, with its reasons; the other factor's levels fail alike."""
    asked = study(tmp_path, head=FOUR)
    found = step(asked, failing_far(asked), "place")
    assert found["shown"] == "fails"
    assert found["failing"] == pytest.approx(0.25)
    assert found["ended"] == {
        "cases": 8, "failed": 2, "cannot_be": 0, "machines": 1, "all_machines": 4,
        "kinds": {"slide 1.5 mm off": 2},
    }  # fmt: skip
    assert step(asked, failing_far(asked), "readings")["shown"] == "no"
    sheet = Summary(asked, failing_far(asked)).purchases()
    assert [row[-1] for row in sheet.texts()] == [
        "1 of 8 → 1 of 8 (1 of 4 machines)",
        "0 of 8 → 2 of 8 (1 of 4 machines)",
    ]


def three_factors(folder: Path) -> Study:
    """Return a study of 27 designs on four machines."""
    return study(folder, THREE_LEVELS.rpartition("[[factor]]")[0], FOUR)


def fails_together(row: Row) -> bool:
    return (row.levels["a"], row.levels["b"], row.levels["c"]) == (9, 225.0, 8)


@pytest.mark.parametrize("machines", [4, 1])
def test_a_step_into_one_design_that_fails_is_no_gain(tmp_path: Path, machines: int) -> None:
    """One of 27 designs fails, on all machines or on one: 1 of 36 cases is enough."""
    asked = three_factors(tmp_path)
    found = [
        ended(row, "failed", "slide off")
        if fails_together(row) and row.machine <= machines
        else row
        for row in rows(asked, lambda c: 0.1 - 0.03 * shares(c)[0] + 1e-4 * c.machine)
    ]
    steps = said(Summary(asked, found))["buy_next"]
    shown = {(each["factor"], each["level"]): each["shown"] for each in steps}
    assert shown == {
        ("a", "5"): "gain", ("a", "9"): "fails", ("b", "300"): "no", ("b", "225"): "fails",
        ("c", "4"): "no", ("c", "8"): "fails",
    }  # fmt: skip


def test_a_gain_whose_own_cases_fail_more_is_no_gain(tmp_path: Path) -> None:
    """Failures are of b, of which a Sobol design has more beside one level of a than the other."""
    asked = study(tmp_path, THREE_LEVELS, THIRTY_TWO.format(4))
    found = rows(asked, lambda c: 0.1 - 0.03 * shares(c)[0] + 1e-4 * c.machine)
    (gain,) = (each for each in answers(asked, found).purchases if each.word == "5")
    assert gain.shown == "gain"
    worse = dataclasses.replace(gain, ended=replace(gain.ended, failed=2))
    assert worse.failing <= 0.0
    assert worse.shown == "fails"
    assert not worse.gains


def test_rounding_is_no_failure(tmp_path: Path) -> None:
    """Both levels fail alike: 0.12499999 and 0.125 are one share."""
    asked = study(tmp_path, head=FOUR)
    (readings,) = (e for e in answers(asked, failing_far(asked)).purchases if e.word == "5")
    assert not dataclasses.replace(readings, failing=1e-8).fails
    assert dataclasses.replace(readings, failing=1e-4).fails


def test_without_a_design_on_every_machine_there_is_no_front(tmp_path: Path) -> None:
    asked = study(tmp_path, head=FOUR)
    summary = Summary(asked, failing_far(asked)[:10])
    assert not summary.found.front
    assert "<svg" in page(summary)


def test_sets_of_targets_that_are_not_all_done(tmp_path: Path) -> None:
    asked = study(tmp_path, head="machines = 2\nseeds = 2")
    found = answers(asked, rows(asked, lambda c: 0.1 - 0.02 * shares(c)[0])[:14])
    assert [each.whole for each in found.designs] == [True, True, False, False]
    gain = next(each for each in found.purchases if each.factor.name == "readings")
    assert gain.change.mean == pytest.approx(-0.02)


# -- truth -----------------------------------------------------------------------------------------


def test_truth_decides_and_the_measurement_stands_beside_it(tmp_path: Path) -> None:
    """The far place only measures better; more readings are better, which nobody measures."""
    asked = study(tmp_path, head=FOUR)
    wobble = np.random.default_rng(1).normal(0.0, 1e-4, 16)
    found = with_truth(
        rows(asked, lambda c: 0.1 - 0.05 * shares(c)[1] + wobble[c.number - 1]),
        lambda row: 0.1 - 0.02 * (row.levels["readings"] == 5) + wobble[row.case - 1],
    )
    summary = Summary(asked, found)
    assert summary.found.by_truth
    shown = {each.factor.name: each.shown for each in summary.found.purchases}
    assert shown == {"readings": "gain", "place": "no"}
    whole = said(summary)
    assert whole["decided_by"] == "true_mean_mm"
    place = next(each for each in whole["buy_next"] if each["factor"] == "place")
    assert place["change_mm"]["mean"] == pytest.approx(-0.05, abs=1e-3)
    assert place["true_change_mm"]["mean"] == pytest.approx(0.0, abs=1e-3)
    best = min(whole["designs"], key=lambda each: each["true_mm"]["mean"])
    assert best["factors"]["readings"] == 5
    assert [each.point.number for each in summary.found.front] == [1, 3]
    certificates = summary.certificates()
    assert [row[1].split()[0] for row in certificates.texts()] == ["0.1000", "0.0800"]
    assert [row[2].split()[0] for row in certificates.texts()] == ["0.1000", "0.1000"]


def test_without_a_truth_in_every_row_the_measurement_decides(tmp_path: Path) -> None:
    asked = study(tmp_path, head=FOUR)
    plain = rows(asked, lambda c: 0.1)
    assert not answers(asked, [*with_truth(plain, lambda _: 0.1)[1:], plain[0]]).by_truth


def test_a_true_accuracy_has_one_column(tmp_path: Path) -> None:
    asked = study(tmp_path, head=f'{FOUR}\naccuracy = "true_mean_mm"')
    found = with_truth(rows(asked, lambda c: 0.2), lambda row: 0.1)
    headers = Summary(asked, found).front().headers
    assert [each for each in headers if "mean" in each] == ["true mean mm"]


# -- the buyer's question --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("machines", "within", "answer", "more"),
    [
        (4, 4, "not shown yet", 55),
        (58, 58, "not shown yet", 1),
        (59, 59, "yes", 0),
        (92, 91, "not shown yet", 1),
        (93, 92, "yes", 0),
        (20, 15, "no", None),
        (4, 2, "no", None),
        (0, 0, "not shown yet", 59),
    ],
)
def test_the_answer_is_exact(machines: int, within: int, answer: str, more: int | None) -> None:
    figures_mm = np.array([0.05] * within + [0.15] * (machines - within))
    found = Within.of(figures_mm, 0.1, 0.95, 0.95)
    assert (found.answer, found.more) == (answer, more)
    if 0 < within < machines:
        assert found.share_low == pytest.approx(beta.ppf(0.05, within, machines - within + 1))
        assert binom.sf(within - 1, machines, found.share_low) == pytest.approx(0.05)


def test_a_failed_machine_is_not_within(tmp_path: Path) -> None:
    asked = study(tmp_path, head=f"{FOUR}\n{ASKED.replace('0.1', '0.15')}")
    found = answers(asked, failing_far(asked))
    judged = [each.within for each in found.designs]
    assert [(each.within, each.machines) for each in judged if each] == [(4, 4), (3, 4)] * 2
    sheet = Summary(asked, failing_far(asked)).question()
    at = sheet.headers.index("answer")
    assert {(row[at], row[at + 1]) for row in sheet.texts()} == {("not shown yet", "55")}
    facts = said(Summary(asked, failing_far(asked)))["designs"][0]["question"]
    assert (facts["machines"], facts["within"], facts["more"]) == (4, 4, 55)
    assert "0.15 mm" in page(Summary(asked, failing_far(asked)))


def test_a_machine_is_judged_with_all_its_targets_only(tmp_path: Path) -> None:
    """Machine 59 has one set of targets only, machine 60 none: 58 machines are judged."""
    asked = study(tmp_path, head=f"machines = 60\nseeds = 2\n{ASKED}")
    found = [row for row in rows(asked, lambda c: 0.05) if (row.machine, row.seed) < (59, 2)]
    judged = [each.within for each in answers(asked, found).designs]
    assert {(each.machines, each.within, each.answer) for each in judged if each} == {
        (58, 58, "not shown yet")
    }
    sheet = Summary(asked, found).question()
    assert len(sheet.texts()) == 4
    assert "most machines within" in sheet.note


def test_without_a_whole_design_the_best_so_far_are_listed(tmp_path: Path) -> None:
    asked = study(tmp_path, head=f"{FOUR}\n{ASKED}")
    found = rows(asked, lambda c: 0.05 + 0.1 * (c.point.number == 1))[:12]
    sheet = Summary(asked, found).question()
    assert [row[0] for row in sheet.texts()] == ["2", "3", "4", "1"]
    assert "mean true error" not in sheet.title
    assert "mean error" in sheet.title


@pytest.mark.parametrize("key", ["limit_mm = 0.0", "share = 1.0", "confidence = 1.5"])
def test_a_question_without_an_answer_is_refused(tmp_path: Path, key: str) -> None:
    head = f"{FOUR}\n[question]\n{key}" + ("\nlimit_mm = 0.1" if "limit" not in key else "")
    assert refused(tmp_path, TWO_FACTORS, head) == [f"question.{key.partition(' ')[0]}"]


@pytest.mark.parametrize("share", [0.9, 0.95, 0.99])
@pytest.mark.parametrize("machines", [10, 60, 300])
def test_the_share_is_covered_as_often_as_it_promises(share: float, machines: int) -> None:
    """Exactly, over all counts: the lower limit exceeds the truth in at most 5 %."""
    ends = [np.arange(machines, dtype=float) - k + 0.5 for k in range(machines + 1)]
    given = [Within.of(each, 0.0, share, 0.95) for each in ends]
    assert [each.within for each in given] == [*range(machines + 1)]
    counts = binom.pmf(np.arange(machines + 1), machines, share)
    assert counts[[each.share_low > share for each in given]].sum() <= 0.05
    assert counts[[each.answer == "no" for each in given]].sum() <= 0.05


@pytest.mark.parametrize("machines", [4, 10])
def test_one_machine_more_lies_where_it_is_said(machines: int) -> None:
    """The interval of the mean covers it in half of all lots; 95 % of one machine's do."""
    drawn = np.random.default_rng(1).normal(0.1, 0.01, (4000, machines + 1))
    mean = [Interval.of(row[:-1]).ends for row in drawn]
    one = [OneMachine.of(row[:-1]) for row in drawn]
    assert np.mean([a <= x <= b for (a, b), x in zip(mean, drawn[:, -1], strict=True)]) < 0.8
    inside = [each.low <= x <= each.high for each, x in zip(one, drawn[:, -1], strict=True)]
    assert np.mean(inside) == pytest.approx(0.95, abs=0.012)
    limits = [tolerance_limit(row[:-1], 0.95, 0.9) for row in drawn]
    assert np.mean([each >= 0.1 + 1.645 * 0.01 for each in limits]) == pytest.approx(0.9, abs=0.016)


# -- no gain out of noise --------------------------------------------------------------------------


@pytest.mark.parametrize("errors", [scattered, alike, together])
def test_steps_that_do_nothing_are_rarely_shown(tmp_path: Path, errors: Errors) -> None:
    """Steps of a, b and c do nothing: in at most 5 % of studies is any shown, by Holm."""
    asked, studies = study(tmp_path, THREE_LEVELS, THIRTY_TWO.format(8)), 30
    wrong = sum(
        any(step.shown in {"gain", "loss"} for step in found.purchases if step.factor.name != "d")
        for found in (answers(asked, own) for own in null_studies(asked, errors, range(studies)))
    )
    assert wrong <= binom.ppf(0.999, studies, 0.05)


def test_a_step_that_does_something_is_shown(tmp_path: Path) -> None:
    asked = study(tmp_path, THREE_LEVELS, THIRTY_TWO.format(4))
    random = np.random.default_rng(3)
    found = answers(
        asked, rows(asked, lambda c: 0.1 - 0.02 * (shares(c)[1] == 1.0) + random.normal(0.0, 0.002))
    )
    assert {(each.factor.name, each.word): each.shown for each in found.purchases} == {
        (name, word): "gain" if (name, word) == ("b", "300") else "no"
        for name, words in {"a": "59", "b": ("300", "225"), "c": "48", "d": ("12", "16")}.items()
        for word in words
    }


def test_points_that_leave_nothing_to_check_by_show_nothing(tmp_path: Path) -> None:
    """Three of four combinations: whether effects add up shows at none of them."""
    asked = study(tmp_path, head=FOUR)
    measured = rows(asked, lambda c: 0.1 - 0.02 * shares(c)[0] + 1e-5 * c.number)
    found = answers(asked, [
        row if row.point < 4 else ended(row, "cannot be", "out of reach") for row in measured
    ])  # fmt: skip
    assert [each.shown for each in found.purchases] == ["no", "no"]
    assert found.purchases[0].change.text(-1.0) == "0.0200 ± –"


def test_a_share_is_rounded_one_way() -> None:
    assert {Share.of([each], 16.0).text() for each in (0.9375, 0.9375 - 1e-15)} == {"93.8"}


def test_holm_is_holm_s() -> None:
    """Sorted 0.01, 0.02, 0.03, times 3, 2, 1, never less than one before; NaN is no test."""
    found = holm(np.array([0.03, 0.01, np.nan, 0.02]))
    assert found.tolist() == pytest.approx([0.04, 0.03, 1.0, 0.04])


def test_an_interaction_is_shown_with_its_gains(tmp_path: Path) -> None:
    """A gain of 0.0164 with sweeps and of 0.0055 without; main effects explain nearly all."""
    asked = study(tmp_path, TWO_FACTORS + SWEEPS, "machines = 6")
    random = np.random.default_rng(1)

    def error_mm(case: Case) -> float:
        readings, _, sweeps = shares(case)
        gain_mm = 0.0055 + 0.0109 * sweeps
        return 0.3 - 0.2 * sweeps - gain_mm * readings + random.normal(0.0, 5e-4)

    summary = Summary(asked, rows(asked, error_mm))
    (clear,) = (each for each in summary.found.interactions if each.known)
    assert (clear.factor.name, clear.other.name) == ("readings", "s")
    assert clear.at_first.mean == pytest.approx(-0.0055, abs=1e-3)
    assert clear.at_second.mean == pytest.approx(-0.0164, abs=1e-3)
    assert summary.found.share > 0.99
    assert summary.found.apart_mm == pytest.approx(0.0109 / 4.0, abs=1e-3)
    assert step(asked, list(summary.rows), "readings")["depends_on"] == ["s"]
    assert summary.interactions().texts()[0][-1] == "yes"


def test_equals_of_the_front_are_marked(tmp_path: Path) -> None:
    """Readings gain for sure; the far place, slower, by luck alone."""
    asked = study(tmp_path, head=FOUR)
    luck = np.random.default_rng(5).normal(0.0, 0.004, (4, 4))
    clear = np.array([0.2, 0.2, 0.1, 0.1])
    errors_mm = clear[:, None] + luck + np.array([0.0, -0.003, 0.0, -0.003])[:, None]
    found = answers(asked, rows(asked, lambda c: errors_mm[c.point.number - 1, c.machine - 1]))
    marks = {each.point.number: each.equal_to for each in found.front}
    assert (marks[1], marks[3]) == (None, None)
    assert all(marks.get(number) in {1, 3} for number in (2, 4) if number in marks)
    assert marks.keys() & {2, 4}


def test_one_machine_marks_no_equals(tmp_path: Path) -> None:
    asked = study(tmp_path, head="machines = 1")
    summary = Summary(asked, rows(asked, lambda c: 0.1 - 0.01 * c.point.number))
    assert [each.equal_to for each in summary.found.front] == [None] * 4
    assert "no better than" not in summary.front().headers


@pytest.mark.parametrize("seed", range(4))
def test_the_front_is_that_of_every_pair(seed: int) -> None:
    places = np.random.default_rng(seed).integers(0, 6, (60, 3)).astype(float)
    beaten = [
        any((other <= own).all() and (other < own).any() for other in places) for own in places
    ]
    assert sorted(front_of(places)) == [n for n, each in enumerate(beaten) if not each]


def test_labels_of_points_hide_no_other_dot(tmp_path: Path) -> None:
    """Dots of designs that are beaten lie at the upper right of those of the front."""
    readings = factor(name="r", setting="layout.nest_samples", levels=[*range(1, 49)])
    above_mm = (0.03, 0.0, 0.0045, 0.03)
    found = Summary(
        (asked := study(tmp_path, readings, FOUR)),
        rows(asked, lambda c: 0.1 - 0.0005 * c.point.number + above_mm[c.point.number % 4]),
    )
    assert len(found.found.front) == 12
    svg = page(found).split("<svg")[1]
    label = r'<text style="font-weight: 700[^"]*" x="([\d.]+)" y="([\d.]+)"[^>]*>([\d, ]+)<'
    labels = [(float(x), float(y), words) for x, y, words in re.findall(label, svg)]
    dots = re.findall(r'<use [^>]*x="([\d.]+)" y="([\d.]+)" style="fill: #ffffff', svg)
    assert (len(labels), len(dots)) == (12, 36)
    for x, y, words in labels:
        for across, down in dots:
            inside = x <= float(across) <= x + 4.0 * len(words) and y - 6.0 <= float(down) <= y
            assert not inside


def test_labels_of_points_do_not_overprint(tmp_path: Path) -> None:
    """Many designs at one price: each number is there once, and no two labels touch."""
    readings = factor(name="r", setting="layout.nest_samples", levels=[*range(1, 13)])
    asked = study(tmp_path, readings + "\ncosts = [0,0,0,0,0,0,9,9,9,9,9,9]\n", FOUR)
    found = Summary(asked, rows(asked, lambda c: 0.1 - 0.002 * c.point.number))
    assert len(found.found.front) == 12
    svg = page(found).split("<svg")[1]
    label = r'<text style="font-weight: 700[^"]*" x="([\d.]+)" y="([\d.]+)"[^>]*>([\d, ]+)<'
    labels = re.findall(label, svg)
    numbers = [number for *_, words in labels for number in words.split(", ")]
    assert sorted(numbers) == sorted([*map(str, range(1, 13))] * 2)  # minutes, and money
    places = [(float(x), float(y), 4.0 * len(words)) for x, y, words in labels]
    for n, (x, y, width) in enumerate(places):
        for x2, y2, width2 in places[n + 1 :]:
            assert x + width <= x2 or x2 + width2 <= x or abs(y - y2) >= 6.0
