"""How a run of a log came out, in the word that the list of runs has for it."""

from __future__ import annotations

from hilcell.journal.calibration_facts import CalibrationReader, outcome
from hilcell.journal.log import Log


def run_outcome(log: Log) -> str:
    """Return the word for the run of a log."""
    reader = CalibrationReader()
    for key, body in log.verdicts.items():
        reader.judge(key, body)
    code = None if log.end is None else int(log.end["exit"])
    return outcome(reader.facts, log.state, code, len(log.points))
