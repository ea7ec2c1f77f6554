"""The run's screen as text."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from datetime import timedelta
from typing import Any

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
from hilcell.model.verdicts import Verdict
from hilcell.run.control import DeviceStatus, Interlock
from hilcell.run.forecast import Forecast, RemainingSpan, SpanProgress
from hilcell.tui.layout import Stack, figure, large, large_rows
from hilcell.tui.plots import PlotStyle
from hilcell.tui.run_view import EngineState, RunView
from hilcell.tui.screens.start import Checked
from hilcell.tui.terminal import ASCII, UNICODE, to_ascii
from hilcell.tui.text import devices
from hilcell.tui.text import run as run_text
from hilcell.tui.text.devices import DeviceText
from hilcell.tui.text.plots import Measured, tabs_for
from hilcell.tui.text.points import WIDE, Deviation, PointRows, point_columns
from hilcell.tui.text.run import RunText, Shown
from hilcell.tui.text.side import side_lines
from tests.hilcell.tui.all_screens import isolated
from tests.hilcell.tui.recording_app import Press, Stage, on_screen, press, text_of
from tests.hilcell.tui.sample_runs import (
    SampleRun,
    measuring,
    sample_run,
    sample_runs,
    status,
    validated,
)
from tests.hilcell.tui.views import cells, drawn, view_of
from tests.hilcell.verdicts import BACKLASH, JUDGED, LENGTHS, REVISITED, plain

ANY = st.floats(allow_nan=True, allow_infinity=True)
BOUNDS = {"coverage": 0.963, "mean_mm": 0.2171, "max_mm": 0.3}


# -- durations and ages ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("seconds", "wanted"),
    [(0, "0:00"), (-3, "0:00"), (0.6, "0:01"), (59.4, "0:59"), (59.6, "1:00"), (61, "1:01"),
     (3599, "59:59"), (3600, "1:00:00"), (86399, "23:59:59"), (100 * 3600, "100:00:00"),
     (math.nan, "-:--"), (math.inf, "-:--"), (-math.inf, "-:--")],
)  # fmt: skip
def test_durations(seconds: float, wanted: str) -> None:
    assert run_text.duration(seconds) == wanted


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
    assert run_text.planned_sweeps([PlannedStep("axis-sweeps", 0, 540.0, spans)]) == 8
    assert run_text.planned_sweeps([PlannedStep("home", 0, 0.0)]) == 0
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
    view = view_in(story)
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
    ("celsius", "begin"),
    [(22.5, "22.5 °C"), (24.5, "24.5 °C"), (24.6, "▲ "), (20.4, "▲ "), (math.nan, "▲ "),
     (None, "air not measured")],
)  # fmt: skip
def test_the_air_warns_when_it_drifts(celsius: float | None, begin: str) -> None:
    view = view_of("running")
    assert view.last is not None
    view.last = msgspec.structs.replace(view.last, temperature_c=celsius)
    assert DeviceText(view).air().plain.startswith(begin)


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


def view_in(story: SampleRun, state: str = "running", age_s: float = 0.4) -> RunView:
    """Return a live run's view some time after its last record."""
    view = RunView("r", engine=EngineState.ANSWERING, status=status(state))
    for record in story.records:
        view.take(record)
    view.now = story.now + timedelta(seconds=age_s - 1.0)
    return view


def shown(norm_mm: float, limit_mm: float | None = 1.0, U_mm: float = 0.1, **more: bool) -> Shown:
    found = Deviation("p", (norm_mm, 0.0, 0.0), (0.0, 0.0, 0.0), limit_mm, U_mm)
    return Shown("newest point: p", found, "0.4 s ago", word="as sent: no limit", **more)


@pytest.mark.parametrize(
    ("norm_mm", "limit_mm", "said", "style"),
    [
        (0.5, None, "○ as sent: no limit", "foreground"),
        (0.5, 1.0, "● in tolerance", "passed"),
        (1.5, 1.0, "▲ OUT OF TOLERANCE", "fault"),
        (0.95, 1.0, "▲ UNDECIDED", "ask"),
        (1.05, 1.0, "▲ UNDECIDED", "ask"),
        (math.nan, 1.0, "▲ OUT OF TOLERANCE", "fault"),
        (math.inf, 1.0, "▲ OUT OF TOLERANCE", "fault"),
    ],
)
def test_it_says_what_the_decision_rule_says(
    norm_mm: float, limit_mm: float | None, said: str, style: str
) -> None:
    lines = shown(norm_mm, limit_mm).lines(UNICODE).lines(79)
    assert len(lines) == Shown.FULL_ROWS
    assert lines[4].plain.strip().startswith(said)
    assert style in str(lines[1].spans)  # the digits


@pytest.mark.parametrize(
    ("norm_mm", "word"), [(0.5, "was in tol."), (1.5, "was out of tol."), (0.95, "was undecided")]
)
def test_an_old_value_is_grey_and_says_that_it_was(norm_mm: float, word: str) -> None:
    lines = shown(norm_mm, stale=True).lines(UNICODE).lines(79)
    assert f"○ {word}" in lines[4].plain
    for line in lines[1:5]:
        for role in ("passed", "fault"):
            assert role not in str(line.spans)
    assert "▲ 0.4 s ago" in lines[0].plain


def test_the_newest_point_ages() -> None:
    assert Shown.newest(view_in(validated())).remark == "0.4 s ago"
    assert not Shown.newest(view_in(validated())).stale
    found = Shown.newest(view_in(validated(), age_s=Shown.STALE_S + 6))
    assert (found.stale, found.remark) == (True, "36 s old")


def test_a_point_is_not_bright_where_nothing_is_heard() -> None:
    view = view_in(validated())
    view.status_age_s = 2.1
    assert Shown.newest(view).stale


def test_the_digits_of_a_step_before_are_grey() -> None:
    found = Shown.newest(view_in(validated().step(7)))
    assert not found.stale
    found = Shown.newest(view_in(measuring().step(6)))
    assert found.stale
    assert found.name.startswith("last point: grid point 0-0-4")


def test_a_point_without_a_nominal_place_has_no_digits_of_the_one_before() -> None:
    story = measuring().point(PointId("repeatability", place=0, number=2), None)
    found = Shown.newest(view_in(story))
    assert found.deviation is None
    text = drawn(found.lines(UNICODE))
    assert "repeated pose 1 3 at S1100" in text
    assert "no nominal place, so no deviation" in text
    assert "█" not in text


def test_a_chosen_point_says_that_it_is_chosen() -> None:
    view = view_in(validated())
    found = Shown.chosen(view, "validate/S1100/idw/000")
    assert found.name == "chosen point: target 1 at S1100, paper method"
    assert found.word == "paper method: no limit"
    assert Shown.chosen(view, "none").deviation is None
    found = Shown.chosen(view, "grid/0-0-4", chosen=False)  # nobody chose it
    assert found.name == "last point: grid point 0-0-4 at S1100"


@given(ANY, ANY, ANY, st.one_of(st.none(), st.floats(1e-3, 1e3)), st.integers(20, 200))
def test_any_deviation_fits_any_width(
    dx: float, dy: float, dz: float, limit: float | None, width: int
) -> None:
    found = Deviation("p", (dx, dy, dz), (0.0, 0.0, 0.0), limit)
    for rows in (Shown.FULL_ROWS, Shown.FULL_ROWS - 1, Shown.SMALL_ROWS):
        for glyphs in (UNICODE, ASCII):
            lines = Shown("p", found, "").lines(glyphs, rows).lines(width)
            assert len(lines) <= rows
            assert max(line.cell_length for line in lines) <= max(width, 20)


@pytest.mark.parametrize("width", [20, 39, 41, 45, 60])
def test_digits_are_never_cut(width: int) -> None:
    text = drawn(shown(12.345).lines(UNICODE), width)
    assert "12.345" in text or "▄█  ▀▀█   ▀▀█ █ █ █▀▀" in text


@pytest.mark.parametrize(
    ("error_mm", "scale"),
    [((0.0, 0.0, 0.1), "±0.2"), ((0.2, -0.51, 0.0), "±1"), ((math.nan, -math.inf, 3.0), "±5")],
)
def test_bars_have_a_scale_of_1_2_5_that_holds_them(
    error_mm: tuple[float, float, float], scale: str
) -> None:
    found = Deviation("p", error_mm, (0.0, 0.0, 0.0), 0.3)
    assert scale in drawn(Shown("p", found, "").lines(UNICODE)).split()


@pytest.mark.parametrize(("U_mm", "hatched"), [(0.0, 0), (0.1, 9), (math.nan, 0), (9.0, 32)])
def test_the_guard_band_is_hatched_around_the_limit(U_mm: float, hatched: int) -> None:
    line = shown(0.5, U_mm=U_mm).lines(UNICODE).lines(79)[4].plain
    assert line.count("▒") == hatched
    assert "│" in line
    if hatched == 9:
        assert "▒▒▒▒│▒▒▒▒" in line


__all__ = ["isolated"]

pytestmark = pytest.mark.usefixtures("isolated")


@on_screen("fault")
async def test_a_point_is_chosen_only_by_somebody(app: Stage, pilot: Press) -> None:
    await press(pilot, "b", "b")  # the points, in place of an alarm
    assert "last point: grid point 0-0-4" in text_of(app)
    await press(pilot, "up")
    assert "chosen point: grid point 0-0-3" in text_of(app)


@on_screen("checking", size=(80, 24))
async def test_the_space_bar_promises_nothing_while_an_engine_starts(
    app: Stage, pilot: Press
) -> None:
    assert "space  pause" in text_of(app)
    assert "go on" not in text_of(app)


def test_events_go_first_then_steps() -> None:
    view = view_in(measuring())
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
    lines = drawn(Stack(*RunText(view_in(measuring()), UNICODE).interlocks())).splitlines()
    assert lines[1].split()[:3] == ["■", "Rail", "locked"]
    assert "robot not at safe pose, A2 −53.017 deg" in lines[1]
    assert "Robot   free   slide 1100.20 mm, held, strip 1100.00 mm" in lines[2]
    assert "Tracker free   last reading SMR 1.5in" in lines[3]


@pytest.mark.parametrize("name", ["running", "paused", "suspended"])
def test_row_panel_and_page_say_the_same_of_each_interlock(name: str) -> None:
    view = view_in(sample_run(name), name)
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
    view = view_in(measuring())
    assert view.status is not None
    why = "robot not at safe pose, A2 -41.381 deg, expected -100.000 +-0.1 deg"
    locked = [Interlock("rail move", why, "HC-B32")]
    view.status = msgspec.structs.replace(view.status, interlocks=locked)
    lines = drawn(Stack(*RunText(view).interlocks()), width).splitlines()
    assert lines[1].rstrip() == " ■ Rail    locked robot not at safe pose"
    assert "A2 −41.381 deg, expected −100.000 ±0.1 deg" in DeviceText(view).interlock_page().plain


def test_a_stale_status_frees_nothing() -> None:
    view = view_in(measuring())
    view.status_age_s = 60.0
    text = drawn(Stack(*RunText(view).interlocks()))
    assert "free" not in text
    assert "no reading" in text


def test_steps_start_one_after_the_other() -> None:
    view = view_in(measuring())
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
    story.add("intent", "grid/9-9-9", action="robot.move")  # its point is not measured yet
    story.point(PointId("grid", vertex=(8, 8, 8)))
    view = view_in(story)
    errors = {"validate/S1100/chosen/001": 0.1005}
    words = [RunText(view).event_text(record, errors) for record in story.records]
    assert words[-3:] == [
        "measured corrected target 2 at S1100: |e| 0.101 mm",
        "robot sent to grid point 9-9-9 at S1100",
        "measured grid point 8-8-8 at S1100",
    ]
    assert "rail held at S1100: 1100.00 mm by the strip, 2nd approach" in words
    assert "robot sent to grid point 0-0-3 at S1100" in words
    assert "the run is running" in words
    assert not any(text.startswith("plan") for text in words)


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
    view = view_in(measuring())
    for body, token in happened:
        record = Record(1, "2026-03-04T08:00:00.000+00:00", "event", "", body)
        words = RunText(view).event_text(record, {})
        assert token in words
        assert not set("{}[]/_") & set(words)
    healthy = {"what": "link", "frames": 9, "bad_lines": 0, "refused": 0, "malformed": 0}
    assert RunText(view).event_text(Record(1, "", "event", "", healthy), {}) == ""


WITHIN = msgspec.structs.replace(JUDGED, mean_mm=0.033, mean_tolerance_mm=0.12)


@pytest.mark.parametrize(
    ("key", "verdict", "words"),
    [
        ("validation.S1100", WITHIN, "validation at S1100 passes: mean 0.033 mm, limit 0.120 mm"),
        ("validation.others", WITHIN,
         "validation at the other stations passes: mean 0.033 mm, limit 0.120 mm"),
        ("known-length", LENGTHS, "known length passes"),
        ("revisits.closing", msgspec.structs.replace(REVISITED, holds=False),
         "revisited poses at the end fails"),
        ("backlash", BACKLASH,
         "backlash of the rail passes: backlash 0.200 mm, limit 0.400 mm"),
    ],
)  # fmt: skip
def test_a_verdict_has_the_name_of_its_subject(key: str, verdict: Verdict, words: str) -> None:
    record = SampleRun().add("verdict", key, **plain(verdict)).records[-1]
    assert RunText(view_in(measuring())).event_text(record, {}) == words


def test_a_run_of_which_only_the_plan_is_known_has_no_events_yet() -> None:
    story = measuring()
    story.records = story.records[:1]
    text = drawn(RunText(view_in(story)).below({}, 17))
    assert text.splitlines()[-1].startswith("─ newest events ─")


SHEET = """
█▀█ ▄█  ▀▀█ ▀▀█ █ █ █▀▀ █▀▀ ▀▀█ █▀█ █▀█
█ █  █  █▀▀  ▀█ ▀▀█ ▀▀█ █▀█   █ █▀█ ▀▀█
▀▀▀ ▀▀▀ ▀▀▀ ▀▀▀   ▀ ▀▀▀ ▀▀▀   ▀ ▀▀▀ ▀▀▀
"""


def test_digits_are_as_drawn_and_no_two_signs_look_alike() -> None:
    assert [row.rstrip() for row in large_rows("0123456789")] == SHEET.strip().splitlines()
    signs = "012346789+-.,PASFILNCHGÜU "
    assert len({large_rows(sign) for sign in signs}) == len(signs)
    with pytest.raises(KeyError):
        large_rows("0;1")


@pytest.mark.parametrize("text", ["0.189", "-1.234", "+0.5", "PASS", "FAIL", "-.---", "−0.1"])
def test_rows_are_of_equal_length(text: str) -> None:
    rows = large_rows(text)
    assert len(rows) == 3
    assert len({len(row) for row in rows}) == 1
    assert [len(line) for line in large(text, "", UNICODE)] == [len(rows[0])] * 3


def test_in_ascii_it_is_one_bold_line() -> None:
    lines = [line.plain for line in large("0.189", "$passed", ASCII)]
    assert lines == ["     ", "0.189", "     "]


@pytest.mark.parametrize("value_mm", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_shown_as_none(value_mm: float) -> None:
    assert large_rows(figure(value_mm)) == large_rows("-.---")
    assert figure(0.1886) == "0.189"


@pytest.mark.parametrize("scale", [1.0, 10.0, 100.0])
def test_places_fit_their_columns(scale: float) -> None:
    far = (-1506.1234 * scale, -1234.5678 * scale, -1998.7654 * scale)
    for row in PointRows().rows(view_of("done").log):
        deviation = row.deviation and replace(row.deviation, actual_mm=far)
        point = msgspec.structs.replace(row.point, nominal_mm=far, xyz_mm=far)
        found = replace(row, point=point, deviation=deviation)
        for column, cell in cells(point_columns(), found, WIDE + 20).items():
            assert len(cell) <= column.width, (column.title, cell)


@pytest.mark.parametrize("width", [14, 16, 19, 24, 30, 40, 58])
def test_the_side_panel_cuts_no_number(width: int) -> None:
    view = view_of("done")
    rows = [*PointRows().rows(view.log)]
    lines, _ = side_lines(view, rows, width, 29, PlotStyle())
    text = "\n".join(line.plain for line in lines)
    wide, _ = side_lines(view, rows, 58, 29, PlotStyle())
    means = {word for line in wide if "mean" in line.plain for word in line.plain.split()}
    legend = next(line.plain for line in lines if "mean" in line.plain)
    assert legend.rstrip().split("mean ")[-1].split()[0] in means
    assert "targe\n" not in text
    assert max(line.cell_length for line in lines) <= width


def test_a_refusal_is_whole_where_there_is_room() -> None:
    reason = (
        "Paper's campaign refused before anything moves: this cell has no rail, "
        "its robot stands still"
    )
    lines = Checked(refused=reason).check_lines(UNICODE).lines(40, 8)
    assert reason in " ".join(" ".join(line.plain for line in lines).split())
