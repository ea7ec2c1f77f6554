"""What each key does in each state: asked for at the engine, asked of the operator, or nothing."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from textual.command import CommandPalette
from textual.pilot import Pilot
from textual.widgets import Input

from hilcell.tui.feed import Fresh
from hilcell.tui.keys import ACTIONS, Keymap, load_keys
from hilcell.tui.rows import Rows
from hilcell.tui.screens.base import SceneScreen
from hilcell.tui.screens.confirm import Confirm
from hilcell.tui.screens.history import HistoryPage
from hilcell.tui.screens.log import LogPage
from hilcell.tui.screens.pages import AlarmPage, DetailPage, HelpPage, InterlockPage
from hilcell.tui.screens.plots import PlotPage
from hilcell.tui.screens.report import ReportPage
from hilcell.tui.screens.run import RunScreen
from hilcell.tui.screens.start import PlanSummary, StartScreen
from tests.hilcell.tui.scenes import LIVE, PROMPT, fresh, stories
from tests.hilcell.tui.stage import Stage, options, press, settle, text_of, type_ahead
from tests.hilcell.tui.walk import outside

__all__ = ["outside"]

STATES = tuple(stories())
OVER = tuple(state for state in STATES if state not in LIVE)
RUNS = Path("/runs")
ROOMY = (240, 30)  # a footer that holds every key
# What the space bar does: the command posted, whether it asks before, and the word in the footer.
SPACE = {
    "idle": None, "checking": None, "running": ("pause", False, "pause"),
    "pausing": ("proceed", True, "go on"), "paused": ("proceed", True, "go on"),
    "suspended": ("proceed", True, "go on"), "stopping": None, "done": None, "intolerant": None,
    "aborted": ("resume", True, "resume"), "fault": ("resume", True, "resume"),
    "gone": ("resume", True, "resume"),
}  # fmt: skip
PAGES: dict[str, type[SceneScreen]] = {
    "e": AlarmPage, "i": InterlockPage, "l": LogPage, "p": PlotPage, "question_mark": HelpPage,
    "h": HistoryPage, "o": ReportPage,
}  # fmt: skip

pytestmark = pytest.mark.usefixtures("outside")
Act = Callable[[Stage, Pilot[int]], Awaitable[None]]


def play(act: Act, state: str = "", *, brought: Fresh | None = None, keymap: Keymap | None = None,
         size: tuple[int, int] = ROOMY) -> Stage:  # fmt: skip
    """Put a state on the stage, do something there, and return what is left of it."""
    app = Stage(options(RUNS, keymap=keymap), state, brought)

    async def run() -> None:
        async with app.run_test(size=size) as pilot:
            await settle(pilot)
            await act(app, pilot)

    asyncio.run(run())
    return app


def footer(app: Stage) -> str:
    return text_of(app).splitlines()[-1]


# -- what is allowed, and what is shown ------------------------------------------------------------


def allowed(state: str) -> set[str]:
    """Return the actions that a state allows on the run's screen."""
    found = {"history", "theme", "help", "quit"}
    if state != "idle":
        found |= {"alarms", "plots", "interlocks", "log", "report"}
        found |= {"bad", "sort", "find", "retake"}
    if SPACE[state] is not None:
        found.add("pause")
    found |= {"stop", "abort", "detach"} if state in LIVE else {"new"}
    if state in ("suspended", "aborted", "fault", "gone", "intolerant"):
        found.add("acknowledge")
    return found


@pytest.mark.parametrize("state", STATES)
def test_the_footer_shows_what_is_allowed_and_nothing_else(state: str) -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        wanted = allowed(state)
        assert {action.name for action in ACTIONS if app.allowed(action.name)} == wanted
        for action in ACTIONS:
            if action.name in RunScreen.footer and action.name != "pause":
                assert (f" {action.label}  " in f"{footer(app)}  ") == (action.name in wanted)
        space = SPACE[state]
        assert (f"space {space[2]}" if space else "space") in footer(app) or space is None
        assert ("space" in footer(app)) == (space is not None)

    play(act, state)


# -- the space bar ---------------------------------------------------------------------------------


@pytest.mark.parametrize("state", STATES)
def test_the_space_bar_pauses_goes_on_or_resumes(state: str) -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        await press(pilot, "space")
        space = SPACE[state]
        assert isinstance(app.screen, Confirm) == (space is not None and space[1])
        if isinstance(app.screen, Confirm):
            assert (app.heard.asked, app.engines) == ([], [])
            await press(pilot, "n")
            assert (app.heard.asked, app.engines) == ([], [])
            await press(pilot, "space", "y")

    app = play(act, state)
    space = SPACE[state]
    told = space is not None and space[0] != "resume"
    assert app.heard.asked == ([(space[0], {})] if space is not None and told else [])
    assert bool(app.engines) == (space is not None and space[0] == "resume")
    assert app.heard.stops == 0


def test_the_space_bar_pauses_from_every_page_that_says_so() -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        for key in "eilp":
            await press(pilot, key)
            assert "space" in footer(app)
            await press(pilot, "space", "q")

    assert play(act, "running").heard.asked == [("pause", {})] * 4


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


def test_escape_stops_from_everywhere_and_never_asks() -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        home = app.screen
        for number, (place, keys) in enumerate(PLACES.items(), start=1):
            await press(pilot, *keys, "escape")
            assert app.heard.stops == number, place
            assert isinstance(app.screen, SceneScreen), place
            assert "STOP" in text_of(app), place
            assert app.glyphs.states["running"] in text_of(app).splitlines()[0], place
            while app.screen is not home:
                app.pop_screen()
                await settle(pilot)
            home.query_one(Rows).focus()

    assert play(act, "running").heard.asked == []


@pytest.mark.parametrize("key", PAGES)
def test_what_is_said_is_seen_and_spoils_no_page(key: str) -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        await press(pilot, key)
        before = text_of(app).splitlines()
        app.say("something happened")
        await settle(pilot)
        after = text_of(app).splitlines()
        assert after[-2] == "something happened"
        assert after[:12] == before[:12] or key == "l"  # the log follows its newest record
        assert after[-1] == before[-1]

    play(act, "running", size=(80, 24))


def test_escape_stops_over_a_prompt() -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        await press(pilot, "escape")

    app = play(act, "suspended")
    assert (app.heard.stops, app.heard.asked) == (1, [])


@pytest.mark.parametrize("state", STATES)
def test_a_live_run_is_stopped_at_once_and_aborted_after_a_question(state: str) -> None:
    live = state in LIVE

    async def act(app: Stage, pilot: Pilot[int]) -> None:
        await press(pilot, "escape")
        assert isinstance(app.screen, RunScreen)
        await press(pilot, "a")
        assert isinstance(app.screen, Confirm) == live
        if live:
            await press(pilot, "q")
            assert app.heard.asked == []
            await press(pilot, "a", "enter")
        else:
            assert "abort: nothing to do now" in text_of(app)
        await press(pilot, "question_mark", "escape")
        assert isinstance(app.screen, HelpPage if live else RunScreen)

    app = play(act, state)
    assert app.heard.stops == (2 if live else 0)
    assert app.heard.asked == ([("abort", {})] if live else [])


def test_escape_leaves_the_plan_without_a_start() -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        await press(pilot, "enter")
        assert isinstance(app.screen, PlanSummary)
        await press(pilot, "escape")
        assert isinstance(app.screen, StartScreen)
        await press(pilot, "escape")
        assert isinstance(app.screen, StartScreen)

    play(act)


# -- abort, detach, quit ---------------------------------------------------------------------------


@pytest.mark.parametrize("key", ["ctrl+q", "ctrl+c"])
@pytest.mark.parametrize("place", [("slash", "a"), ("ctrl+p",), ("a",)])
def test_quitting_over_a_live_run_offers_to_detach(key: str, place: tuple[str, ...]) -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        await press(pilot, *place, key)
        assert isinstance(app.screen, Confirm)
        assert "detach" in text_of(app)
        assert app.heard.closed == []
        await press(pilot, key)  # pressed again, it still asks, and only once
        assert sum(isinstance(each, Confirm) for each in app.screen_stack) == 1
        await press(pilot, "n")
        assert app.is_running
        await press(pilot, key)
        await pilot.press("y")

    app = play(act, "running")
    assert app.heard.closed == [True]
    assert (app.heard.stops, app.heard.asked) == (0, [])
    assert app.return_value == 0


@pytest.mark.parametrize("state", ["done", "fault", "gone"])
def test_quitting_over_a_past_run_just_quits(state: str) -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        await pilot.press("ctrl+q")

    app = play(act, state)
    assert (app.return_value, app.heard.closed) == (0, [True])


def test_detaching_leaves_on_purpose() -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        await pilot.press("d")

    app = play(act, "running")
    assert (app.return_value, app.heard.closed, app.heard.stops) == (0, [True], 0)


def test_a_new_run_is_begun_over_a_past_one_only() -> None:
    async def past(app: Stage, pilot: Pilot[int]) -> None:
        await press(pilot, "n")
        assert isinstance(app.screen, StartScreen)

    async def live(app: Stage, pilot: Pilot[int]) -> None:
        await press(pilot, "n")
        assert isinstance(app.screen, RunScreen)

    assert play(past, "done").heard.closed == [True]
    assert play(live, "running").heard.closed == []


def test_looking_at_another_run_over_a_live_one_asks() -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        home = app.screen
        await press(pilot, "h", "down", "enter")
        assert "look at the other" in text_of(app)
        await press(pilot, "n")
        assert type(app.screen) is HistoryPage
        await press(pilot, "home", "enter")  # the run that is shown: back to it
        assert app.screen is home

    assert play(act, "running").heard.closed == []


# -- the prompt ------------------------------------------------------------------------------------


def asking(**more: object) -> Fresh:
    """Return a run whose prompt differs from the usual one."""
    found = fresh("suspended")
    assert found.status is not None
    prompt = msgspec.structs.replace(PROMPT, **more)
    return replace(found, status=msgspec.structs.replace(found.status, prompt=prompt))


@pytest.mark.parametrize(
    ("brought", "answered", "said"),
    [
        (asking(), True, "press Enter"),
        (asking(ready=False), False, "Enter waits"),
        (asking(ready=False, seen_mm=None), False, "sees nothing there"),
        (asking(ready=False, seen_mm=None, age_s=None), False, "has not looked yet"),
        (asking(ready=False, check=False), True, "Enter when it is done"),
    ],
    ids=["ready", "too far", "nothing", "not looked", "no check"],
)
def test_enter_answers_a_prompt_only_when_it_is_ready(
    brought: Fresh, answered: bool, said: str
) -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        assert said in text_of(app)
        await press(pilot, "enter")
        assert isinstance(app.screen, RunScreen)
        if not answered:
            assert "Enter works when the tracker sees the reflector" in text_of(app)

    app = play(act, brought=brought, size=(80, 24))
    assert app.heard.asked == ([("answer", {})] if answered else [])


def test_enter_in_the_filter_answers_no_prompt() -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        await press(pilot, "slash", "g", "enter")

    assert play(act, "suspended").heard.asked == []


# -- measuring again -------------------------------------------------------------------------------


@pytest.mark.parametrize("state", ["running", "paused", "fault", "gone"])
def test_a_point_is_measured_anew_after_a_question(state: str) -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        await press(pilot, "end", "r")
        assert isinstance(app.screen, Confirm)
        assert "grid/0-0-4" in text_of(app)
        await press(pilot, "n", "r", "y")

    app = play(act, state)
    if state in LIVE:
        assert app.heard.asked == [("retake", {"key": "grid/0-0-4"})]
    else:
        assert [words for _, words in app.engines] == [("--retake", "grid/0-0-4")]


def test_a_point_that_may_not_be_measured_anew_says_why() -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        await press(pilot, "home", "r")
        assert isinstance(app.screen, RunScreen)
        assert "world/F1: only points of the grid" in text_of(app)

    assert play(act, "running").heard.asked == []


def test_a_point_is_measured_anew_from_its_own_page() -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        await press(pilot, "end", "enter")
        assert isinstance(app.screen, DetailPage)
        await press(pilot, "r", "y")

    assert play(act, "running").heard.asked == [("retake", {"key": "grid/0-0-4"})]


# -- rows, filters, alarms -------------------------------------------------------------------------


def test_letters_typed_into_a_filter_do_not_act() -> None:
    typed = "adnkrwbopileht q"

    async def act(app: Stage, pilot: Pilot[int]) -> None:
        keys = ["space" if letter == " " else letter for letter in typed]
        await press(pilot, "slash", *keys)
        assert isinstance(app.screen, RunScreen)
        assert app.screen.query_one("#find", Input).value == typed
        assert "no such point" in text_of(app)

    app = play(act, "running")
    assert (app.heard.asked, app.heard.closed, app.theme) == ([], [], "calm")


@pytest.mark.parametrize("first", [(), ("h",), ("l",)])
def test_what_is_typed_ahead_goes_where_it_was_meant_to(first: tuple[str, ...]) -> None:
    """A thin link delivers keys in bursts: an "a" meant for a filter must not abort."""

    async def act(app: Stage, pilot: Pilot[int]) -> None:
        type_ahead(app, *first, "slash", "a", "d", "space", "y", "enter")
        await settle(pilot)
        assert app.screen.query_one("#find", Input).value == "ad y"

    app = play(act, "running")
    assert (app.heard.asked, app.heard.closed) == ([], [])


def test_a_question_typed_ahead_is_answered() -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        type_ahead(app, "a", "y")
        await settle(pilot)

    assert play(act, "running").heard.asked == [("abort", {})]


def test_letters_typed_into_the_form_do_not_act() -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        app.screen.query_one("#operator", Input).focus()
        await press(pilot, *"hqtn", "space", *"ad")
        assert isinstance(app.screen, StartScreen)
        assert app.screen.query_one("#operator", Input).value == "hqtn ad"

    play(act)


def test_a_filter_is_kept_and_an_empty_one_closes() -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        rows = app.screen.query_one(Rows)
        await press(pilot, "slash", *"0-0-3", "enter")
        assert [row.key for row in rows.rows] == ["grid/0-0-3"]
        assert app.screen.focused is rows
        await press(pilot, "slash", *["backspace"] * 5, "enter")
        assert len(rows.rows) == 8
        assert not app.screen.query_one("#find").display

    play(act, "running")


def test_the_worst_and_the_bad_are_found_with_a_key() -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        rows = app.screen.query_one(Rows)
        await press(pilot, "w")
        assert rows.key == "validate/S1100/idw/001"  # raw errors are larger, but meant to be
        assert "as measured" in footer(app)
        await press(pilot, "b")
        assert [row.key for row in rows.rows] == ["validate/S1100/idw/001"]
        await press(pilot, "b", "w")
        assert rows.rows[0].key == "world/F1"

    play(act, "done")


def test_an_alarm_stands_until_it_is_acknowledged() -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        assert "beam broken" in text_of(app)
        await press(pilot, "k")
        assert "beam broken" not in text_of(app)
        assert "acknowledge" not in footer(app)
        await press(pilot, "e")
        assert "beam broken" in text_of(app)
        assert "not acknowledged" not in text_of(app)

    play(act, "fault")


def test_pages_open_and_close() -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        for key, page in PAGES.items():
            for back in ("q", "backspace"):
                await press(pilot, key)
                assert isinstance(app.screen, page)
                await press(pilot, back)
                assert isinstance(app.screen, RunScreen)

    play(act, "running")


def test_plots_are_turned_by_arrows_and_numbers() -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        await press(pilot, "p", "right")
        assert "Plot 2 of 4" in text_of(app)
        await press(pilot, "left", "left")
        assert "Plot 4 of 4" in text_of(app)
        await press(pilot, "3")
        assert "Plot 3 of 4" in text_of(app)

    play(act, "done")


def test_the_palette_does_what_it_names() -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        await press(pilot, "ctrl+p", *"interlocks")
        assert isinstance(app.screen, CommandPalette)
        for _ in range(50):
            await pilot.pause()
            if "what may move" in text_of(app):
                break
        await pilot.press("enter")
        for _ in range(50):
            await pilot.pause()
            if isinstance(app.screen, InterlockPage):
                break
        assert isinstance(app.screen, InterlockPage)

    play(act, "running")


def test_the_next_theme_comes_with_a_key() -> None:
    async def act(app: Stage, pilot: Pilot[int]) -> None:
        await press(pilot, "t")
        assert app.theme == "daylight"
        await press(pilot, "t", "t")
        assert app.theme == "calm"

    play(act, "running")


# -- other keys ------------------------------------------------------------------------------------


def test_keys_from_a_file_act_in_place_of_the_usual_ones(tmp_path: Path) -> None:
    file = tmp_path / "keys.toml"
    file.write_text('[keys]\nabort = "z"\npause = ["f8", "g"]\nstop = "s"\nquit = "Q"\n')

    async def act(app: Stage, pilot: Pilot[int]) -> None:
        assert "z abort" in footer(app)
        assert "f8 pause" in footer(app)
        await press(pilot, "a", "space", "ctrl+q", "ctrl+c")
        assert isinstance(app.screen, RunScreen)
        assert app.heard.asked == []
        await press(pilot, "g")
        assert app.heard.asked == [("pause", {})]
        await press(pilot, "z", "y")
        assert app.heard.asked == [("pause", {}), ("abort", {})]
        await press(pilot, "s", "escape")
        assert app.heard.stops == 2
        await press(pilot, "question_mark")
        assert "f8 g" in text_of(app)

    play(act, "running", keymap=load_keys(file))
