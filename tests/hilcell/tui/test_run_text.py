"""The lines of the screen, as pure functions of a view: what they say, and never too wide."""

from __future__ import annotations

import math
from dataclasses import replace

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.cell.file import load_cell
from hilcell.journal.journal import Record
from hilcell.journal.log import Log
from hilcell.journal.point_id import PointId
from hilcell.run.protocol import DeviceStatus
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.terminal.capabilities import ASCII, UNICODE, to_ascii
from hilcell.tui.text import run as run_text
from hilcell.tui.text.deviation import Deviation, deviation_lines, large_digits, tolerance_line
from hilcell.tui.text.plots import strip_plot, tabs_of
from tests.hilcell.tui.sample_runs import measuring, sample_runs
from tests.hilcell.tui.views import view_of

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


@pytest.mark.parametrize("seconds", [math.nan, math.inf, -math.inf])
def test_a_duration_that_is_no_number_is_shown_as_dashes(seconds: float) -> None:
    assert run_text.duration(seconds) == "-:--"


@pytest.mark.parametrize(
    ("seconds", "wanted"),
    [(0, "0.0 s"), (0.24, "0.2 s"), (9.94, "9.9 s"), (9.96, "10 s"), (10, "10 s"), (99.4, "99 s"),
     (99.6, "2 m"), (100, "2 m"), (3600, "60 m"), (7200, "2 h"), (360000, "4 d"),
     (math.nan, "?"), (math.inf, "?")],
)  # fmt: skip
def test_ages(seconds: float, wanted: str) -> None:
    assert run_text.short_age(seconds) == wanted


@given(st.floats(0, 1e6))
def test_ages_are_short(seconds: float) -> None:
    assert len(run_text.short_age(seconds)) <= 5


def test_the_step_of_axis_sweeps_counts_its_sweeps() -> None:
    spans = [{"kind": "sweep", "measured": 8, "duration_s": 540.0}]
    assert run_text.sweeps_of([{"name": "axis-sweeps", "spans": spans}]) == 8
    assert run_text.sweeps_of([{"name": "home"}]) == 0
    view = view_of("running")
    assert view.log.plan is not None
    number = int(view.step["number"]) - 1
    steps = [dict(each) for each in view.log.plan.steps]
    steps[number] |= {"points": 0, "spans": spans}
    view.log.plan = msgspec.structs.replace(view.log.plan, steps=steps)
    assert ": 0/8 sweeps" in run_text.step(view, 120).plain


# -- lamps -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("device", "wanted", "good"),
    [
        (DeviceStatus("fresh", 0.2), "● Rail 0.2 s", True),
        (DeviceStatus("fresh", 5.1), "○ Rail 5.1 s", False),
        (DeviceStatus("fresh", math.nan), "○ Rail ?", False),
        (DeviceStatus("moving", 0.2), "► Rail moves", False),
        (DeviceStatus("lost", 3.0, reason="no heartbeat"), "× Rail lost", False),
        (DeviceStatus("lost", None), "× Rail lost", False),
        (DeviceStatus("unknown", None), "○ Rail -", False),
        (DeviceStatus(), "○ Rail -", False),
        (DeviceStatus("unknown", 1.0), "○ Rail 1.0 s", False),
    ],
)
def test_lamps(device: DeviceStatus, wanted: str, good: bool) -> None:
    lamp = run_text.lamp("rail", device, view_of("running"), UNICODE)
    assert lamp.plain == wanted
    assert any("passed" in str(span.style) for span in lamp.spans) == good


def test_a_lamp_is_not_good_when_the_engine_has_gone_silent() -> None:
    view = view_of("running")
    view.status_age_s = 2.1
    for device in (DeviceStatus("fresh", 0.2), DeviceStatus("moving", 0.2)):
        lamp = run_text.lamp("rail", device, view, UNICODE)
        assert lamp.plain == "○ Rail 2.3 s"
        assert not any("passed" in str(span.style) for span in lamp.spans)
    view.status_age_s = math.nan
    assert view.stale


def test_a_past_run_has_no_lamps() -> None:
    assert run_text.lamps(view_of("done"), UNICODE, 80).plain.count(" -") == len(run_text.LAMPS)


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
    assert "Rail" not in run_text.lamps(view, UNICODE, 80).plain
    assert "Robot" in run_text.lamps(view, UNICODE, 80).plain
    assert run_text.resume_text(view).startswith("The robot will move")
    assert strip_plot not in [tab.make for tab in tabs_of(log)]


# -- lines -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sample_runs())
def test_no_line_is_wider_than_the_terminal(name: str) -> None:
    view = view_of(name)
    for width in range(20, 201):
        lines = [run_text.progress(view, UNICODE, width), run_text.interlocks(view, width)]
        if width >= 80:
            lines += [
                run_text.banner(view, UNICODE, width),
                run_text.identity(view, width),
                run_text.step(view, width),
                run_text.lamps(view, UNICODE, width),
            ]
        for line in lines:
            assert line.cell_length <= max(width, 40), line.plain


@pytest.mark.parametrize("name", sample_runs())
def test_the_banner_shows_the_state_and_the_warning_of_the_stop(name: str) -> None:
    line = run_text.banner(view_of(name), UNICODE, 80).plain
    assert f"{UNICODE.states[name]} {run_text.STATES[name][0]}" in line
    assert ("LIVE" in line) + ("HISTORIC" in line) == (name != "looking")
    assert ("use the E-stop" if name == "silent" else run_text.NOT_E_STOP) in line
    assert ("SIMULATION" in line) == (name not in ("looking", "idle", "unreadable"))


@pytest.mark.parametrize("name", sample_runs())
@pytest.mark.parametrize("background", ["running", "suspended", "silent"])
def test_a_background_run_is_shown_in_every_state(name: str, background: str) -> None:
    view, behind = view_of(name), view_of(background)
    for width in (80, 120):
        line = run_text.banner(view, UNICODE, width, behind).plain
        assert f"behind: {run_text.STATES[background][0]}" in line
        assert ("use the E-stop" if background == "silent" else "Esc stops") in line
    assert len(run_text.banner(view, UNICODE, 40, behind).plain) <= 60


def test_the_end_of_a_run_behind_names_its_worst_alarm() -> None:
    reported = run_text.end_text(view_of("fault"))
    assert reported.endswith("made-up, has ended: FAULT: HC-T99 Tracker fault")
    assert run_text.end_text(view_of("done")).endswith("has ended: DONE")


def test_a_real_run_is_not_called_a_simulation() -> None:
    view = view_of("running")
    assert view.log.plan is not None
    view.log.plan = msgspec.structs.replace(view.log.plan, simulated=False)
    assert "SIMULATION" not in run_text.banner(view, UNICODE, 80).plain


def test_the_step_is_shown_with_its_count_and_the_next() -> None:
    line = run_text.step(view_of("running"), 80).plain
    assert line.startswith("step 5/7 robot-grid: 5/8, last grid/0-0-4 at S1100")
    assert line.endswith("next: fit")
    assert "next" not in run_text.step(view_of("done"), 80).plain
    assert run_text.step(view_of("checking"), 80).plain == "step: none yet"


def test_a_long_job_leaves_room_for_operator_and_run() -> None:
    view = view_of("running")
    assert view.log.plan is not None
    view.log.plan = msgspec.structs.replace(view.log.plan, job="J" * 500, operator="Ann" * 50)
    line = run_text.identity(view, 100).plain
    assert "operator AnnAnn" in line
    assert "attended" in line
    assert line.endswith(view.run)


def test_a_journal_that_cannot_be_read_says_why() -> None:
    assert run_text.identity(view_of("unreadable"), 80).plain.endswith("damaged or not a journal")


def test_the_newest_deviation_stays_while_points_without_one_are_measured() -> None:
    view = view_of("running")
    story = measuring().point(PointId("control", nest="F1"), commanded_deg=None)
    view.take(story.records[-1])
    assert view.last is not None
    assert view.last.key == "control/F1"
    assert view.newest_target == view.log.points["grid/0-0-4"]


@pytest.mark.parametrize("remaining_s", [None, 0.0, 30.0, 1e9])
def test_the_bar_is_as_long_as_the_share(remaining_s: float | None) -> None:
    view = view_of("running")
    view.elapsed_s, view.remaining_s = 10.0, remaining_s
    share = run_text.share_done(view)
    assert 0.0 <= share <= 1.0
    line = run_text.progress(view, UNICODE, 80).plain
    bar = line.count("█") + line.count("░")
    assert line.count("█") == math.floor(bar * share)
    assert f"{math.floor(100 * share):3d} %" in line


def test_a_run_that_is_over_is_done() -> None:
    assert run_text.share_done(view_of("done")) == run_text.share_done(view_of("intolerant")) == 1.0
    assert run_text.share_done(view_of("fault")) < 1.0
    assert run_text.share_done(view_of("idle")) == 0.0


def test_interlocks_name_the_first_that_is_blocked() -> None:
    view = view_of("running")
    assert "rail move blocked: robot not at safe pose" in run_text.interlocks(view, 80).plain
    assert view.status is not None
    view.status_age_s = 9.0
    assert run_text.interlocks(view, 80).plain == "interlocks: last heard 9.0 s ago"
    view.status = None
    assert run_text.interlocks(view, 80).plain == "interlocks: no reading"


def test_a_finished_run_says_its_figures_there() -> None:
    line = run_text.interlocks(view_of("done"), 80).plain
    assert line == "in tolerance: mean |e| mm  S1100 1.200 -> 0.110"


def test_a_finished_run_says_its_bounds_in_place_of_its_last_point() -> None:
    view = view_of("done")
    assert "last validate" in run_text.step(view, 80).plain
    assert view.log.end is not None
    place = view.log.end["result"]["validation"]["S1100"]
    end = {"result": {"validation": {"S1100": place | {"bounds": BOUNDS}}}}
    view.log.end = view.log.end | end
    line = run_text.step(view, 80).plain
    assert len(line) <= 80
    assert "last" not in line
    assert line.endswith("  S1100: 95 % bound 0.217 mm, 96 % in")


@pytest.mark.parametrize(
    "result",
    [
        {},
        {"validation": {}},
        {"validation": {"S1100": {"points": 2}}},
        {"validation": {"S1100": {"before": {"mean": 1.0}}}},
        {"validation": [1.0]},
        {"validation": {"S1100": {"before": {"mean": None}, "chosen": {"mean": None}}}},
    ],
)
def test_a_result_of_another_kind_says_nothing_there(result: dict[str, object]) -> None:
    view = view_of("done")
    view.log.end = {"state": "finished", "exit": 0, "result": result}
    assert run_text.result(view, 80).plain == ""


@pytest.mark.parametrize("kind", ["recheck", "targets"])
def test_a_result_in_words_is_shown_as_far_as_it_fits(kind: str) -> None:
    view = view_of("done")
    words = {kind: {"text": "Still valid: the errors are as predicted;\x1b[31m drift 0.000 mm."}}
    view.log.end = {"state": "finished", "exit": 0, "result": words}
    line = run_text.result(view, 40).plain
    assert line.startswith("Still valid: the errors are as predict")
    assert len(line) == 40
    assert "\x1b" not in run_text.result(view, 80).plain


# -- air -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("drift_k", "warns"), [(0.0, False), (2.0, False), (2.1, True), (-2.1, True), (math.nan, True)]
)
def test_the_air_warns_when_it_drifts(drift_k: float, warns: bool) -> None:
    view = view_of("running")
    assert view.last is not None
    view.last = msgspec.structs.replace(view.last, temperature_c=22.5 + drift_k)
    assert run_text.air(view, UNICODE).plain.startswith("! ") == warns


def test_a_tracker_without_a_weather_station_is_reported() -> None:
    view = view_of("running")
    assert view.last is not None
    view.last = msgspec.structs.replace(view.last, temperature_c=None)
    assert run_text.air(view, UNICODE).plain == "air not measured"


# -- deviation -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("norm_mm", "limit_mm", "U_mm", "said"),
    [
        (0.5, None, 0.0, "no limit"),
        (0.5, 1.0, 0.1, "] in 1.000 mm, U 0.100  p"),
        (1.5, 1.0, 0.1, "] OUT OF 1.000 mm, U 0.100  p"),
        (0.95, 1.0, 0.1, "] UNSURE 1.000 mm"),
        (1.05, 1.0, 0.1, "] UNSURE 1.000 mm"),
        (math.nan, 1.0, 0.1, "] OUT OF 1.000 mm"),
        (math.inf, 1.0, 0.1, "] OUT OF 1.000 mm"),
        (1e9, 1.0, 0.0, "] OUT OF 1.000 mm"),
        (0.0, 1.0, 0.0, "] in 1.000 mm"),
    ],
)
def test_the_tolerance_bar(norm_mm: float, limit_mm: float | None, U_mm: float, said: str) -> None:
    """It says what the decision rule says of mean and largest error."""
    found = Deviation("p", (norm_mm, 0.0, 0.0), (0.0, 0.0, 0.0), limit_mm, U_mm)
    for glyphs in (UNICODE, ASCII):
        assert said in tolerance_line(found, glyphs, 80).plain
        assert len(deviation_lines(found, glyphs, 80).plain.split("\n")) == 5


@given(ANY, ANY, ANY, st.one_of(st.none(), st.floats(1e-3, 1e3)))
def test_any_deviation_can_be_shown(dx: float, dy: float, dz: float, limit: float | None) -> None:
    found = Deviation("p", (dx, dy, dz), (0.0, 0.0, 0.0), limit)
    assert len(deviation_lines(found, UNICODE, 80).plain.split("\n")) == 5


def test_the_mark_crosses_the_limit_with_the_error() -> None:
    lines = [
        tolerance_line(Deviation("p", (e, 0, 0), (0, 0, 0), 1.0), UNICODE, 80).plain
        for e in (0.9, 1.1)
    ]
    assert lines[0].index("▼") < lines[0].index("|")
    assert lines[1].index("▼") > lines[1].index("|")


# -- large digits -------------------------------------------------------------------------------


def test_every_digit_looks_different() -> None:
    assert len({large_digits(letter) for letter in "0123456789+-. "}) == 14


@given(st.text("0123456789+-. ", max_size=12))
def test_large_rows_are_of_one_length(text: str) -> None:
    assert len({len(row) for row in large_digits(text)}) == 1


@pytest.mark.parametrize("text", ["nan", "+inf", "-inf"])
def test_what_is_no_number_can_be_shown(text: str) -> None:
    assert len({len(row) for row in large_digits(text)}) == 1


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
    for record in sample_runs()["idle"].records:
        view.take(record)
    assert (view.log.plan, view.state) == (None, "idle")
    plan, *_ = sample_runs()["running"].records
    view.take(plan)
    assert view.state == "gone"
    end = {"state": "idle", "exit": 6, "reason": "the cell is in use", "result": {}}
    view.take(Record(2, plan.t, "end", "", end))
    assert view.state == "idle"
