"""Plays: a state is put on the stage, something is done there, and one looks at what is left."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

from textual.pilot import Pilot

from hilcell.tui.engine.feed import RunUpdate
from hilcell.tui.keys import Keymap
from hilcell.tui.screens.base import BaseScreen
from hilcell.tui.screens.history import HistoryPage
from hilcell.tui.screens.pages import (
    AlarmPage,
    HelpPage,
    InterlockPage,
    LogPage,
    PlotPage,
    ReportPage,
)
from tests.hilcell.tui.stage import Stage, options, settle, text_of

RUNS = Path("/runs")
ROOMY = (240, 30)  # a footer that holds every key
PAGES: dict[str, type[BaseScreen]] = {
    "e": AlarmPage,
    "i": InterlockPage,
    "l": LogPage,
    "p": PlotPage,
    "question_mark": HelpPage,
    "h": HistoryPage,
    "o": ReportPage,
}

Act = Callable[[Stage, Pilot[int]], Awaitable[None]]


def play(
    act: Act,
    state: str = "",
    *,
    brought: RunUpdate | None = None,
    keymap: Keymap | None = None,
    size: tuple[int, int] = ROOMY,
) -> Stage:
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
