"""Items of the certificate that must not contradict verdict and standing."""

from pathlib import Path

from hilcell.journal.calibration_facts import REVOKED
from hilcell.report.certificate import certificate
from hilcell.report.facts import Facts
from hilcell.report.html import measured, sentence, standing
from hilcell.report.target_budget import TargetBudget
from tests.hilcell.report.journals import validated_run


def words_of(facts: Facts, name: str) -> str:
    items = certificate(facts, None, TargetBudget("none"))
    return next(each.words for each in items if each.name == name)


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
