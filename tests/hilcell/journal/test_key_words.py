"""Texts of alarms and events: keys in them are replaced by words."""

from __future__ import annotations

import pytest

from hilcell.journal.key_words import in_words
from hilcell.journal.log import Log
from tests.hilcell.tui.sample_runs import measuring


@pytest.fixture(scope="module")
def log() -> Log:
    """Return the log of a run on its grid."""
    return Log(measuring().records)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Tracker: measure grid/1-0-0", "Tracker: measure grid point 1-0-0 at S1100"),
        ("at grid/0-0-3, +2.0 K", "at grid point 0-0-3 at S1100, +2.0 K"),
        ("measure world/F1: no beam", "measure floor nest F1: no beam"),
        ("measure validate/S300/chosen/049", "measure corrected target 50 at S300"),
        ("measure validate/S300/chosen/049/seat2.",
         "measure corrected target 50, seat 2 at S300."),
        ("measure held/S300/1-0/P1", "measure proof of the hold: nest P1 at S300"),
        ("visited once more: closing/0-1-0", "visited once more: closing pose 0-1-0"),
        ("measure control/2-0/F3", "measure check of floor nest F3"),
        ("robot.sweep sweep/A1/up", "robot.sweep sweep of A1 up"),
        ("Cell: verdict validation.S1900", "Cell: validation at S1900"),
        ("Cell: verdict sign", "Cell: sign check"),
        ("read at 20 mm/s in /tmp/grid/1-0-0", "read at 20 mm/s in /tmp/grid/1-0-0"),
        ("the verdict.", "the verdict."),
    ],
)  # fmt: skip
def test_keys_become_words(log: Log, text: str, words: str) -> None:
    assert in_words(text, log) == words


@pytest.mark.parametrize("text", ["grid/", "grid//", "sign/x/seat2", "held/", "grid/\u00b2-1-1"])
def test_a_key_of_no_known_form_is_no_error(log: Log, text: str) -> None:
    assert in_words(text, log)
    assert in_words(text, Log())
