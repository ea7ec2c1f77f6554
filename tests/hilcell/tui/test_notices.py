"""What comes in while one looks, and what the screen says then of itself."""

from __future__ import annotations

import pytest
from textual.pilot import Pilot

from hilcell.tui.run_view import EngineState
from hilcell.tui.screens.run import RunScreen
from hilcell.tui.session import RunUpdate
from tests.hilcell.tui.all_screens import isolated
from tests.hilcell.tui.recording_app import RecordingApp, press, run_app, settle, text_of
from tests.hilcell.tui.sample_runs import status

__all__ = ["isolated"]

HIGH = (137, 30)  # the verdict leaves a row for an alarm

pytestmark = pytest.mark.usefixtures("isolated")


def test_a_calibration_without_a_file_is_written_after_a_question() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
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

    assert len(run_app(act, "done", size=HIGH).engines) == 1


@pytest.mark.parametrize("over", ["a", "ctrl+p"])
def test_updates_are_shown_under_a_question_and_under_the_palette(over: str) -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        await press(pilot, over)
        for engine, word in ((EngineState.SILENT, "NO ANSWER"), (EngineState.ANSWERING, "PAUSED")):
            app.receive(app.recorded, RunUpdate([], engine, status("paused")))
            await settle(pilot)
            assert word in text_of(app)

    run_app(act, "paused")


def test_a_calibration_saved_later_is_reported() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        for calibrated in (False, True):
            app.receive(app.recorded, RunUpdate([], calibrated=calibrated))
            await settle(pilot)
        assert "the calibration has its file" in text_of(app)
        assert "HC-J11" in text_of(app)
        await press(pilot, "k")
        assert "HC-J11" not in text_of(app)

    run_app(act, "done", size=HIGH)


def test_an_unreadable_journal_is_reported_while_it_is_unreadable() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        app.receive(app.recorded, RunUpdate([], trouble="journal: cannot be read"))
        await settle(pilot)
        assert "cannot be read" in text_of(app)
        app.receive(app.recorded, RunUpdate([]))
        await settle(pilot)
        assert "cannot be read" not in text_of(app)

    run_app(act, "done")


@pytest.mark.parametrize("state", ["done", "gone"])
def test_a_stop_where_nothing_runs_says_so(state: str) -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        await press(pilot, "escape")
        assert "nothing runs here; if anything moves, use the E-stop" in text_of(app)

    assert run_app(act, state).recorded.stops == 0


@pytest.mark.parametrize("keys", [("ctrl+p",), ("backspace",), ("x", "backspace", "backspace")])
def test_the_palette_says_how_to_go_back_and_does(keys: tuple[str, ...]) -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        await press(pilot, "ctrl+p")
        assert "^p or Backspace: back   Esc: STOP" in text_of(app)
        await press(pilot, *keys)
        assert isinstance(app.screen, RunScreen)

    assert run_app(act, "running").recorded.stops == 0


def test_in_a_text_box_only_its_own_keys_are_shown() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        await press(pilot, "slash")
        keys = text_of(app).splitlines()[-1]
        assert keys.strip("▌ ").split("  ") == ["Enter to the rows", "Esc STOP", "^q quit"]
        await press(pilot, "tab")
        assert " space  pause " in text_of(app).splitlines()[-2]

    run_app(act, "running")
