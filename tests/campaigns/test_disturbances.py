"""The campaign of disturbances can fail: made-up runs, of which it says what it should."""

from __future__ import annotations

import math
from typing import Any

import pytest

from campaigns.disturbances import KINDS, Calibrated, Case, Disturbance, drawn, report

SUSPECTED = [{"cause": "strip", "size": 1.0, "unit": "mm", "noticed_by": "re-visits"}]


def run(
    mean_mm: float, *, true_mm: float = 0.1, code: int = 0, suspicions: list[Any] | None = None
) -> Calibrated:
    validation = {"S1100": {"chosen": {"mean": mean_mm}}}
    result = {"validation": validation, "suspicions": suspicions or []}
    return Calibrated({"exit": code, "result": result}, ["world/F1"], [], {"S1100": true_mm})


def case(disturbed: Calibrated, undisturbed: Calibrated | None = None) -> Case:
    disturbance = Disturbance(KINDS[0], 1.0, 0.5)
    return Case(1, disturbance, undisturbed or run(0.1), disturbed, "world/F1")


@pytest.mark.parametrize(
    ("disturbed", "matters", "holds"),
    [
        (run(0.12), False, True),
        (run(0.2), True, False),
        (run(0.1, true_mm=0.2), True, False),  # the run's own figures look right
        (run(0.1, true_mm=math.nan), True, False),
        (run(0.2, code=1), True, True),
        (run(0.2, suspicions=SUSPECTED), True, True),
        (Calibrated({"exit": 3}, [], [], {}), True, True),
        (Calibrated({"exit": 0, "result": {}}, [], [], {}), True, False),
    ],
)
def test_a_mean_that_moves_unnoticed_fails(
    disturbed: Calibrated, matters: bool, holds: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    found = case(disturbed)
    assert found.matters == matters
    assert report([found]) == holds
    assert ("SILENT" in capsys.readouterr().out) == (not holds)


def test_a_false_alarm_fails(capsys: pytest.CaptureFixture[str]) -> None:
    alarmed = run(0.1, suspicions=SUSPECTED)
    assert not report([case(run(0.1), alarmed)])
    assert "FALSE  seed 1: exit 0 ['strip 1 mm']" in capsys.readouterr().out


def test_a_broken_invariant_fails() -> None:
    broken = Calibrated({"exit": 0}, [], ["I4: a point without a frame"], {})
    assert not report([case(broken, Calibrated({"exit": 0}, [], [], {}))])


def test_a_seed_is_a_case() -> None:
    assert drawn(7) == drawn(7)
    assert drawn(7).moment != drawn(8).moment
    assert {drawn(seed).kind.name for seed in range(len(KINDS))} == {kind.name for kind in KINDS}
