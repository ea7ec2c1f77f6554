"""Actions of the screen, why they are refused, and the notices they leave."""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import msgspec
import pytest

from hilcell.run.control import Choice
from hilcell.tui.keys import ACTIONS
from hilcell.tui.run_view import EngineState, RunView
from hilcell.tui.screens.base import BaseScreen, Confirm
from hilcell.tui.screens.pages import DetailPage, HistoryPage, LogPage
from hilcell.tui.screens.run import RunScreen
from hilcell.tui.screens.start import PlanSummary, StartScreen
from hilcell.tui.session import RunUpdate, Session
from hilcell.tui.text.actions import ACTS, AT_REST, ONE_AT_A_TIME, VIEWS, pause_command, refusal
from hilcell.tui.widgets import Table
from tests.hilcell.tui.all_screens import isolated
from tests.hilcell.tui.recording_app import (
    PAGES,
    RUNS,
    Press,
    RecordingApp,
    RecordingSession,
    Stage,
    footer,
    on_screen,
    press,
    run_app,
    settle,
    text_of,
    type_ahead,
)
from tests.hilcell.tui.sample_runs import (
    HEARD,
    LIVE,
    PROMPT,
    fresh,
    measuring,
    sample_run,
    sample_runs,
    status,
)

__all__ = ["isolated"]

STATES = tuple(sample_runs())
OVER = tuple(state for state in STATES if state not in LIVE)
# What the space bar does: the command posted, whether it asks before, and the word in the footer.
SPACE = {
    "idle": None,
    "looking": None,
    "checking": None,
    "running": ("pause", False, "pause"),
    "pausing": ("proceed", True, "go on"),
    "paused": ("proceed", True, "go on"),
    "suspended": ("answer", False, "answer"),
    "stopping": None,
    "silent": None,
    "done": None,
    "intolerant": None,
    "aborted": ("resume", True, "resume"),
    "fault": ("resume", True, "resume"),
    "refused": ("resume", True, "resume"),
    "gone": ("resume", True, "resume"),
    "unreadable": None,
}
pytestmark = pytest.mark.usefixtures("isolated")


# -- what is allowed, and what is shown ------------------------------------------------------------


def allowed(state: str) -> set[str]:
    """Return the actions that a state allows on the run's screen."""
    found = {"history", "theme", "help", "quit", "find"}
    if state not in ("idle", "unreadable", "looking"):
        found |= {"alarms", "plots", "interlocks", "log", "report"}
        found |= {"bad", "sort", "retake"}
    if SPACE[state] is not None:
        found.add("pause")
    found |= {"stop", "detach"} if state in LIVE else {"new", "commission"}
    found |= {"abort"} if state in HEARD else set()
    found -= {"retake"} if state in ("silent", "checking", "refused") else set()
    if state in ("suspended", "aborted", "fault", "refused", "gone", "intolerant"):
        found.add("acknowledge")
    return found


@pytest.mark.parametrize("state", STATES)
@on_screen()
async def test_what_each_state_allows(app: Stage, pilot: Press, state: str) -> None:
    """The keys that are shown, the space bar, the stop and the abort, one after the other."""
    the_footer_shows_what_is_allowed_and_nothing_else(app, state)
    await the_space_bar_pauses_goes_on_or_resumes(app, pilot, state)
    app.recorded.asked.clear()
    await a_live_run_is_stopped_at_once_and_aborted_after_a_question(app, pilot, state)


def the_footer_shows_what_is_allowed_and_nothing_else(app: RecordingApp, state: str) -> None:
    wanted, screen = allowed(state), app.screen
    assert isinstance(screen, RunScreen)
    assert {action.name for action in ACTIONS if app.allowed(action.name)} == wanted
    for slot in (*ACTS, *VIEWS):
        name = "new" if slot == "detach" and "detach" not in wanted else slot
        assert screen.footer_key(slot).works == (name in wanted), slot
    assert screen.footer_key("stop").works == ("stop" in wanted)
    space = SPACE[state]
    assert space is None or screen.footer_key("pause").word == space[2]


async def the_space_bar_pauses_goes_on_or_resumes(app: Stage, pilot: Press, state: str) -> None:
    await press(pilot, "space")
    space = SPACE[state]
    assert isinstance(app.screen, Confirm) == (space is not None and space[1])
    if isinstance(app.screen, Confirm):
        assert (app.recorded.asked, app.engines) == ([], [])
        await press(pilot, "n")
        assert (app.recorded.asked, app.engines) == ([], [])
        await press(pilot, "space", "y")
    reported = space is not None and space[0] != "resume"
    assert app.recorded.asked == ([(space[0], {})] if space is not None and reported else [])
    assert bool(app.engines) == (space is not None and space[0] == "resume")
    assert app.recorded.stops == 0


async def a_live_run_is_stopped_at_once_and_aborted_after_a_question(
    app: Stage, pilot: Press, state: str
) -> None:
    live, heard = state in LIVE, state in HEARD
    await press(pilot, "escape")
    assert isinstance(app.screen, RunScreen)
    await press(pilot, "a")
    assert isinstance(app.screen, Confirm) == heard
    if heard:
        await press(pilot, "q")
        assert app.recorded.asked == []
        await press(pilot, "a", "enter")
    else:
        assert "abort: " in text_of(app)
    assert app.recorded.stops == (1 if live else 0)
    assert app.recorded.asked == ([("abort", {})] if heard else [])


# -- the space bar ---------------------------------------------------------------------------------


@on_screen("running")
async def test_the_space_bar_pauses_from_every_page_that_says_so(app: Stage, pilot: Press) -> None:
    for key in "eilp":
        await press(pilot, key)
        assert "space" in footer(app)
        await press(pilot, "space", "q")
    assert app.recorded.asked == [("pause", {})] * 4


@on_screen("running")
async def test_a_key_held_down_opens_its_page_once(app: Stage, pilot: Press) -> None:
    depth = len(app.screen_stack)
    for key in ("e", "h"):
        type_ahead(app, *[key] * 4)
        await settle(pilot)
        assert len(app.screen_stack) == depth + 1, key
        assert isinstance(app.screen, PAGES[key])
        await press(pilot, "q")


@on_screen("fault")
async def test_keys_typed_ahead_of_a_page_s_end_act_in_their_order(
    app: Stage, pilot: Press
) -> None:
    for number, key in enumerate(("l", "h")):
        await press(pilot, key)
        type_ahead(app, "q", "space")
        await settle(pilot)
        assert [type(each) for each in app.screen_stack[-2:]] == [RunScreen, Confirm], key
        type_ahead(app, "q", "h", "q", "space", "enter")
        await settle(pilot)
        assert isinstance(app.screen, Confirm), key  # it moves the machine: not in one burst
        assert len(app.engines) == number
        await press(pilot, "enter")
        assert len(app.engines) == number + 1


@on_screen("running")
async def test_pages_turned_in_a_circle_are_not_piled_up(app: Stage, pilot: Press) -> None:
    depth = len(app.screen_stack)
    await press(pilot, *["h", "question_mark", "l"] * 2)
    assert len(app.screen_stack) == depth + 3
    assert isinstance(app.screen, LogPage)


@on_screen("gone")
async def test_a_lasting_trouble_does_not_replace_other_notices(app: Stage, pilot: Press) -> None:
    trouble = RunUpdate([], trouble="the journal is gone")
    app.show_notice("the engine ended, exit 7")
    app.receive(app.recorded, trouble)
    await settle(pilot)
    assert "exit 7" in text_of(app)
    await press(pilot, "w")
    app.receive(app.recorded, trouble)
    await settle(pilot)
    assert "the journal is gone" in text_of(app)


@pytest.mark.parametrize("key", ["a", "ctrl+q"])
@on_screen("running")
async def test_a_question_about_a_run_ends_with_it(app: Stage, pilot: Press, key: str) -> None:
    await press(pilot, key)
    assert isinstance(app.screen, Confirm)
    app.receive(app.recorded, RunUpdate([], engine=EngineState.ANSWERING))
    await settle(pilot)
    assert isinstance(app.screen, Confirm)
    app.receive(app.recorded, RunUpdate([], engine=EngineState.NONE))
    await settle(pilot)
    assert isinstance(app.screen, RunScreen)


@on_screen("suspended")
async def test_a_notice_about_a_state_ends_with_it(app: Stage, pilot: Press) -> None:
    for ready in (False, False, True):
        prompt = msgspec.structs.replace(PROMPT, ready=ready)
        said = msgspec.structs.replace(status("suspended"), prompt=prompt)
        update = RunUpdate([], engine=EngineState.ANSWERING, status=said)
        app.receive(app.recorded, update)
        await settle(pilot)
        if not ready:
            await press(pilot, "enter")
        assert ("Enter works once" in text_of(app)) is not ready


# -- stop ------------------------------------------------------------------------------------------


PLACES: dict[str, tuple[str, ...]] = {
    "the run": (),
    "a filter": ("slash", "a", "b"),
    "the log's filter": ("l", "slash", "x"),
    "the history's filter": ("h", "slash", "x"),
    "a point": ("home", "enter"),
    "the palette": ("ctrl+p", "a"),
    "a question": ("a",),
    "a question over a page": ("p", "ctrl+q"),
    "a comparison": ("h", "x", "down", "x", "c"),
    **{f"page {key}": (key,) for key in PAGES},
}


@on_screen("running")
async def test_escape_stops_from_everywhere_and_never_asks(app: Stage, pilot: Press) -> None:
    home = app.screen
    for number, (place, keys) in enumerate(PLACES.items(), start=1):
        await press(pilot, *keys, "escape")
        assert app.recorded.stops == number, place
        assert isinstance(app.screen, BaseScreen), place
        assert "STOP" in text_of(app), place
        assert app.glyphs.states["running"] in text_of(app).splitlines()[0], place
        while app.screen is not home:
            app.pop_screen()
            await settle(pilot)
        home.query_one(Table).focus()
    assert app.recorded.asked == []


@pytest.mark.parametrize("heard", [True, False])
def test_a_stop_that_has_ended_its_engine_is_no_stop_that_nobody_hears(
    heard: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def act(app: Stage, pilot: Press) -> None:
        app.recorded.stop_received = heard  # by the stop of the key's own thread
        await press(pilot, "escape")
        assert ("stopped: " in text_of(app)) is heard
        assert ("no engine" in text_of(app)) is not heard

    monkeypatch.setattr(RecordingSession, "stop", lambda self: False)
    run_app(act, "running")


@on_screen("running", size=(80, 24))
async def test_a_notice_is_seen_on_every_page(app: Stage, pilot: Press) -> None:
    for key in PAGES:
        await press(pilot, key)
        app.show_notice("something happened")
        await settle(pilot)
        assert "something happened" in text_of(app), key
        await press(pilot, "q")


@on_screen("suspended")
async def test_escape_stops_over_a_prompt(app: Stage, pilot: Press) -> None:
    await press(pilot, "escape")
    assert (app.recorded.stops, app.recorded.asked) == (1, [])


@on_screen()
async def test_escape_leaves_the_plan_without_a_start(app: Stage, pilot: Press) -> None:
    await press(pilot, "enter")
    assert isinstance(app.screen, PlanSummary)
    await press(pilot, "escape")
    assert isinstance(app.screen, StartScreen)
    await press(pilot, "escape")
    assert isinstance(app.screen, StartScreen)


# -- abort, detach, quit ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "place"), [("ctrl+q", ("slash", "a")), ("ctrl+c", ("ctrl+p",)), ("ctrl+q", ("a",))]
)
def test_quitting_over_a_live_run_offers_to_detach(key: str, place: tuple[str, ...]) -> None:
    async def act(app: Stage, pilot: Press) -> None:
        await press(pilot, *place, key)
        assert isinstance(app.screen, Confirm)
        assert "detach" in text_of(app)
        assert app.recorded.closed == []
        await press(pilot, key)  # pressed again, it still asks, and only once
        assert sum(isinstance(each, Confirm) for each in app.screen_stack) == 1
        await press(pilot, "n")
        assert app.is_running
        await press(pilot, key)
        await press(pilot, "y")

    app = run_app(act, "running")
    assert app.recorded.closed == [True]
    assert (app.recorded.stops, app.recorded.asked) == (0, [])
    assert app.return_value == 0


def test_quitting_over_a_past_run_just_quits() -> None:
    async def act(app: Stage, pilot: Press) -> None:
        await pilot.press("ctrl+q")

    app = run_app(act, "gone")
    assert (app.return_value, app.recorded.closed) == (0, [True])


def test_detaching_leaves_on_purpose() -> None:
    async def act(app: Stage, pilot: Press) -> None:
        await pilot.press("d")

    app = run_app(act, "running")
    assert (app.return_value, app.recorded.closed, app.recorded.stops) == (0, [True], 0)


def test_a_new_run_is_begun_over_a_past_one_only() -> None:
    async def past(app: Stage, pilot: Press) -> None:
        await press(pilot, "n")
        assert isinstance(app.screen, StartScreen)

    async def live(app: Stage, pilot: Press) -> None:
        await press(pilot, "n")
        assert isinstance(app.screen, RunScreen)

    assert run_app(past, "done").recorded.closed == [True]
    assert run_app(live, "running").recorded.closed == []


def test_looking_at_another_run_over_a_live_one_asks() -> None:
    async def act(app: Stage, pilot: Press) -> None:
        home = app.screen
        await press(pilot, "h", "down", "enter")
        assert "show the other run" in text_of(app)
        await press(pilot, "n")
        assert type(app.screen) is HistoryPage
        await press(pilot, "home", "enter")  # the run that is shown: back to it
        assert app.screen is home

    assert run_app(act, "running").recorded.closed == []


# -- the prompt ------------------------------------------------------------------------------------


def asking(**more: object) -> RunUpdate:
    """Return a run whose prompt differs from the usual one."""
    found = fresh("suspended")
    assert found.status is not None
    prompt = msgspec.structs.replace(PROMPT, **more)
    return replace(found, status=msgspec.structs.replace(found.status, prompt=prompt))


@pytest.mark.parametrize(
    ("update", "answered"),
    [(asking(), True), (asking(ready=False), False), (asking(ready=False, check=False), True)],
    ids=["ready", "too far", "no check"],
)
@on_screen(size=(80, 24))
async def test_enter_answers_a_prompt_only_when_it_is_ready(
    app: Stage, pilot: Press, update: RunUpdate, answered: bool
) -> None:
    await press(pilot, "enter")
    assert isinstance(app.screen, RunScreen)
    assert ("Enter works once" in text_of(app)) is not answered
    assert app.recorded.asked == ([("answer", {})] if answered else [])


CHOICES = (
    Choice("release", "let go of the beam, to put it on the nest by hand"),
    Choice("here", "take the place where the tracker points now"),
    Choice("wider", "search 300 mm around"),
)


@pytest.mark.parametrize("size", [(80, 24), (120, 40)])
def test_a_digit_answers_by_a_choice_of_the_prompt_though_nothing_is_seen(
    size: tuple[int, int],
) -> None:
    async def act(app: Stage, pilot: Press) -> None:
        shown = text_of(app)
        for choice in CHOICES:
            assert choice.text[:20] in shown
        await press(pilot, "2")
        assert app.recorded.asked == [("answer", {"choice": "here"})]

    run_app(act, update=asking(ready=False, seen_mm=None, choices=CHOICES), size=size)


@on_screen("suspended")
async def test_a_digit_without_a_choice_answers_nothing(app: Stage, pilot: Press) -> None:
    await press(pilot, "1", "2", "3")
    assert app.recorded.asked == []


@on_screen("suspended")
async def test_enter_in_the_filter_answers_no_prompt(app: Stage, pilot: Press) -> None:
    await press(pilot, "slash", "g", "enter")
    assert app.recorded.asked == []


# -- measuring again -------------------------------------------------------------------------------


@pytest.mark.parametrize("state", ["running", "gone"])
@on_screen()
async def test_a_point_is_re_measured_after_a_question(
    app: Stage, pilot: Press, state: str
) -> None:
    await press(pilot, "end", "r")
    assert isinstance(app.screen, Confirm)
    assert "grid point 0-0-4" in text_of(app)
    await press(pilot, "n", "r", "y")
    if state in LIVE:
        assert app.recorded.asked == [("retake", {"key": "grid/0-0-4"})]
        waiting = msgspec.structs.replace(status(state), retakes=["grid/0-0-4"])
        app.receive(app.recorded, RunUpdate([], EngineState.ANSWERING, waiting))
        await settle(pilot)
        assert text_of(app).count("○ waits") == 1
    else:
        assert [words[-2:] for _, words in app.engines] == [["--retake", "grid/0-0-4"]]


@pytest.mark.parametrize("unattended", [True, False])
@on_screen("gone")
async def test_a_run_is_resumed_as_it_was_begun(app: Stage, pilot: Press, unattended: bool) -> None:
    log = app.recorded.view.log
    log.plan = msgspec.structs.replace(log.inputs, unattended=unattended)
    await press(pilot, "space", "enter")
    [(folder, words)] = app.engines
    assert words[:4] == ["resume", folder.name, "--runs", str(folder.parent)]
    assert ("--unattended" in words) == unattended


@on_screen("running")
async def test_a_point_that_may_not_be_re_measured_says_why(app: Stage, pilot: Press) -> None:
    await press(pilot, "home", "r")
    assert isinstance(app.screen, RunScreen)
    assert "floor nest F1: " in text_of(app)
    assert app.recorded.asked == []


@on_screen("running")
async def test_a_point_is_re_measured_from_its_own_page(app: Stage, pilot: Press) -> None:
    await press(pilot, "end", "enter")
    assert isinstance(app.screen, DetailPage)
    await press(pilot, "r", "y")
    assert app.recorded.asked == [("retake", {"key": "grid/0-0-4"})]


def view_of(name: str) -> RunView:
    session = Session(RUNS / "r", lambda _: None, 1.0)
    session.take(fresh(name), sample_run(name).now)
    return session.view


def test_a_run_that_is_aborting_is_being_stopped() -> None:
    session = Session(RUNS / "r", lambda _: None, 1.0)
    sample = measuring().state("aborting")
    session.take(dataclasses.replace(fresh("running"), records=sample.records), sample.now)
    view = session.view
    assert (view.state, pause_command(view)) == ("stopping", "")
    assert refusal("pause", view, background=False, unacknowledged=False) == AT_REST["stopping"]
    assert refusal("stop", view, background=False, unacknowledged=False) == ""


@pytest.mark.parametrize("name", ["new", "pause", "retake"])
@pytest.mark.parametrize("state", ["aborted", "fault", "gone"])
def test_nothing_is_started_while_a_live_run_goes_on_behind(state: str, name: str) -> None:
    view = view_of(state)
    assert refusal(name, view, background=True, unacknowledged=False) == ONE_AT_A_TIME
    assert refusal(name, view, background=False, unacknowledged=False) == ""


@pytest.mark.parametrize("state", sample_runs())
def test_what_goes_on_behind_can_be_stopped_and_left(state: str) -> None:
    view = view_of(state)
    for name in ("stop", "detach"):
        assert refusal(name, view, background=True, unacknowledged=False) == ""
        refused = refusal(name, view, background=False, unacknowledged=False) != ""
        assert refused == (state not in LIVE)


def test_without_a_run_there_is_nothing_to_act_on() -> None:
    assert pause_command(None) == ""
    for name in ("pause", "retake", "acknowledge", "log", "bad"):
        assert refusal(name, None, background=False, unacknowledged=False)
    for name in ("new", "history", "help", "theme", "quit", "find", "mark"):
        assert refusal(name, None, background=False, unacknowledged=False) == ""


@pytest.mark.parametrize("state", ["checking", "stopping", "silent", "done", "intolerant"])
def test_a_refused_space_bar_gives_the_reason(state: str) -> None:
    assert refusal("pause", view_of(state), background=False, unacknowledged=False)


HIGH = (137, 30)  # the verdict leaves a row for an alarm


@on_screen("done", size=HIGH)
async def test_a_calibration_without_a_file_is_written_after_a_question(
    app: Stage, pilot: Press
) -> None:
    await press(pilot, "space")
    assert isinstance(app.screen, RunScreen)
    assert "the run is over" in text_of(app)
    app.receive(app.recorded, RunUpdate([], calibrated=False))
    await settle(pilot)
    assert "HC-J11" in text_of(app)
    await press(pilot, "space")
    assert "nothing moves" in text_of(app)
    assert app.engines == []
    await press(pilot, "enter")
    assert len(app.engines) == 1


@pytest.mark.parametrize("over", ["a", "ctrl+p"])
@on_screen("paused")
async def test_updates_are_shown_under_a_question_and_under_the_palette(
    app: Stage, pilot: Press, over: str
) -> None:
    await press(pilot, over)
    for engine, word in ((EngineState.SILENT, "NO ANSWER"), (EngineState.ANSWERING, "PAUSED")):
        app.receive(app.recorded, RunUpdate([], engine, status("paused")))
        await settle(pilot)
        assert word in text_of(app)


@on_screen("done", size=HIGH)
async def test_a_calibration_saved_later_is_reported(app: Stage, pilot: Press) -> None:
    for calibrated in (False, True):
        app.receive(app.recorded, RunUpdate([], calibrated=calibrated))
        await settle(pilot)
    assert "the calibration has its file" in text_of(app)
    assert "HC-J11" in text_of(app)
    await press(pilot, "k")
    assert "HC-J11" not in text_of(app)


@on_screen("done")
async def test_an_unreadable_journal_is_reported_while_it_is_unreadable(
    app: Stage, pilot: Press
) -> None:
    app.receive(app.recorded, RunUpdate([], trouble="journal: cannot be read"))
    await settle(pilot)
    assert "cannot be read" in text_of(app)
    app.receive(app.recorded, RunUpdate([]))
    await settle(pilot)
    assert "cannot be read" not in text_of(app)


@pytest.mark.parametrize("state", ["done", "gone"])
@on_screen()
async def test_a_stop_where_nothing_runs_says_so(app: Stage, pilot: Press, state: str) -> None:
    await press(pilot, "escape")
    assert "nothing runs here; if anything moves, use the E-stop" in text_of(app)
    assert app.recorded.stops == 0


@pytest.mark.parametrize("keys", [("ctrl+p",), ("backspace",), ("x", "backspace", "backspace")])
@on_screen("running")
async def test_the_palette_says_how_to_go_back_and_does(
    app: Stage, pilot: Press, keys: tuple[str, ...]
) -> None:
    await press(pilot, "ctrl+p")
    assert "^p or Backspace: back   Esc: STOP" in text_of(app)
    await press(pilot, *keys)
    assert isinstance(app.screen, RunScreen)
    assert app.recorded.stops == 0


@on_screen("running")
async def test_in_a_text_box_only_its_own_keys_are_shown(app: Stage, pilot: Press) -> None:
    await press(pilot, "slash")
    keys = text_of(app).splitlines()[-1]
    assert keys.strip("▌ ").split("  ") == ["Enter to the rows", "Esc STOP", "^q quit"]
    await press(pilot, "tab")
    assert " space  pause " in text_of(app).splitlines()[-2]
