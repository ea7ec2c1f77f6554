"""Errors are data: their facts are plain enough for JSON, their text is made at the end."""

from __future__ import annotations

import json

import numpy as np

from hilcell.cell.devices import ConnectFailed
from hilcell.errors import DeviceError, HilcellError, NoReading, Stopped, facts_of
from hilcell.run.cell_lock import CellLocked

STALLED = DeviceError(
    "HC-R31",
    "Rail",
    "move",
    "no progress for 3 s",
    expected="5 mm",
    act="look",
    fields={"waited_s": 3.0, "axes_deg": np.array([1.0, np.nan]), "node": np.int64(5)},
)


def test_a_text_is_formatted_from_the_parts() -> None:
    assert str(STALLED) == "Rail: move: no progress for 3 s, expected 5 mm; look"
    assert STALLED.summary == "Rail: move: no progress for 3 s, expected 5 mm"


def test_facts_are_plain_and_know_no_nan() -> None:
    facts = STALLED.facts()
    assert json.loads(json.dumps(facts, allow_nan=False)) == facts
    assert facts["code"] == "HC-R31"
    assert facts["fields"] == {"waited_s": 3.0, "axes_deg": [1.0, "nan"], "node": 5}


def test_causes_stay_data_and_become_a_tree_at_the_end() -> None:
    other = DeviceError("HC-T01", "Tracker", "connect", "refused")
    error = ConnectFailed({"Rail": STALLED, "Tracker": other})
    assert str(error).splitlines() == [
        "Cell: connect: Rail, Tracker failed",
        "  Rail",
        "    Rail: move: no progress for 3 s, expected 5 mm; look",
        "  Tracker",
        "    Tracker: connect: refused",
    ]
    assert [cause["code"] for cause in error.facts()["causes"]] == ["HC-R31", "HC-T01"]


def test_a_class_s_code_and_that_of_one_error() -> None:
    assert facts_of(CellLocked("busy")) == {"code": "HC-C04", "found": "busy"}
    assert HilcellError("x").code == "HC-C99"
    assert HilcellError("x", code="HC-J08").code == "HC-J08"
    assert Stopped("x").code == "HC-C05"


def test_an_error_that_nobody_expected_is_a_defect() -> None:
    facts = facts_of(KeyError("x"))
    assert (facts["code"], facts["found"]) == ("HC-C07", "KeyError: 'x'")


def test_a_reading_that_failed_knows_its_point() -> None:
    error = NoReading("HC-T10", "Tracker", "measure", "the beam broke", act="clear it")
    of_point = error.of_point("grid/1")
    assert str(of_point) == "Tracker: measure grid/1: the beam broke; clear it"
    assert of_point.facts()["fields"] == {"point": "grid/1"}
