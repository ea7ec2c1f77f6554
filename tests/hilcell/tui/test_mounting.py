"""A screen begins once: Textual calls the handlers of each of its classes by itself."""

from __future__ import annotations

from collections import Counter

import pytest

from hilcell.tui.screens.base import BaseScreen
from hilcell.tui.screens.run import RunScreen
from hilcell.tui.screens.start import StartScreen
from tests.hilcell.tui.all_screens import isolated
from tests.hilcell.tui.recording_app import PAGES, Press, Stage, press, run_app, settle

__all__ = ["isolated"]

pytestmark = pytest.mark.usefixtures("isolated")


@pytest.mark.parametrize("handler", ["on_mount", "on_resize"])
def test_each_screen_handles_an_event_once(handler: str, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: Counter[str] = Counter()
    original = getattr(BaseScreen, handler)

    def count(screen: BaseScreen) -> None:
        calls[type(screen).__name__] += 1
        original(screen)

    monkeypatch.setattr(BaseScreen, handler, count)

    async def open_all(app: Stage, pilot: Press) -> None:
        for key in PAGES:
            await press(pilot, key)
            await press(pilot, "q")
        await app.push_screen(StartScreen())
        await settle(pilot)

    run_app(open_all, "done")
    opened: list[type[BaseScreen]] = [*PAGES.values(), RunScreen, StartScreen]
    screens = [each.__name__ for each in opened]
    assert {name: calls[name] for name in screens} == dict.fromkeys(screens, 1)
