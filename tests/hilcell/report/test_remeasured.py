"""Points measured twice keep both values; every start of an engine stands in the course."""

from pathlib import Path

import pytest

from hilcell.journal.point_id import PointId
from hilcell.report.course import course
from hilcell.report.facts import Facts, read_facts
from hilcell.report.remeasured import remeasured
from tests.hilcell.report.journals import AFTER_MM, Writer, validated_run

TARGET = PointId("validate", station="S1100", how="chosen", number=2)  # off by 0.3 mm at first


def retaken(folder: Path, again_mm: float, what: str = "retake asked") -> Facts:
    writer = validated_run(folder)
    if what:
        writer.journal.append("event", "", {"what": what, "key": TARGET.key})
    nominal_mm = (200.0, 100.0, 1040.0)
    at_mm = (nominal_mm[0] + again_mm, *nominal_mm[1:])
    writer.point(TARGET, at_mm, "S1100", nominal_mm=nominal_mm, retaken=True)
    return writer.facts()


@pytest.mark.parametrize(
    ("what", "why"),
    [
        ("retake asked", "the operator asked for it"),
        ("outlier measured again", "its error stood out from the others"),
        ("", "the run was resumed"),
    ],
)
def test_both_values_and_why(tmp_path: Path, what: str, why: str) -> None:
    found = remeasured(retaken(tmp_path / "r", 0.01, what))
    assert found is not None
    (row,) = [dict(zip(found.headers, row, strict=True)) for row in found.rows]
    assert (row["point"], row["at"], row["why"]) == (TARGET.key, "S1100", why)
    assert (row["error first mm"], row["error again mm"]) == ("0.3000", "0.0100")
    assert (row["apart mm"], row["counts"]) == ("0.3002", "the later")


def test_the_figures_with_the_larger_values_are_stated(tmp_path: Path) -> None:
    found = remeasured(retaken(tmp_path / "r", 0.01))
    assert found is not None
    assert "mean 0.1275 and largest 0.2000 mm count the later values" in found.note
    assert "with the larger of each target 0.2000 and 0.3000 mm" in found.note
    assert "would NOT keep" in found.note


def test_a_larger_later_value_counts(tmp_path: Path) -> None:
    found = remeasured(retaken(tmp_path / "r", 0.5))
    assert found is not None
    assert "largest 0.5000 mm count the later values; with the larger of each target" in found.note


def test_of_three_values_the_last_counts(tmp_path: Path) -> None:
    writer = validated_run(tmp_path / "r")
    for _ in range(2):
        writer.validated("S1100", "chosen", AFTER_MM[:1])
    found = remeasured(writer.facts())
    assert found is not None
    assert [row[3] for row in found.rows] == ["neither", "the later"]


def test_points_of_a_moved_tracker(tmp_path: Path) -> None:
    writer = validated_run(tmp_path / "r")
    moved = {"what": "tracker moved", "set_up": 0, "invalid": [TARGET.key]}
    writer.journal.append("event", "", moved)
    writer.point(TARGET, (200.0, 100.0, 1040.0), "S1100", nominal_mm=(200.0, 100.0, 1040.0))
    found = remeasured(writer.facts())
    assert found is not None
    assert found.rows[0][2] == "measured before the tracker was found moved"


def test_nothing_measured_twice_is_no_table(tmp_path: Path) -> None:
    assert remeasured(validated_run(tmp_path / "r").facts()) is None


def test_every_start_of_an_engine_stands_in_the_course(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "r").began()
    writer.validated("S1100", "before", AFTER_MM)
    writer.state("run", "checking")  # the first engine was killed
    writer.state("run", "running")
    writer.state("run", "faulted", reason="Rail: no answer")
    writer.state("run", "checking")  # resumed
    found = course(read_facts(writer.left()))
    assert found is not None
    starts = [row for row in found.rows if row[1].startswith("engine started")]
    assert [row[1] for row in starts] == [f"engine started, session {n}" for n in (1, 2, 3)]
    first, killed, resumed = (row[2] for row in starts)
    assert first == ""
    assert "stopped without notice (killed, or power lost) after validate/S1100/before/" in killed
    assert "4 points are kept" in killed
    assert resumed.startswith("after the run was faulted; 4 points are kept")
    assert found.note.startswith("3 starts of an engine")
