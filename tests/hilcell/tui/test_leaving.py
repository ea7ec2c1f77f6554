"""A page that is left before its answer has come must not miss it."""

from __future__ import annotations

import asyncio
import threading

import pytest

from hilcell.journal import index
from hilcell.tui import process
from hilcell.tui.screens.run import RunScreen
from tests.hilcell.tui.recording_app import SIZE, Press, Stage, on_screen, run_app, settle

LIMIT_S = 10.0


@pytest.mark.parametrize("key", ["h", "o"])
def test_a_page_that_is_left_before_its_answer(key: str, monkeypatch: pytest.MonkeyPatch) -> None:
    answer = threading.Event()

    def late_index(_: object) -> list[index.RunRow]:
        assert answer.wait(LIMIT_S)
        return []

    async def late_command(*_: str) -> str:
        assert await asyncio.to_thread(answer.wait, LIMIT_S)
        return "figures"

    async def leave_early(app: Stage, pilot: Press) -> None:
        await pilot.press(key)
        await pilot.press("q")
        answer.set()
        await settle(pilot)
        assert isinstance(app.screen, RunScreen)

    monkeypatch.setattr(index, "read_index", late_index)
    monkeypatch.setattr(process, "run_command", late_command)
    run_app(leave_early, "done", size=SIZE)


@on_screen("done", size=SIZE)
async def test_news_that_come_while_the_screen_is_taken_down(app: Stage, pilot: Press) -> None:
    """The parts of a screen go before the screen does; a message may come in between."""
    page = app.page
    assert isinstance(page, RunScreen)
    await page.query("*").remove()
    page.show_again()
