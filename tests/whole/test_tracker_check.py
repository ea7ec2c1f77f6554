"""The tracker's field check over wires: three trackers, faults, and a nest without a reflector."""

from __future__ import annotations

from pathlib import Path

import pytest

from hilcell.report.drawings.tracker_plots import both_faces, drift
from hilcell.report.facts import read_facts
from hilcell.report.html import report_html
from tests.hilcell.report.drawn import assert_apart
from tests.hilcell.report.pages import Page
from tests.whole.bench import (
    TOTAL_STATION,
    command,
    cut,
    end_of,
    events,
    judge,
    ran,
    sets,
    simulation,
)

T2SA = {"tracker.driver": "t2sa"}


@pytest.mark.parametrize(
    ("values", "two_faces"),
    [({}, True), (TOTAL_STATION | {"layout.nest_samples": "9"}, False), (T2SA, False)],
    ids=["emscon", "geocom", "t2sa"],
)
def test_a_sound_tracker_passes(tmp_path: Path, values: dict[str, str], two_faces: bool) -> None:
    run = ran(tmp_path, "tracker-check", values)
    assert (run.end["state"], run.end["exit"]) == ("finished", 0), run.done.stderr
    assert run.result["tracker_drift"]["points"] == 21
    assert ("tracker_axes" in run.result) is two_faces
    assert any("turn it over" in each for each in run.result["not_checked"]) is not two_faces
    assert not [each for each in run.events if each["kind"] == "intent"]  # nothing moves
    proven = run.result["proven"]
    assert proven["beyond"] == []
    assert f"NOTHING PROVEN WRONG (simulated): {proven['text']}" in run.done.stderr
    page = Page(report_html(read_facts(run.folder)))
    assert ("figure-faces" in page.ids) is two_faces
    assert {"tracker", "figure-tracker-drift"} <= set(page.ids)
    for drawn in filter(None, (both_faces(run.log), drift(run.log))):
        assert_apart(drawn)


@pytest.mark.parametrize(
    ("fault", "value", "key", "alarm"),
    [
        ("tracker.unadjusted", 50.0, "tracker-axes", "HC-V23"),
        ("tracker.warming", 200.0, "tracker-drift", "HC-V24"),
        ("tracker.scale_ppm", 100.0, "known-length", "HC-V12"),
    ],
)
def test_a_fault_fails_its_verdict(
    tmp_path: Path, fault: str, value: float, key: str, alarm: str
) -> None:
    with simulation() as cell:
        cell.strike(fault, value)
        run = ran(tmp_path, "tracker-check", {"simulation.address": cell.control})
    assert (run.end["state"], run.end["exit"]) == ("finished", 1), run.done.stderr
    judged = {each["key"]: each["holds"] for each in run.events if each["kind"] == "verdict"}
    wrong = [name for name, holds in judged.items() if not holds]
    assert key in wrong
    assert set(wrong) <= {key, "known-length"}  # axes that are off falsify lengths, too
    assert alarm in run.done.stderr
    assert run.result["proven"]["beyond"] != []
    assert f"OUT OF TOLERANCE (simulated): {run.result['proven']['text']}" in run.done.stderr


def test_a_steady_drift_is_no_error_of_the_axes(tmp_path: Path) -> None:
    sound = ran(tmp_path, "tracker-check", name="sound").result["tracker_axes"]
    with simulation() as cell:
        cell.strike("tracker.turning", 3000.0)  # 3 urad a reading
        run = ran(tmp_path, "tracker-check", {"simulation.address": cell.control})
    assert not run.result["tracker_drift"]["holds"]
    collimation_urad = run.result["tracker_axes"]["collimation_urad"]
    assert collimation_urad == pytest.approx(sound["collimation_urad"], abs=3.0)


def test_a_nest_without_a_reflector_ends_an_unattended_check(tmp_path: Path) -> None:
    with simulation() as cell:
        cell.strike("tracker.no_reflector", count=0)
        words = ("tracker-check", "--unattended", "--json", "--runs", tmp_path)
        done = command("run", *words, *sets({"simulation.address": cell.control}))
    end = end_of(done)
    assert end["exit"] == 3
    assert end["error"]["code"] == "HC-T11"
    assert "world/F1" in end["error"]["operation"]
    assert not [each for each in events(done.stdout) if each["kind"] == "verdict"]


def test_an_interrupted_series_begins_again_and_nothing_else_does(tmp_path: Path) -> None:
    whole = ran(tmp_path, "tracker-check")
    (seq,) = (each["seq"] for each in whole.events if each.get("key") == "steady/1-5/F3")
    cut(whole.folder, tmp_path / "cut", seq)
    done = command("resume", "cut", "--unattended", "--json", "--runs", tmp_path)
    end, printed = end_of(done), events(done.stdout)
    assert (end["state"], end["exit"]) == ("finished", 0), done.stderr
    points = [each["key"] for each in printed if each["kind"] == "point"]
    assert {key.partition("/")[0] for key in points} == {"control", "steady"}
    assert [key for key in points if key.startswith("steady")] == [
        f"steady/2-{number}/F3" for number in range(21)
    ]
    assert end["result"]["tracker_axes"] == whole.result["tracker_axes"]
    assert end["result"]["tracker_drift"]["points"] == 21
    assert judge([*(each for each in whole.events if each["seq"] <= seq), *printed]) == []
