"""The table of verdicts: every figure with its unit, what it means and its limit."""

import ast
import re
from pathlib import Path
from typing import Any

import pytest

import procedures
from hilcell.report.facts import read_facts
from hilcell.report.verdicts import FIGURES, figures_words, verdicts
from tests.whole.golden import GoldenRuns

JUDGED = {
    "holds": True, "mean_mm": 0.0771, "mean_tolerance_mm": 0.3, "max_mm": 0.14975,
    "max_tolerance_mm": 1.0, "mean_U_mm": 0.0485, "max_U_mm": 0.0522, "outcome": "accepted",
    "decision": "in tolerance",
}  # fmt: skip


@pytest.mark.parametrize(
    ("key", "body", "figures"),
    [
        (
            "revisits",
            {"ratio": 9.2467, "limit": 3.0812, "suspected": ["the base moved by 0.3 mm"]},
            ["9.25", "3.08", "99.9 %", "the base moved by 0.3 mm"],
        ),
        (
            "reversal",
            {"mean_mm": 0.1235, "max_mm": 0.1557, "points": 4, "lost_urad": [40.2, 34.4, 36.7],
             "U_urad": [26.5, 57.0, 29.8], "limit_urad": 100.0},
            ["4 vertices", "0.123 mm", "0.156 mm", "A1 40 ± 26, A2 34 ± 57, A3 37 ± 30 µrad",
             "100 µrad"],
        ),
        (
            "sign",
            {"limit": 0.5, "before_mm": 1.2376, "corrected_mm": 0.1013, "ratio": 0.0818},
            ["1.238 mm", "0.101 mm", "8 %", "50 %"],
        ),
        ("validation.S300", JUDGED, ["0.0771 + U 0.0485 mm", "0.1497 + U 0.0522 mm"]),
        (
            "targets",
            JUDGED | {"outcome": "undecided", "decision": "too few targets"},
            ["0.0771 + U 0.0485 mm", "too few targets"],
        ),
        (
            "recheck",
            {"verdict": "update", "drift_mm": 0.0123, "drift_u_mm": 0.004, "doubt": "or a slip"},
            ["0.012 mm", "u 0.004 mm", "or a slip"],
        ),
        (
            "iso9283",
            {"ap_mm": 0.5, "ap_u95_mm": 0.02, "ap_limit_mm": 0.6,
             "rp_c_deg": None, "rp_c_u95_deg": None, "rp_c_limit_deg": 0.1},
            ["AP 0.500 ± 0.020 mm", "0.6 mm", "RP C not known", "0.1°"],
        ),
        (
            "orientation",
            {"before_mean_deg": 0.1, "mean_deg": 0.02, "reflectors_moved_mm": 0.01},
            ["0.1000°", "0.0200°", "0.010 mm"],
        ),
        ("backlash", {"found_mm": 0.19842, "limit_mm": 0.4}, ["0.1984 mm", "0.4 mm"]),
        ("touch", {"station": "S300"}, ["S300"]),
        ("own", {"worst_mm": 0.25, "count": 3}, ["worst 0.2500 mm", "count 3"]),
    ],
)  # fmt: skip
def test_figures_have_units(key: str, body: dict[str, Any], figures: list[str]) -> None:
    words = figures_words(key, body)
    assert [each for each in figures if each not in words] == []


def test_a_calibration_s_verdicts_have_units_and_no_words_of_the_program(
    golden: GoldenRuns,
) -> None:
    found = verdicts(read_facts(golden["small"].folder))
    assert found is not None
    assert len(found.rows) >= 10
    for _, _, by in found.rows:
        assert by
        assert not re.search(r"\b(ratio|outcome|accepted|tolerance \d)|_", by), by


def test_every_verdict_of_a_procedure_has_words() -> None:
    folder = Path(procedures.__file__).parent
    calls = [
        call
        for file in folder.glob("*.py")
        for call in ast.walk(ast.parse(file.read_text("utf-8")))
        if isinstance(call, ast.Call) and getattr(call.func, "attr", "") == "verdict"
    ]
    keys = {
        call.args[0].value
        for call in calls
        if isinstance(call.args[0], ast.Constant) and isinstance(call.args[0].value, str)
    }
    assert len(keys) >= 12
    assert keys <= set(FIGURES)
