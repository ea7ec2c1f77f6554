"""The page of a run's figures: those of ``hilcell show --json``, in words and to the width.

Names of the program (keys, seeds of machines, methods) stay in the files.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from textual.content import Content

from hilcell.clean import harmless
from hilcell.journal.log import Log
from hilcell.journal.point_words import procedure_words
from hilcell.tui.text.frame import wrapped
from hilcell.tui.text.result import own_words
from hilcell.tui.text.sheets import sheet_lines

LABEL = 13  # columns of a name
NAMES = {  # of the summary, by the name shown
    "operator": "operator", "job": "job", "points": "points", "state": "state",
    "verdict": "verdict", "calibration": "stage", "seed": "seed",
    "accepted": "accepted", "link_warning": "warning", "fault": "fault",
}  # fmt: skip


def report_lines(found: Mapping[str, Any], log: Log | None, width: int) -> list[Content]:
    """Return the facts of a run, its own table and its sentence, in lines of at most ``width``."""
    procedure = str(found.get("procedure", ""))
    facts = [("run", str(found.get("run", ""))), ("procedure", procedure_words(procedure))]
    facts += [("cell", str(found.get("cell", "")))]
    facts += [("simulated", "yes, no device moved" if found.get("simulated") else "no")]
    facts += [(shown, _words(found[name])) for name, shown in NAMES.items() if found.get(name)]
    standing = found.get("standing")
    if isinstance(standing, Mapping):
        facts.append(("calibration", str(standing.get("text", ""))))
    lines = [line for name, text in facts for line in _fact(name, text, width)]
    result = found.get("result")
    if found.get("state") == "finished" and isinstance(result, dict):
        table, text = own_words(procedure, result)
        if table:
            lines += [Content(""), *sheet_lines(table, width, log)]
        if text:
            lines += [Content(""), *wrapped(harmless(text), width)]
    return lines


def _words(value: object) -> str:
    """Return a value as a person reads it; names of states have no underscores."""
    if isinstance(value, list):
        return "; ".join(map(_words, value))
    text = str(value)
    return text if " " in text else text.replace("_", " ")


def _fact(name: str, text: str, width: int) -> list[Content]:
    first, *rest = wrapped(harmless(text), max(width - LABEL, 1)) or [Content("")]
    head = Content.styled(f"{name:<{LABEL}}", "$label").append(first)
    return [head, *(line.pad_left(LABEL) for line in rest)]
