"""Texts of alarms and events: keys in them are replaced by words."""

from __future__ import annotations

import pytest

from hilcell.journal.log import Log
from hilcell.journal.words import in_words
from tests.hilcell.tui.sample_runs import measuring


@pytest.fixture(scope="module")
def log() -> Log:
    """Return the log of a run on its grid."""
    return Log(measuring().records)


def test_keys_become_words(log: Log) -> None:
    known = {
        "Tracker: measure grid/1-0-0": "Tracker: measure grid point 1-0-0 at S1100",
        "measure world/F1: no beam": "measure floor nest F1: no beam",
        "measure validate/S300/chosen/049/seat2.": ("measure corrected target 50, seat 2 at S300."),
        "Cell: verdict validation.S1900": "Cell: validation at S1900",
        "read at 20 mm/s in /tmp/grid/1-0-0": "read at 20 mm/s in /tmp/grid/1-0-0",
    }
    assert {text: in_words(text, log) for text in known} == known


@pytest.mark.parametrize("text", ["grid/", "grid//", "sign/x/seat2", "held/", "grid/\u00b2-1-1"])
def test_a_key_of_no_known_form_is_no_error(log: Log, text: str) -> None:
    assert in_words(text, log)
    assert in_words(text, Log())
