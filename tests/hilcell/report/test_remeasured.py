"""Points measured twice keep both values; every start of an engine stands in the course."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from hilcell.calibration.orientation import validated_orientation_errors
from hilcell.calibration.position_errors import validation
from hilcell.geometry.frames import from_rotvec
from hilcell.model.point import PointId, Sent
from hilcell.report.facts import Facts, read_facts
from hilcell.report.tables import Tables
from hilcell.report.timeline import timeline
from tests.hilcell.report.journals import AFTER_MM, Writer, validated_run
from tests.hilcell.verdicts import FITTED

TARGET = PointId("validate", station="S1100", how="chosen", number=2)  # off by 0.3 mm at first


def retaken(folder: Path, again_mm: float, what: str = "retake asked") -> Facts:
    writer = validated_run(folder)
    if what:
        writer.event(what, key=TARGET.key)
    nominal_mm = (200.0, 100.0, 1040.0)
    at_mm = (nominal_mm[0] + again_mm, *nominal_mm[1:])
    writer.point(TARGET, at_mm, "S1100", nominal_mm=nominal_mm, retaken=True)
    return writer.facts()


@pytest.mark.parametrize(
    ("what", "why"),
    [("retake asked", "operator"), ("outlier measured again", "others"), ("", "resumed")],
)
def test_both_values_and_why(tmp_path: Path, what: str, why: str) -> None:
    found = Tables(retaken(tmp_path / "r", 0.01, what)).remeasured()
    (row,) = [dict(zip(found.headers, row, strict=True)) for row in found.texts()]
    assert why in row["why"]
    assert (row["error first mm"], row["error again mm"]) == ("0.3000", "0.0100")
    assert (row["apart mm"], row["counts"]) == ("0.3002", "first")


def test_of_a_target_the_larger_error_counts_everywhere(tmp_path: Path) -> None:
    facts, later = retaken(tmp_path / "r", 0.01), retaken(tmp_path / "s", 0.5)
    errors = validation(facts.log, ["S1100"])[Sent.CHOSEN]
    assert errors.norms_mm.tolist() == pytest.approx([0.1, 0.2, 0.3, 0.2])
    after = next(row for row in Tables(facts).accuracy().texts() if row[1].startswith("after"))
    assert after[3] == "0.200", "the table has the same mean"
    assert Tables(later).remeasured().texts()[0][2] == "again"
    assert validation(later.log, ["S1100"])[Sent.CHOSEN].figures.max == pytest.approx(0.5)
    writer = validated_run(tmp_path / "t")
    for error_mm in (0.4, 0.05):
        writer.validated("S1100", "chosen", [(error_mm, 0.0, 0.0)])
    of_three = Tables(writer.facts()).remeasured()
    assert [row[2] for row in of_three.texts()] == ["again", "first"]


def test_points_of_a_moved_tracker(tmp_path: Path) -> None:
    writer = validated_run(tmp_path / "r")
    writer.event("tracker moved", set_up=0, invalid=[TARGET.key])
    writer.point(TARGET, (200.0, 100.0, 1040.0), "S1100", nominal_mm=(200.0, 100.0, 1040.0))
    found = Tables(writer.facts()).remeasured()
    assert "tracker" in found.texts()[0][1]
    assert found.texts()[0][2] == "again"


def test_every_start_of_an_engine_stands_in_the_course(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "r").began()
    writer.validated("S1100", "before", AFTER_MM)
    writer.state("run", "checking")  # the first engine was killed
    writer.state("run", "running")
    writer.state("run", "faulted", reason="Tracker: measure validate/S300/chosen/049: no beam")
    writer.state("run", "checking")  # resumed
    found = timeline(read_facts(writer.left()))
    words = " ".join(row[1] for row in found.texts())
    for session in (1, 2, 3):
        assert f"session {session}" in words
    assert "A. Technician" in words
    assert "job J-17" in words
    assert words.count("4 points") == 2
    assert "no beam" in words
    assert found.note.startswith("3 ")


def test_each_step_and_event_has_its_line(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "r").began()
    events: list[tuple[dict[str, object], str]] = [
        ({"what": "step", "name": "robot-grid", "number": 1, "of": 2}, "grid"),
        ({"what": "station held", "station": "S300", "tries": 2, "strip_mm": 300.004}, "300.00 mm"),
        ({"what": "step", "name": "own-step", "number": 2, "of": 2}, "Own step"),
        ({"what": "retake asked", "key": TARGET.key}, "target 3 at S1100"),
        (
            {"what": "tracker moved", "set_up": 1, "invalid": ["grid/0-0-0"], "moved_mm": 0.31},
            "0.310 mm",
        ),
        ({"what": "no reading", "key": "grid/1-0-0", "tries": 3, "reason": "no beam"}, "1-0-0"),
        ({"what": "first pass", "key": "sweep/A1/up", "speed_percent": 10.0}, "A1"),
        (
            {"what": "station decided", "station": "S300", "mean_U_mm": 0.04, "max_U_mm": 0.05},
            "S300",
        ),
        ({"what": "axes not swept", "reason": "too far from the tracker"}, "too far"),
        ({"what": "screen lost", "after_s": 2.0}, "creen"),
    ]
    for event, _ in events:
        writer.journal.append("event", "", event)
        if event["what"] == "station held":
            writer.validated("S1100", "chosen", AFTER_MM[:2])
    found = timeline(writer.facts())
    words = [row[1] for row in found.texts()[1:-1]]
    assert len(words) == len(events)
    assert [word in line for line, (_, word) in zip(words, events, strict=True)] == [True] * 10


def test_a_step_counts_the_points_that_are_its_own(tmp_path: Path) -> None:
    """Neither a check of nests nor what the next session measures before its first step."""
    writer = Writer(tmp_path / "r").began()
    writer.step("robot-grid")
    writer.point(PointId("grid", vertex=(0, 0, 0)), (1.0, 2.0, 3.0))
    writer.point(PointId("control", session=1, pass_number=0, nest="F1"), (1.0, 2.0, 3.0))
    writer.state("run", "checking")
    writer.point(PointId("grid", vertex=(0, 0, 1)), (1.0, 2.0, 3.0))
    words = [row[1] for row in timeline(writer.facts()).texts()]
    assert [each for each in words if "grid" in each and "point." in each] == [
        "Robot grid. 1 point."
    ]


SEATS_MM = np.array([[98.0, 0.0, 127.0], [-40.0, 110.0, 127.0], [-40.0, -110.0, 127.0]])


def test_of_an_orientation_the_larger_value_counts_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("hilcell.calibration.orientation", "hilcell.report.tables"):
        monkeypatch.setattr(f"{module}.seats_of", lambda log: SEATS_MM)  # as a base frame finds it
    writer = Writer(tmp_path / "r").began()
    for turn_rad in (1e-3, 2e-4, 3e-4):
        R = from_rotvec([0.0, 0.0, turn_rad])
        for seat, at_mm in enumerate(SEATS_MM, start=1):
            nominal_deg = (0.0, 0.0, 0.0) if seat == 1 else None
            writer.point(
                TARGET.at_seat(seat), R @ at_mm, "S1100", nominal_deg=nominal_deg,
                nominal_mm=tuple(at_mm) if seat == 1 else None,
            )  # fmt: skip
    writer.journal.append("verdict", "fit", FITTED)  # of a correction that turns no tool
    facts = writer.facts()
    found = Tables(facts).remeasured()
    rows = [dict(zip(found.headers, row, strict=True)) for row in found.texts()]
    assert {(row["turned first °"], row["turned again °"]) for row in rows} == {
        ("0.0573", "0.0115"), ("0.0115", "0.0172"),
    }  # fmt: skip
    turned = validated_orientation_errors(facts.log, ["S1100"])[Sent.CHOSEN]
    assert turned.figures.max_deg == pytest.approx(0.0573, abs=1e-4)
    assert "Orientation ." not in Tables(facts).orientation().note


def test_a_step_that_a_later_session_only_passes_is_not_in_the_course(tmp_path: Path) -> None:
    """A resumed run listed sweeps, frames and fit as if it had measured all of them again."""
    writer = Writer(tmp_path / "r").began()

    def steps(*names: str) -> None:
        for number, name in enumerate(names, 1):
            writer.step(name, number, 4)
            if name == "world-frame":  # the same again, at every start
                writer.event("tracker proven", off_mm=[0.01])
                writer.journal.append("frame", "world", {"matrix": np.eye(4).tolist()})
            if name == "fit":
                fitted = msgspec.structs.replace(FITTED, reason=f"of {len(names)} steps")
                writer.journal.append("verdict", "fit", fitted)

    steps("world-frame", "axis-sweeps", "fit")
    writer.validated("S1100", "before", AFTER_MM)
    writer.state("run", "checking")
    steps("world-frame", "axis-sweeps", "fit", "validate")
    writer.validated("S1100", "chosen", AFTER_MM[:1])
    writer.state("run", "checking")
    steps("world-frame", "axis-sweeps", "fit", "validate")
    found = timeline(read_facts(writer.left()))
    lines = [row[1] for row in found.texts()]
    assert [sum(word in line for line in lines) for word in ("World", "sweeps", "Validation")] == [
        1, 1, 1,
    ]  # fmt: skip
    fitted = [line for line in lines if line.startswith("Fit.")]
    assert ["nothing measured" in line for line in fitted] == [False, True]


def test_a_point_measured_again_is_not_of_the_step_in_which_it_came(tmp_path: Path) -> None:
    """A target that was measured again made a line "Robot grid. 1 point."."""
    writer = validated_run(tmp_path / "r")
    for session in range(2):
        for number, name in enumerate(("home", "robot-grid", "validate"), 1):
            writer.step(name, number, 3)
            if session and name == "robot-grid":
                writer.event("retake asked", key=TARGET.key)
                writer.journal.append("intent", TARGET.key, {"action": "robot.move"})
                place = (200.0, 100.0, 1040.0)
                writer.point(TARGET, place, "S1100", nominal_mm=place, retaken=True)
        writer.state("run", "finished")
        writer.state("run", "checking")
    found = timeline(read_facts(writer.left()))
    again = [row[1] for row in found.texts()]
    again = again[next(n for n, line in enumerate(again) if "session 2" in line) :]
    assert sum("grid" in line.lower() for line in again) == 0
    assert sum("gain" in line and "target 3 at S1100" in line for line in again) == 1
    assert sum("Home the rail" in line for line in again) == 1


def test_a_crash_stands_at_its_time_and_before_what_came_after(tmp_path: Path) -> None:
    """The order to go on is written before the next session begins."""
    writer = Writer(tmp_path / "r").began()
    writer.validated("S1100", "before", AFTER_MM)
    writer.event("order", number=14, known=[])
    writer.state("run", "checking")
    facts = read_facts(writer.left())
    (order,) = (each for each in facts.records if each.body.get("what") == "order")
    (before,) = (each for each in facts.records if each.seq == order.seq - 1)
    late = [
        msgspec.structs.replace(each, t="2030-01-01T00:00:00.000+00:00")
        if each.seq >= order.seq
        else each
        for each in facts.records
    ]
    found = timeline(replace(facts, records=late))
    words = [row[1] for row in found.texts()]
    at = next(n for n, each in enumerate(words) if each.startswith("Engine lost"))
    assert before.t[11:19] in found.texts()[at][0]
    assert "session 2" in words[at + 1]
    assert not any("session 14" in each for each in words)


def test_a_step_that_a_plan_leaves_out_is_not_in_the_course(tmp_path: Path) -> None:
    lines = []
    for name, seen in (("full", True), ("quick", False)):
        writer = Writer(tmp_path / name).began()
        writer.step("two-face")
        if seen:
            writer.point(PointId("back", number=0, nest="F1"), (1.0, 2.0, 3.0))
        found = timeline(writer.facts())
        lines.append([row[1] for row in found.texts() if "both faces" in row[1]])
    assert lines == [["Tracker in both faces. 1 point."], []]
