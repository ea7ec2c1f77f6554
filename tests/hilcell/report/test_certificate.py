"""Items of the certificate that must not contradict verdict and standing."""

from pathlib import Path
from typing import Any

import pytest

from hilcell.journal.calibration_facts import REVOKED
from hilcell.report.certificate import certificate
from hilcell.report.facts import Facts
from hilcell.report.html import measured, sentence, standing
from hilcell.report.target_budget import TargetBudget
from tests.hilcell.report.journals import validated_run

FIGURES = {"holds": True, "mean_mm": 0.03, "mean_tolerance_mm": 0.12, "max_mm": 0.1}


def words_of(facts: Facts, name: str) -> str:
    items = certificate(facts, None, TargetBudget("none"))
    return next(each.words for each in items if each.name == name)


@pytest.mark.parametrize(
    ("more", "rule"),
    [
        ({"mean_U_mm": 0.04}, "guard band: accepted where the figure plus its expanded"),
        ({}, "simple acceptance"),  # of an earlier version
    ],
)
def test_the_rule_is_the_one_that_judged(tmp_path: Path, more: dict[str, Any], rule: str) -> None:
    writer = validated_run(tmp_path / "run")
    writer.journal.append("verdict", "validation.S1100", FIGURES | more)
    assert rule in words_of(writer.facts(), "Conformity, decision rule")


def test_a_revoked_calibration_says_so_and_ended_when_it_did(tmp_path: Path) -> None:
    writer = validated_run(tmp_path / "run")
    writer.journal.append("event", "", {"what": REVOKED, "reason": "wrong reflector"})
    facts = writer.facts()
    assert facts.revoked == "wrong reflector"
    assert facts.last.kind == "end"
    assert standing(facts) == ("bad", "its calibration is revoked: wrong reflector")
    assert sentence(facts).startswith("The calibration of this run was revoked")
    assert measured(facts)
    assert words_of(facts, "Validity").startswith("REVOKED: wrong reflector; the results")
