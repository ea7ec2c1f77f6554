"""Rows under the points: interlocks with their readings, the next steps, events in words."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from hilcell.journal.journal import Record
from hilcell.model.point import PointId
from hilcell.model.verdicts import Verdict
from hilcell.run.control import Interlock
from hilcell.run.forecast import Forecast, RemainingSpan
from hilcell.tui.layout import Stack
from hilcell.tui.run_view import EngineState, RunView
from hilcell.tui.terminal import UNICODE
from hilcell.tui.text.devices import DeviceText
from hilcell.tui.text.run import RunText
from tests.hilcell.tui.sample_runs import SampleRun, measuring, sample_run, status, validated
from tests.hilcell.tui.views import drawn
from tests.hilcell.verdicts import BACKLASH, JUDGED, LENGTHS, REVISITED, plain


def view_of(story: SampleRun, state: str = "running") -> RunView:
    view = RunView("r", engine=EngineState.ANSWERING, status=status(state))
    for record in story.records:
        view.take(record)
    return view


def test_events_go_first_then_steps() -> None:
    view = view_of(measuring())
    view.ahead = [
        RemainingSpan(5, "flange", 3, 60.0),
        RemainingSpan(6, "fit", 0, 1.0),
        RemainingSpan(7, "flange", 6, 60.0),
    ]
    heads = ("interlocks", "next steps", "newest events")
    seen = {}
    for rows in (4, 7, 12, 17):
        text = drawn(RunText(view).below({}, rows))
        assert len(text.splitlines()) <= rows
        seen[rows] = tuple(head in text for head in heads)
    assert seen[4] == (True, False, False)
    assert seen[7] == (True, True, False)
    assert seen[12] == seen[17] == (True, True, True)


def test_an_interlock_has_its_whole_reason_or_the_reading_that_frees_it() -> None:
    lines = drawn(Stack(*RunText(view_of(measuring()), UNICODE).interlocks())).splitlines()
    assert lines[1].split()[:3] == ["■", "Rail", "locked"]
    assert "robot not at safe pose, A2 −53.017 deg" in lines[1]
    assert "Robot   free   slide 1100.20 mm, held, strip 1100.00 mm" in lines[2]
    assert "Tracker free   last reading SMR 1.5in" in lines[3]


@pytest.mark.parametrize("name", ["running", "paused", "suspended"])
def test_row_panel_and_page_say_the_same_of_each_interlock(name: str) -> None:
    view = view_of(sample_run(name), name)
    row = drawn(DeviceText(view).interlocks())
    panel = drawn(Stack(*RunText(view).interlocks())).splitlines()
    page = DeviceText(view).interlock_page().plain.splitlines()
    for number, lock in enumerate(DeviceText(view).locks()):
        assert f"{lock.shape} {lock.name} {lock.word}" in row
        assert panel[number + 1].split()[:3] == [lock.shape, lock.name, lock.word]
        assert page[number].startswith(f"{lock.shape} {lock.name} {lock.word}")
        assert ("free" in row) == ("free" in page[1]) == (name == "running")


@pytest.mark.parametrize("width", [60, 79])
def test_a_reason_is_never_cut_and_has_the_signs_of_its_figures(width: int) -> None:
    view = view_of(measuring())
    assert view.status is not None
    why = "robot not at safe pose, A2 -41.381 deg, expected -100.000 +-0.1 deg"
    locked = [Interlock("rail move", why, "HC-B32")]
    view.status = msgspec.structs.replace(view.status, interlocks=locked)
    lines = drawn(Stack(*RunText(view).interlocks()), width).splitlines()
    assert lines[1].rstrip() == " ■ Rail    locked robot not at safe pose"
    assert "A2 −41.381 deg, expected −100.000 ±0.1 deg" in DeviceText(view).interlock_page().plain


def test_a_stale_status_frees_nothing() -> None:
    view = view_of(measuring())
    view.status_age_s = 60.0
    text = drawn(Stack(*RunText(view).interlocks()))
    assert "free" not in text
    assert "no reading" in text


def test_steps_start_one_after_the_other() -> None:
    view = view_of(measuring())
    view.ahead = [
        RemainingSpan(5, "flange", 3, 80.0), RemainingSpan(5, "10 readings", 3, 5.0),
        RemainingSpan(5, "leg", 0, 14.0),
        RemainingSpan(6, "fit", 0, 0.0), RemainingSpan(7, "flange", 6, 61.0),
    ]  # fmt: skip
    lines = [line.split() for line in drawn(Stack(*RunText(view).steps(6))).splitlines()[1:]]
    assert [line[-2:] for line in lines] == [
        ["now", "1:25"], ["1:25", "0:14"], ["1:39", "0:00"], ["1:39", "1:01"],
    ]  # fmt: skip
    assert lines[0][:5] == ["►", "Robot", "grid:", "3", "points"]
    assert lines[1][:5] == ["Rail", "to", "the", "next", "station"]


def test_the_forecast_says_what_is_ahead() -> None:
    """The step under way has what is left of it; none is of a step before."""
    story, forecast = measuring(), Forecast()
    for record in story.records:
        forecast.take(record)
    now = story.now + timedelta(seconds=1)
    ahead = forecast.ahead(now)
    later = forecast.ahead(now + timedelta(seconds=1))
    assert ahead[0].takes_s == pytest.approx(later[0].takes_s + 1.0)
    assert [part.takes_s for part in ahead[1:]] == [part.takes_s for part in later[1:]]
    assert [part.step for part in ahead] == [5, 6, 7]
    assert ahead[0].measured == 3


def test_events_are_told_in_words() -> None:
    story = validated()
    view = view_of(story)
    errors = {"validate/S1100/chosen/001": 0.1005}
    words = [RunText(view).event_text(record, errors) for record in story.records]
    assert words[-1] == "measured corrected target 2 at S1100: |e| 0.101 mm"
    assert "rail held at S1100: 1100.00 mm by the strip, 2nd approach" in words
    assert "robot sent to grid point 0-0-3 at S1100" in words
    assert "the run is running" in words
    assert not any(text.startswith("plan") for text in words)


def test_a_point_that_is_not_measured_yet_has_its_name() -> None:
    story = measuring()
    story.add("intent", "grid/9-9-9", action="robot.move")
    view = view_of(story)
    assert (
        RunText(view).event_text(story.records[-1], {}) == "robot sent to grid point 9-9-9 at S1100"
    )
    story.point(PointId("grid", vertex=(8, 8, 8)))
    assert RunText(view).event_text(story.records[-1], {}) == "measured grid point 8-8-8 at S1100"


def test_events_show_no_raw_keys() -> None:
    """Facts and keys are for the log."""
    happened: tuple[tuple[dict[str, Any], str], ...] = (
        ({"what": "closed", "problems": {"Rail": "x"}}, "Rail"),
        ({"what": "link", "frames": 9, "bad_lines": 1, "refused": 0, "malformed": 1}, "2 of 9"),
        ({"what": "step", "name": "validate", "number": 7, "of": 7}, "7 of 7"),
        ({"what": "no reading", "key": "grid/1-0-0", "tries": 2, "reason": "beam broken"},
         "grid point 1-0-0"),
        ({"what": "seated", "place": "P1", "xyz_mm": [1.0, 2.0, 3.0]}, "P1"),
        ({"what": "something new", "facts": {"a": 1.0}}, "something new"),
    )  # fmt: skip
    view = view_of(measuring())
    for body, token in happened:
        record = Record(1, "2026-03-04T08:00:00.000+00:00", "event", "", body)
        words = RunText(view).event_text(record, {})
        assert token in words
        assert not set("{}[]/_") & set(words)
    healthy = {"what": "link", "frames": 9, "bad_lines": 0, "refused": 0, "malformed": 0}
    assert RunText(view).event_text(Record(1, "", "event", "", healthy), {}) == ""


@pytest.mark.parametrize(
    ("key", "verdict", "words"),
    [
        ("validation.S1100", replace(JUDGED, mean_mm=0.033, mean_tolerance_mm=0.12),
         "validation at S1100 passes: mean 0.033 mm, limit 0.120 mm"),
        ("validation.others", replace(JUDGED, mean_mm=0.033, mean_tolerance_mm=0.12),
         "validation at the other stations passes: mean 0.033 mm, limit 0.120 mm"),
        ("known-length", LENGTHS, "known length passes"),
        ("revisits.closing", replace(REVISITED, holds=False),
         "revisited poses at the end fails"),
        ("backlash", BACKLASH,
         "backlash of the rail passes: backlash 0.200 mm, limit 0.400 mm"),
    ],
)  # fmt: skip
def test_a_verdict_has_the_name_of_its_subject(key: str, verdict: Verdict, words: str) -> None:
    record = SampleRun().add("verdict", key, **plain(verdict)).records[-1]
    assert RunText(view_of(measuring())).event_text(record, {}) == words


def test_a_run_of_which_only_the_plan_is_known_has_no_events_yet() -> None:
    story = measuring()
    story.records = story.records[:1]
    text = drawn(RunText(view_of(story)).below({}, 17))
    assert text.splitlines()[-1].startswith("─ newest events ─")
