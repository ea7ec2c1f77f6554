"""The word for a run, from its log: the same that the list of runs has from its index."""

from __future__ import annotations

from pathlib import Path

import pytest

from hilcell.journal.calibration_facts import facts_of
from hilcell.journal.index import row_of
from hilcell.journal.runs import read_log
from hilcell.model.point import PointId
from tests.hilcell.report.journals import Writer
from tests.hilcell.verdicts import FITTED, JUDGED, POSE_TESTED


@pytest.mark.parametrize(
    ("points", "end", "said"),
    [(1, 0, "measured"), (0, 0, "done"), (1, 1, "out of tolerance"), (1, None, "")],
)
def test_a_run_that_judged_nothing(tmp_path: Path, points: int, end: int | None, said: str) -> None:
    writer = Writer(tmp_path / "r").began()
    for number in range(points):
        writer.point(PointId("noise", number=number), (1.0, 2.0, 3.0))
    if end is not None:
        writer.state("run", "finished")
        writer.journal.append("end", "", {"state": "finished", "exit": end, "result": {}})
    writer.journal.close()
    assert read_log(tmp_path / "r").outcome == row_of(tmp_path / "r").verdict == said


def test_a_model_whose_places_were_not_validated_is_in_no_tolerance() -> None:
    """Another test that holds says nothing of it."""
    tested = facts_of({"fit": FITTED, "iso9283": POSE_TESTED})
    assert (tested.outcome, tested.verdict) == (None, "not validated")
    assert facts_of({"fit": FITTED, "validation.S1": JUDGED}).verdict == "in tolerance"
    assert facts_of({"iso9283": POSE_TESTED}).verdict == "in tolerance"
