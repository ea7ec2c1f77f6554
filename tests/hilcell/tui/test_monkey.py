"""Keys at random, in bursts, in every state: nothing breaks, and nothing is asked for unasked."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable
from pathlib import Path

import pytest
from textual.events import Resize
from textual.geometry import Size

from hilcell.tui.keys import ACTIONS, RESERVED
from hilcell.tui.screens.base import Confirm
from tests.hilcell.tui.all_screens import isolated
from tests.hilcell.tui.recording_app import SIZE, RecordingApp, options, settle, type_ahead
from tests.whole.bench import sweep

__all__ = ["isolated"]

BURSTS, LONGEST = 12, 4
LEAVING = ("d", "ctrl+q", "ctrl+c")
KEYS = sorted(
    {key for action in ACTIONS for key in action.keys} | {*RESERVED, *"1234gs"} - set(LEAVING)
)
SIZES = (SIZE, (20, 5), (60, 15), (160, 40))


class Watched(RecordingApp):
    """Counts every question."""

    questions = 0

    def ask(self, title: str, text: str, yes: str, act: Callable[[], object]) -> None:
        """Count a question."""
        self.questions += 1
        super().ask(title, text, yes, act)


@pytest.mark.usefixtures("isolated")
@pytest.mark.parametrize("state", ["running", "suspended", "", *sweep("pausing", "done", "gone")])
def test_random_keys_break_nothing(state: str) -> None:
    chance = random.Random(f"{state}")
    pressed: list[str] = []

    async def press_at_random(app: Watched) -> None:
        async with app.run_test(size=SIZE) as pilot:
            await settle(pilot)
            for _ in range(BURSTS):
                burst = chance.choices(KEYS, k=chance.randint(1, LONGEST))
                burst = [key for key in burst if key not in LEAVING]
                pressed.extend(burst)
                type_ahead(app, *burst)
                if chance.random() < 0.1:
                    size = Size(*chance.choice(SIZES))
                    app.post_message(Resize(size, size))
                await settle(pilot)
                assert sum(isinstance(each, Confirm) for each in app.screen_stack) <= 1
            app.open_runs.leave()  # a key that opens a real run may have been among them

    app = Watched(options(Path("/runs")), state)
    asyncio.run(press_at_random(app))
    asked = [command for command, _ in app.recorded.asked]
    assert set(asked) <= {"pause", "proceed", "abort", "retake", "answer", "acknowledge"}, pressed
    assert sum(each in ("proceed", "abort", "retake") for each in asked) <= app.questions, pressed
    assert app.recorded.stops <= pressed.count("escape")
