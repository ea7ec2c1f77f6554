"""Keys that come in one burst, from a scanner of barcodes or over a thin link, act as if typed."""

from __future__ import annotations

import pytest
from textual.pilot import Pilot
from textual.widgets import Input

from hilcell.tui.screens.base import Confirm
from hilcell.tui.screens.pages import DetailPage
from hilcell.tui.screens.run import RunScreen
from hilcell.tui.screens.start import PlanSummary, StartScreen
from hilcell.tui.widgets import Choice, Table
from tests.hilcell.tui.all_screens import PLAN, isolated
from tests.hilcell.tui.recording_app import (
    RecordingApp,
    press,
    run_app,
    settle,
    text_of,
    type_ahead,
)

__all__ = ["PLAN", "isolated"]

pytestmark = pytest.mark.usefixtures("isolated")


def keys(text: str) -> list[str]:
    return ["space" if letter == " " else letter for letter in text]


def values(app: RecordingApp) -> dict[str, str]:
    return {str(box.id): box.value for box in app.screen.query(Input)}


def test_text_goes_into_the_field_that_a_tab_before_it_chose() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        type_ahead(app, "tab", *keys("Harold Smith"), "tab", *keys("Job 7"), "down", "2")
        await settle(pilot)
        assert isinstance(app.screen, StartScreen)
        assert values(app) == {"cell": "paper", "operator": "Harold Smith", "job": "Job 7"} | {
            "seed": "2"
        }

    run_app(act)


def test_a_field_is_edited_in_the_order_typed() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        type_ahead(app, "shift+tab", "ctrl+u", *"replax", "backspace", "y", "home", "x", "delete")
        type_ahead(app, "tab", "shift+tab", "end", "2")
        await settle(pilot)
        assert values(app)["cell"] == "xeplay2"

    run_app(act)


def test_a_second_code_from_a_scanner_starts_nothing() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        type_ahead(app, "tab", *keys("Ann"), "tab", *keys("JOB-7"), "enter")
        await settle(pilot)
        assert isinstance(app.screen, PlanSummary)
        assert "operator Ann" in text_of(app)
        type_ahead(app, *keys("JOB-8"), "enter")
        await settle(pilot)
        assert isinstance(app.screen, PlanSummary)
        assert "job JOB-7" in text_of(app)

    run_app(act)


def test_a_detach_in_a_burst_asks() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        type_ahead(app, "w", "d")
        await settle(pilot)
        assert isinstance(app.screen, Confirm)
        assert "detach" in text_of(app)

    assert run_app(act, "running").detached == []


def test_an_enter_in_a_burst_is_no_answer_to_a_prompt() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        type_ahead(app, "w", "enter")
        await settle(pilot)
        assert "press it alone" in text_of(app)
        assert app.recorded.asked == []
        await press(pilot, "enter")

    assert run_app(act, "suspended").recorded.asked == [("answer", {})]


@pytest.mark.parametrize("state", ["paused", "fault", "running"])
def test_a_scanned_code_moves_nothing_and_leaves_nothing(state: str) -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        for code in (" \ny", "r\n", "d"):
            type_ahead(app, "f9", *["enter" if key == "\n" else key for key in keys(code)])
            await settle(pilot)
            while not isinstance(app.screen, RunScreen):
                await press(pilot, "q")
        assert app.detached == []

    app = run_app(act, state)
    assert app.engines == []
    assert [word for word, _ in app.recorded.asked if word != "pause"] == []


def test_choices_follow_the_keys_before_them() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        type_ahead(
            app,
            "home",
            "end",
            "down",
            "down",
            "down",
            "up",
            *["tab"] * 4,
            "space",
            "tab",
            "right",
            "down",
        )
        await settle(pilot)
        assert [each.index for each in app.screen.query(Choice)] == [1, 1, 2]

    run_app(act)


def test_the_point_under_the_cursor_is_the_one_acted_upon() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        rows = app.screen.query_one(Table)
        type_ahead(app, "end", "up", "r")
        await settle(pilot)
        assert isinstance(app.screen, Confirm)
        assert f"grid point {rows.rows[-2].key.removeprefix('grid/')} " in text_of(app)
        type_ahead(app, "n", "home", "enter")
        await settle(pilot)
        assert isinstance(app.screen, DetailPage)
        assert rows.rows[0].key in text_of(app)
        type_ahead(app, "q", "end", "enter", "q", "r")
        await settle(pilot)
        assert isinstance(app.screen, Confirm)
        assert f"grid point {rows.rows[-1].key.removeprefix('grid/')} " in text_of(app)

    run_app(act, "running")


def test_the_run_under_the_cursor_is_the_one_marked() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        await press(pilot, "h")
        type_ahead(app, "x", "down", "down", "x", "up", "x", "x")
        await settle(pilot)
        marks = [row.cells[0] for row in app.screen.query_one(Table).rows]
        assert marks == ["", "", "*", ""]  # of three the first went, the third was taken back

    run_app(act)


def test_a_filter_ends_with_its_enter() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        type_ahead(app, "slash", *"grad", "backspace", "backspace", *"id", "enter", "end", "r")
        await settle(pilot)
        assert app.screen_stack[-2].query_one(Input).value == "grid"
        assert isinstance(app.screen_stack[-2], RunScreen)
        key = app.screen_stack[-2].query_one(Table).key
        assert f"grid point {key.removeprefix('grid/')} " in text_of(app)

    run_app(act, "running")
