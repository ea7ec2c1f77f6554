"""The lines of the screen, as pure functions of a view: what they say, and never too wide."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.cell.file import load_cell
from hilcell.journal.journal import Record
from hilcell.journal.log import Log
from hilcell.model.plan import PlannedStep, Span
from hilcell.model.point import PointId
from hilcell.model.records import Ended
from hilcell.run.control import DeviceStatus, Interlock
from hilcell.run.forecast import SpanProgress
from hilcell.tui.run_view import EngineState, RunView
from hilcell.tui.terminal import UNICODE, to_ascii
from hilcell.tui.text import devices
from hilcell.tui.text import run as run_text
from hilcell.tui.text.devices import DeviceText
from hilcell.tui.text.plots import Measured, tabs_for
from hilcell.tui.text.points import Deviation
from hilcell.tui.text.run import RunText
from tests.hilcell.tui.sample_runs import measuring, sample_run, sample_runs, validated
from tests.hilcell.tui.views import drawn, view_of

ANY = st.floats(allow_nan=True, allow_infinity=True)
BOUNDS = {"coverage": 0.963, "mean_mm": 0.2171, "max_mm": 0.3}


# -- durations and ages ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("seconds", "wanted"),
    [(0, "0:00"), (-3, "0:00"), (0.6, "0:01"), (59.4, "0:59"), (59.6, "1:00"), (61, "1:01"),
     (3599, "59:59"), (3600, "1:00:00"), (86399, "23:59:59"), (100 * 3600, "100:00:00")],
)  # fmt: skip
def test_durations(seconds: float, wanted: str) -> None:
    assert run_text.duration(seconds) == wanted


def test_a_duration_that_is_no_number_is_shown_as_dashes() -> None:
    assert {run_text.duration(s) for s in (math.nan, math.inf, -math.inf)} == {"-:--"}


@pytest.mark.parametrize(
    ("seconds", "wanted"),
    [(0, "0.0 s"), (0.24, "0.2 s"), (9.94, "9.9 s"), (9.96, "10 s"), (10, "10 s"), (99.4, "99 s"),
     (99.6, "2 m"), (100, "2 m"), (3600, "60 m"), (7200, "2 h"), (360000, "4 d"),
     (math.nan, "?"), (math.inf, "?")],
)  # fmt: skip
def test_ages(seconds: float, wanted: str) -> None:
    assert devices.short_age(seconds) == wanted


def test_the_step_of_axis_sweeps_counts_its_sweeps() -> None:
    spans = (Span("sweep", 8, 540.0),)
    assert run_text.sweeps_of([PlannedStep("axis-sweeps", 0, 540.0, spans)]) == 8
    assert run_text.sweeps_of([PlannedStep("home", 0, 0.0)]) == 0
    view = view_of("running")
    assert view.log.plan is not None
    assert view.step is not None
    number = view.step.number - 1
    steps = [*view.log.plan.steps]
    steps[number] = replace(steps[number], points=0, spans=spans)
    view.log.plan = msgspec.structs.replace(view.log.plan, steps=steps)
    assert drawn(RunText(view).step(), 79).endswith(" 0 of 8")


# -- lamps -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("device", "wanted", "good"),
    [
        (DeviceStatus("fresh", 0.2), "● Rail 0.2 s", True),
        (DeviceStatus("fresh", 5.1), "○ Rail 5.1 s", False),
        (DeviceStatus("fresh", math.nan), "○ Rail ?", False),
        (DeviceStatus("moving", 0.2), "► Rail 0.2 s", False),
        (DeviceStatus("lost", 3.0, reason="no heartbeat"), "× Rail lost", False),
        (DeviceStatus("lost", None), "× Rail lost", False),
        (DeviceStatus("unknown", None), "○ Rail -", False),
        (DeviceStatus(), "○ Rail -", False),
        (DeviceStatus("unknown", 1.0), "○ Rail 1.0 s", False),
    ],
)
def test_lamps(device: DeviceStatus, wanted: str, good: bool) -> None:
    lamp = DeviceText(view_of("running")).lamp("rail", device)
    assert lamp.plain == wanted
    assert any("passed" in str(span.style) for span in lamp.spans) == good


def test_a_lamp_is_not_good_when_the_engine_has_gone_silent() -> None:
    view = view_of("running")
    view.status_age_s = 2.1
    for device in (DeviceStatus("fresh", 0.2), DeviceStatus("moving", 0.2)):
        lamp = DeviceText(view).lamp("rail", device)
        assert lamp.plain == "○ Rail 2.3 s"
        assert not any("passed" in str(span.style) for span in lamp.spans)
    view.status_age_s = math.nan
    assert view.stale


def test_a_past_run_has_no_lamps() -> None:
    assert drawn(DeviceText(view_of("done")).lamps(), 80).count(" -") == 4


def test_a_robot_on_the_floor_has_no_lamps_of_a_rail() -> None:
    view = view_of("running")
    assert view.log.plan is not None
    cell = msgspec.json.decode(msgspec.json.encode(load_cell("fixed")))
    log = Log()
    log.take(
        Record(
            1,
            "",
            "plan",
            "",
            msgspec.to_builtins(view.log.plan)
            | {"cell": {k: v for k, v in cell.items() if v is not None}},
        )
    )
    view = replace(view, log=log)
    assert "Rail" not in drawn(DeviceText(view).lamps(), 80)
    assert "Robot" in drawn(DeviceText(view).lamps(), 80)
    assert run_text.resume_text(view).startswith("The robot will move")
    assert Measured.strip_plot not in [tab.make for tab in tabs_for(log)]


# -- lines -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sample_runs())
def test_no_line_is_wider_than_the_terminal(name: str) -> None:
    view = view_of(name)
    for width in (20, 39, 40, 58, 79, 80, 100, 137, 200):
        for lines in (
            RunText(view).progress(),
            RunText(view).banner(),
            RunText(view).identity(),
            RunText(view).step(),
            DeviceText(view).interlocks(),
            DeviceText(view).lamps(),
        ):
            [line] = lines.lines(width)
            assert line.cell_length <= width, line.plain


@pytest.mark.parametrize("name", sample_runs())
def test_the_banner_shows_the_state_and_the_warning_of_the_stop(name: str) -> None:
    line = drawn(RunText(view_of(name)).banner(), 80)
    assert f"{UNICODE.states[name]} {run_text.STATES[name][0]}" in line
    assert ("LIVE" in line) + ("HISTORIC" in line) == (name != "looking")
    notice = run_text.NOT_E_STOP if view_of(name).live else "nothing is connected"
    assert ("use the E-stop" if name == "silent" else notice) in line
    assert ("SIMULATION" in line) == (name not in ("looking", "idle", "unreadable"))


@pytest.mark.parametrize("name", sample_runs())
def test_a_background_run_is_shown_in_every_state(name: str) -> None:
    view = view_of(name)
    for background in ("running", "silent"):
        line = drawn(RunText(view).banner(view_of(background)), 80)
        assert f"background: {run_text.STATES[background][0]}" in line
        assert ("use the E-stop" if background == "silent" else "Esc stops") in line


def test_the_end_of_a_run_behind_names_its_worst_alarm() -> None:
    reported = RunText(view_of("fault")).end_text()
    assert "made-up" in reported
    assert "HC-T99" in reported
    assert "DONE" in RunText(view_of("done")).end_text()


def test_a_real_run_is_not_called_a_simulation() -> None:
    view = view_of("running")
    assert view.log.plan is not None
    view.log.plan = msgspec.structs.replace(view.log.plan, simulated=False)
    assert "SIMULATION" not in drawn(RunText(view).banner(), 80)


def test_the_step_is_shown_in_words_with_the_count_of_its_part() -> None:
    view = view_of("running")
    line = drawn(RunText(view).step(), 79)
    assert "5 of 7  Robot grid" in line
    assert line.endswith(" 5 of 8")
    view.span = SpanProgress(50, 75, of_nests=False)
    assert drawn(RunText(view).step(), 79).endswith(" 50 of 75")
    assert "7 of 7  Validation" in drawn(RunText(view_of("done")).step(), 79)
    assert " of " not in drawn(RunText(view_of("checking")).step(), 79)


def test_the_next_step_is_named_with_the_time_to_it() -> None:
    view = view_of("running")
    assert RunText(view).following().plain.endswith("Fit, in 0:05")
    view.status_age_s = 9.0
    assert RunText(view).following().plain.endswith("Fit")
    assert RunText(view_of("done")).following().plain == ""


def test_a_part_of_a_validation_is_named() -> None:
    story = validated()
    view = RunView("r", engine=EngineState.ANSWERING)
    for record in story.records:
        view.take(record)
    assert ": corrected targets at S1100" in drawn(RunText(view).step(), 79)
    story.point(PointId("control", nest="F1"), commanded_deg=None)
    view.take(story.records[-1])
    view.span = SpanProgress(2, 3, of_nests=True)
    assert drawn(RunText(view).step(), 79).endswith(" 2 of 3")
    assert "Validation: floor nests" in drawn(RunText(view).step(), 79)
    for span in (SpanProgress(4, 8, of_nests=False), None):  # the count is of others
        view.span = span
        assert "floor nests" not in drawn(RunText(view).step(), 79)


def test_running_is_never_bright_where_nothing_is_heard() -> None:
    view = view_of("running")
    assert RunText(view).role() == "live"
    view.status_age_s = 2.1
    assert RunText(view).role() == "label"
    assert "live" not in str(RunText(view).banner().lines(79)[0].spans)
    assert "live" not in str(RunText(view).progress().lines(79)[0].spans)
    view.status = None
    assert RunText(view).role() == "label"


@pytest.mark.parametrize("name", sample_runs())
def test_trouble_fills_the_first_row_and_calm_does_not(name: str) -> None:
    line = RunText(view_of(name)).banner().lines(79)[0]
    loud = run_text.STATES[name][1] in run_text.RunText.LOUD
    filled = [span for span in line.spans if "-fill" in str(span.style)]
    assert line.cell_length == 79
    assert (max(span.end for span in filled) == 79) == loud


def test_a_long_job_leaves_room_for_the_run() -> None:
    view = view_of("running")
    assert view.log.plan is not None
    view.log.plan = msgspec.structs.replace(view.log.plan, job="J" * 500, operator="Ann" * 50)
    line = drawn(RunText(view).identity(), 79)
    assert "job JJJJ" in line
    assert "…" in line
    assert line.endswith("run made-up")


def test_a_journal_that_cannot_be_read_says_why() -> None:
    assert drawn(RunText(view_of("unreadable")).identity(), 80).endswith("damaged or not a journal")


def test_the_newest_point_stays_while_nests_are_proven() -> None:
    view = view_of("running")
    story = measuring().point(PointId("control", nest="F1"), commanded_deg=None)
    view.take(story.records[-1])
    assert view.last is not None
    assert view.last.key == "control/F1"
    assert view.newest == view.log.points["grid/0-0-4"]


@pytest.mark.parametrize("remaining_s", [None, 0.0, 30.0, 1e9])
def test_the_bar_is_as_long_as_the_share(remaining_s: float | None) -> None:
    view = view_of("running")
    view.elapsed_s, view.remaining_s = 10.0, remaining_s
    share = RunText(view).share_done()
    assert 0.0 <= share <= 1.0
    line = drawn(RunText(view).progress(), 79)
    bar = line.count("█") + line.count("▌") + line.count("░")
    assert bar == 43
    assert line.count("█") + line.count("▌") / 2 == math.floor(2 * bar * share) / 2


def test_a_run_that_is_over_is_done() -> None:
    assert (
        RunText(view_of("done")).share_done() == RunText(view_of("intolerant")).share_done() == 1.0
    )
    assert RunText(view_of("fault")).share_done() < 1.0
    assert RunText(view_of("idle")).share_done() == 0.0


def test_interlocks_say_in_short_what_is_locked_and_why() -> None:
    view = view_of("running")
    line = drawn(DeviceText(view).interlocks(), 79)
    for words in ("■ Rail locked: robot not at safe pose", "► Robot free", "► Tracker free"):
        assert words in line
    view.status_age_s = 9.0
    assert "9.0 s" in drawn(DeviceText(view).interlocks(), 79)
    view.status = None
    assert "free" not in drawn(DeviceText(view).interlocks(), 79)


def test_a_lock_that_needs_a_person_says_so_in_its_colour() -> None:
    for name, why in (("paused", "paused"), ("suspended", "waits for the operator")):
        line = DeviceText(view_of(name)).interlocks().lines(79)[0]
        assert f"■ Rail locked: {why}" in line.plain
        assert "■ Robot locked ○ Tracker waits" in line.plain
        assert "ask" in str(line.spans)


def test_reasons_are_short_and_a_long_one_is_never_cut() -> None:
    assert max(map(len, devices.REASONS.values())) <= 26
    view = view_of("running")
    assert view.status is not None
    for blocked, shown in (("the door is open", "the door is open"), ("x" * 27, "see the")):
        locks = [Interlock("rail move", blocked, "HC-X1")]
        view.status = msgspec.structs.replace(view.status, interlocks=locks)
        assert f"Rail locked: {shown}" in drawn(DeviceText(view).interlocks(), 79)


def test_a_run_that_ended_without_a_verdict_says_so() -> None:
    line = drawn(DeviceText(view_of("aborted")).interlocks(), 79)
    assert "nothing may move" in line
    assert re.search(r"move {3,}no verdict: 8 of 21 points", line)
    assert "08:00:25 UTC" in drawn(DeviceText(view_of("aborted")).interlocks(), 119)
    assert DeviceText(view_of("done")).end_note() == DeviceText(view_of("running")).end_note() == ""


def test_a_finished_run_that_judged_nothing_says_so() -> None:
    view = view_of("done")
    view.log.end = Ended(state="finished", exit=0)
    view.log.verdicts.clear()
    assert DeviceText(view).end_note() == "measured"


# -- air -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("drift_k", "warns"), [(0.0, False), (2.0, False), (2.1, True), (-2.1, True), (math.nan, True)]
)
def test_the_air_warns_when_it_drifts(drift_k: float, warns: bool) -> None:
    view = view_of("running")
    assert view.last is not None
    view.last = msgspec.structs.replace(view.last, temperature_c=22.5 + drift_k)
    assert DeviceText(view).air().plain.startswith("▲ ") == warns


def test_a_tracker_without_a_weather_station_is_reported() -> None:
    view = view_of("running")
    assert view.last is not None
    view.last = msgspec.structs.replace(view.last, temperature_c=None)
    assert DeviceText(view).air().plain == "air not measured"


# -- ASCII -----------------------------------------------------------------------------------------


@given(st.text())
def test_ascii_is_ascii_of_the_same_length(text: str) -> None:
    assert to_ascii(text).isascii()
    assert len(to_ascii(text)) == len(text)


def test_deviations_are_values() -> None:
    found = Deviation("p", (3.0, 4.0, 0.0), (0, 0, 0), 5.0)
    assert found.norm_mm == 5.0
    assert found.outcome == "accepted"
    assert replace(found, limit_mm=4.9).outcome == "rejected"
    assert replace(found, U_mm=0.1).outcome == "undecided"
    assert replace(found, U_mm=math.nan).outcome == "rejected"
    assert replace(found, error_mm=(math.nan, 0.0, 0.0)).outcome == "rejected"


def test_a_start_that_was_refused_has_lost_no_engine() -> None:
    view = RunView("r")
    for record in sample_run("idle").records:
        view.take(record)
    assert (view.log.plan, view.state) == (None, "idle")
    plan, *_ = sample_run("running").records
    view.take(plan)
    assert view.state == "gone"
    end = {"state": "idle", "exit": 6, "reason": "the cell is in use", "result": {}}
    view.take(Record(2, plan.t, "end", "", end))
    assert view.state == "idle"


def test_a_point_that_is_re_measured_has_no_time_left() -> None:
    """It is beyond the plan: the row said "0:00 left"."""
    view = view_of("running")
    view.remaining_s = 65.0
    assert "1:05 left" in drawn(RunText(view).progress(), 79)
    view.remaining_s = 0.0
    assert "left" not in drawn(RunText(view).progress(), 79)
