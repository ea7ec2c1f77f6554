"""The page of a run's figures: those of ``hilcell show --json``, in words and to the width.

Names of the program (keys, seeds of machines, methods) stay in the files.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hilcell.clean import harmless
from hilcell.journal.log import Log
from hilcell.journal.point_words import procedure_words
from hilcell.tui.layout import BLANK, Lines, Stack, Text, facts_grid
from hilcell.tui.text.result import own_words
from hilcell.tui.text.sheets import sheet_lines

NAMES = {  # of the summary, by the name shown
    "operator": "operator", "job": "job", "points": "points", "state": "state",
    "verdict": "verdict", "calibration": "stage", "seed": "seed",
    "accepted": "accepted", "link_warning": "warning", "fault": "fault",
}  # fmt: skip


def report_lines(found: Mapping[str, Any], log: Log | None) -> Lines:
    """Return the facts of a run, its own table and its sentence."""
    procedure = str(found.get("procedure", ""))
    facts = [("run", str(found.get("run", ""))), ("procedure", procedure_words(procedure))]
    facts += [("cell", str(found.get("cell", "")))]
    facts += [("simulated", "yes, no device moved" if found.get("simulated") else "no")]
    facts += [(shown, _words(found[name])) for name, shown in NAMES.items() if found.get(name)]
    standing = found.get("standing")
    if isinstance(standing, Mapping):
        facts.append(("calibration", str(standing.get("text", ""))))
    parts: list[Lines | Text] = [facts_grid((name, harmless(text)) for name, text in facts)]
    result = found.get("result")
    if found.get("state") == "finished" and isinstance(result, dict):
        table, text = own_words(procedure, result)
        parts += [BLANK, sheet_lines(table, log)] if table else []
        parts += [BLANK, harmless(text)] if text else []
    return Stack(*parts)


def _words(value: object) -> str:
    """Return a value as a person reads it; names of states have no underscores."""
    if isinstance(value, list):
        return "; ".join(map(_words, value))
    text = str(value)
    return text if " " in text else text.replace("_", " ")
