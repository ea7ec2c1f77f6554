"""Table, filters, alarms and pages, by keys; and keys of one's own."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path

import pytest
from textual.command import CommandList, CommandPalette
from textual.css.query import NoMatches
from textual.pilot import Pilot
from textual.widgets import Input
from textual.worker import WorkerFailed

from hilcell.journal import index
from hilcell.run.order import Order
from hilcell.tui.keys import load_keys
from hilcell.tui.screens.pages import HistoryPage, InterlockPage
from hilcell.tui.screens.run import RunScreen
from hilcell.tui.screens.start import PlanSummary
from hilcell.tui.themes import NAMES
from hilcell.tui.widgets import Table
from tests.hilcell.tui.all_screens import PLAN, isolated
from tests.hilcell.tui.recording_app import (
    PAGES,
    RecordingApp,
    footer,
    press,
    run_app,
    settle,
    text_of,
    type_ahead,
    until,
)

__all__ = ["isolated"]

pytestmark = pytest.mark.usefixtures("isolated")


# -- rows, filters, alarms -------------------------------------------------------------------------


def test_letters_typed_into_a_filter_do_not_act() -> None:
    typed = "adnkrwbopileht q"

    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        type_ahead(app, "slash", *("space" if letter == " " else letter for letter in typed))
        await settle(pilot)
        assert isinstance(app.screen, RunScreen)
        assert app.screen.query_one("#find", Input).value == typed
        assert "no such point" in text_of(app)

    app = run_app(act, "running")
    assert (app.recorded.asked, app.recorded.closed, app.theme) == ([], [], "calm")


@pytest.mark.parametrize("first", ["h", "l"])
def test_what_is_typed_ahead_goes_where_it_was_meant_to(first: str) -> None:
    """A thin link delivers keys in bursts: an "a" meant for a filter must not abort."""

    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        type_ahead(app, first, "slash", "a", "d", "space", "y", "enter")
        await settle(pilot)
        assert app.screen.query_one("#find", Input).value == "ad y"

    app = run_app(act, "running")
    assert (app.recorded.asked, app.recorded.closed) == ([], [])


def test_enter_twice_in_the_palette_closes_nothing_else() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        await press(pilot, "ctrl+p", *"theme")
        await until(pilot, lambda: "the next theme" in text_of(app))
        type_ahead(app, "enter", "enter", "enter")
        await settle(pilot)
        assert len(app.screen_stack) in (2, 3)  # the run, perhaps with its point
        assert app.theme == "daylight"
        await press(pilot, "ctrl+p", "escape")

    run_app(act, "running")


def test_a_filter_is_kept_and_an_empty_one_closes() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        rows = app.screen.query_one(Table)
        await press(pilot, "slash", *"0-0-3", "enter")
        assert [row.key for row in rows.rows] == ["grid/0-0-3"]
        assert app.screen.focused is rows
        await press(pilot, "slash", *["backspace"] * 5, "enter")
        assert len(rows.rows) == 8
        assert not app.screen.query_one("#find").display

    run_app(act, "running")


def test_the_worst_and_the_bad_are_found_with_a_key() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        rows = app.screen.query_one(Table)
        await press(pilot, "w")
        assert rows.key == "validate/S1100/chosen/001"  # raw errors are larger, but meant to be
        assert "w order" in footer(app)
        assert " worst first " in text_of(app)
        await press(pilot, "b")
        assert [row.key for row in rows.rows] == ["validate/S1100/chosen/001"]
        assert " bad by |e| " in text_of(app)
        await press(pilot, "slash", *"paper", "enter")
        assert "no such point is bad; b shows all" in text_of(app)
        await press(pilot, "slash", "ctrl+u", "enter", "b", "w")
        assert " point  " in text_of(app)
        assert rows.rows[0].key == "world/F1"

    run_app(act, "intolerant")


def test_an_alarm_whose_cause_nobody_watches_stands_though_it_is_acknowledged() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        assert "beam broken" in text_of(app)
        await press(pilot, "k")
        assert "beam broken" in text_of(app)
        assert isinstance(app.screen, RunScreen)
        assert not app.screen.footer_key("acknowledge").works
        await press(pilot, "e")
        assert "beam broken" in text_of(app)
        assert "not acknowledged" not in text_of(app)

    run_app(act, "fault")


def test_pages_open_and_close() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        for number, (key, page) in enumerate(PAGES.items()):
            await press(pilot, key)
            assert isinstance(app.screen, page)
            await press(pilot, ("q", "backspace")[number % 2])
            assert isinstance(app.screen, RunScreen)

    run_app(act, "running")


def test_plots_are_turned_by_arrows_and_numbers() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        await press(pilot, "p", "right")
        assert "in rising order" in text_of(app)
        await press(pilot, "left", "left")
        assert "strip's reading" in text_of(app)
        await press(pilot, "3")
        assert "nothing measured for this plot yet" in text_of(app)
        await press(pilot, "5")
        assert "nothing measured for this plot yet" in text_of(app)  # there were no sweeps

    run_app(act, "done", size=(120, 36))


def test_station_scale_and_series_of_a_plot_have_keys() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        await press(pilot, "p")
        assert "S  all stations" in text_of(app)
        assert "log scale" in text_of(app)
        await press(pilot, "S", "g", "v")
        text = text_of(app)
        assert "S  all stations" not in text
        assert "S  S1100" in text
        assert "log scale" not in text
        assert "■ as sent" in text
        assert "■ paper" not in text
        await press(pilot, "4", "g")
        assert "linear scale only" in text_of(app)

    run_app(act, "done", size=(120, 36))


def test_the_palette_does_what_it_names() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        await press(pilot, "ctrl+p", *"interlocks")
        assert isinstance(app.screen, CommandPalette)
        await until(pilot, lambda: "what may move" in text_of(app))
        await pilot.press("enter")
        await until(pilot, lambda: isinstance(app.screen, InterlockPage))

    run_app(act, "running")


@pytest.mark.parametrize("closing", [True, False])
def test_a_search_that_finds_the_palette_closed_ends_no_screen(closing: bool) -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        await press(pilot, "ctrl+p")
        palette = app.screen
        if closing:
            await palette.query_one(CommandList).remove()

        async def search() -> None:
            raise NoMatches

        worker = palette.run_worker(search())
        with pytest.raises(WorkerFailed):
            await worker.wait()
        await pilot.pause()

    if closing:
        run_app(act, "running")
    else:  # an error of the search itself is shown
        with pytest.raises(NoMatches):
            run_app(act, "running")


def test_the_palette_names_all_that_can_be_done_before_one_types() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        await press(pilot, "ctrl+p")
        await until(pilot, lambda: "stop everything now" in text_of(app))
        for action in ("abort", "re-measure", "bad only", "worst first", "filter"):
            assert action in text_of(app)
        assert "new run" not in text_of(app)  # not while one is live

    run_app(act, "running", size=(137, 45))


def test_the_next_theme_comes_with_a_key() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        seen = []
        for _ in NAMES:
            await press(pilot, "t")
            seen.append(app.theme)
        assert seen == [*NAMES[1:], NAMES[0]]

    run_app(act, "running")


@pytest.mark.parametrize("which", ["abort", "plan"])
def test_a_question_yields_to_its_answers(which: str) -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        if which == "abort":
            await press(pilot, "a")
        else:
            app.push_screen(PlanSummary(Order(runs=Path("r")), PLAN))
        await settle(pilot)
        assert "Enter" in text_of(app)
        await pilot.resize_terminal(24, 6)
        await settle(pilot)
        assert "Enter" in text_of(app)

    run_app(act, "running", size=(80, 24))


# -- other keys ------------------------------------------------------------------------------------


def test_keys_from_a_file_act_in_place_of_the_usual_ones(tmp_path: Path) -> None:
    file = tmp_path / "keys.toml"
    file.write_text('[keys]\nabort = "z"\npause = ["f8", "g"]\nstop = "s"\nquit = "Q"\n')

    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        assert " z  abort " in text_of(app)
        assert " f8  pause " in text_of(app)
        await press(pilot, "a", "space", "ctrl+q", "ctrl+c")
        assert isinstance(app.screen, RunScreen)
        assert app.recorded.asked == []
        await press(pilot, "g")
        assert app.recorded.asked == [("pause", {})]
        await press(pilot, "z", "y")
        assert app.recorded.asked == [("pause", {}), ("abort", {})]
        await press(pilot, "s", "escape")
        assert app.recorded.stops == 2
        await press(pilot, "question_mark")
        assert "f8 g" in text_of(app)

    run_app(act, "running", keymap=load_keys(file))


def test_an_index_that_takes_long_is_read_once_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    reads: list[Path] = []
    reading, go_on = threading.Event(), threading.Event()

    def slow(runs: Path) -> list[index.RunRow]:
        reads.append(runs)
        reading.set()
        go_on.wait()
        return []

    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        monkeypatch.setattr(index, "read_index", slow)
        page = HistoryPage()
        await app.push_screen(page)
        await asyncio.to_thread(reading.wait)
        for _ in range(3):
            page._read_index()
        go_on.set()
        await settle(pilot)
        assert len(reads) == 1

    run_app(act, "done")


@pytest.mark.parametrize("key", ["l", "h", "e", "p"])
def test_every_page_of_a_simulated_run_has_its_edge(key: str) -> None:
    async def look(app: RecordingApp, pilot: Pilot[int]) -> None:
        await press(pilot, key)
        assert app.screen.styles.border_left[0] == "outer"
        assert app.screen.has_class("simulated")

    run_app(look, "running", size=(80, 24))


def test_what_is_cut_in_the_log_has_its_mark() -> None:
    async def look(app: RecordingApp, pilot: Pilot[int]) -> None:
        await press(pilot, "l")
        held = next(line for line in text_of(app).splitlines() if "rail held" in line)
        assert held.rstrip("▌ ").endswith("…")

    run_app(look, "running", size=(80, 24))
