"""The verdicts of a run: each in words, with the unit and the limit of every figure."""

from __future__ import annotations

import re

from hilcell.journal.words import verdict_words
from hilcell.model.verdicts import Verdict
from hilcell.present.table import Column, Table
from hilcell.report.facts import Facts


def verdicts(facts: Facts) -> Table:
    """Return the verdicts, with the figures behind them."""
    columns: tuple[Column[tuple[str, Verdict]], ...] = (
        Column("judged", lambda row: verdict_words(row[0])),
        Column("verdict", lambda row: "holds" if row[1].holds else "does not hold"),
        Column("by", lambda row: with_signs(row[1].words)),
    )
    return Table(columns, facts.log.verdicts.items(), "Verdicts")


def with_signs(words: str) -> str:
    """Return words with the signs of print."""
    signs = {"<=": "≤", r"\+-": "±", r" deg\b": "°", r"\burad\b": "µrad"}
    for written, shown in signs.items():
        words = re.sub(written, shown, words)
    return words
