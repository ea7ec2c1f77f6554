"""A page that is left before its answer has come must not miss it."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path

import pytest

from hilcell.journal import index
from hilcell.tui import process
from hilcell.tui.screens.run import RunScreen
from tests.hilcell.tui.recording_app import RecordingApp, options, settle

LIMIT_S = 10.0


def leave(folder: Path, key: str, answer: threading.Event) -> str:
    """Open a page, leave it, let its answer come; return the state of the screens."""

    async def leave_early() -> str:
        app = RecordingApp(options(folder), "done")
        async with app.run_test(size=(80, 24)) as pilot:
            await settle(pilot)
            await pilot.press(key)
            await pilot.press("q")
            answer.set()
            await settle(pilot)
            return type(app.screen).__name__

    return asyncio.run(leave_early())


def test_the_history(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answer = threading.Event()

    def late(runs: Path) -> list[index.RunRow]:
        assert answer.wait(LIMIT_S)
        return []

    monkeypatch.setattr(index, "read_index", late)
    assert leave(tmp_path, "h", answer) == "RunScreen"


def test_the_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answer = threading.Event()

    async def late(*words: str) -> str:
        assert await asyncio.to_thread(answer.wait, LIMIT_S)
        return "figures"

    monkeypatch.setattr(process, "run_command", late)
    assert leave(tmp_path, "o", answer) == "RunScreen"


def test_news_that_come_while_the_screen_is_taken_down(tmp_path: Path) -> None:
    """The parts of a screen go before the screen does; a message may come in between."""

    async def leave_early() -> None:
        app = RecordingApp(options(tmp_path), "done")
        async with app.run_test(size=(80, 24)) as pilot:
            await settle(pilot)
            page = app.page
            assert isinstance(page, RunScreen)
            await page.query("*").remove()
            page.show_again()

    asyncio.run(leave_early())
