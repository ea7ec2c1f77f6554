"""Commissioning on the screen: questions and their answers, a step's run, and the stop."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
from textual.widgets import Input

from hilcell.cell.devices import load_entry
from hilcell.cell.file import load_cell
from hilcell.commission.dialogue import Dialogue
from hilcell.commission.sequence import STEPS
from hilcell.commission.steps import motions
from hilcell.errors import HilcellError
from hilcell.tui import commissioning
from hilcell.tui.app import HilcellApp, wants_commissioning
from hilcell.tui.commissioning import Work
from hilcell.tui.screens.commissioning import CommissionScreen
from hilcell.tui.screens.start import StartScreen
from tests.hilcell.commission.test_steps import proved
from tests.hilcell.tui.all_screens import isolated, work_of
from tests.hilcell.tui.recording_app import (
    RUNS,
    SIZE,
    Press,
    RecordingApp,
    Stage,
    on_screen,
    press,
    run_app,
    settle,
    text_of,
    type_ahead,
    until,
)

__all__ = ["isolated"]

Script = Callable[[Dialogue, Callable[[str], object]], None]
QUESTION = "it moves, in sequence:\n  the slide by 5 mm\nis the cell clear?"

pytestmark = pytest.mark.usefixtures("isolated", "no_bursts")


@pytest.fixture
def no_bursts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take every key of these tests for a deliberate one."""
    monkeypatch.setattr(HilcellApp, "BURST_S", 0.0)


def on_cell(script: Script, act: Callable[..., object], folder: Path) -> RecordingApp:
    """Begin a commissioning that asks by a script, and act once it has asked."""

    def made(path: Path, dialogue: Dialogue, operator: str, run: Callable[[str], object]) -> object:
        return SimpleNamespace(perform=lambda steps: script(dialogue, run))

    async def begin(app: Stage, pilot: Press) -> None:
        await press(pilot, "C")
        field = app.screen.query_one("#cell_file", Input)
        field.value = str(folder / "hall.toml")
        await until(pilot, lambda: "goes on with step devices" in text_of(app))
        await pilot.press("enter")
        await until(pilot, lambda: app.commissioning is not None)
        await act(app, pilot)  # type: ignore[misc]
        await until(pilot, lambda: not work_in(app).at_work)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(commissioning, "Commissioning", made)
        return run_app(begin, size=SIZE)


def work_in(app: RecordingApp) -> Work:
    assert app.commissioning is not None
    return app.commissioning


def asks(app: RecordingApp) -> bool:
    page = app.screen
    return isinstance(page, CommissionScreen) and page.query_one("#answer").has_focus


@pytest.mark.parametrize(
    ("real", "keys", "agreed"),
    [
        (True, "yes", True),
        (True, "y", False),
        (True, "", False),
        (False, "", True),
        (False, "n", False),
    ],
)
def test_real_devices_move_by_the_whole_word(
    real: bool, keys: str, agreed: bool, tmp_path: Path
) -> None:
    found: list[bool] = []

    def script(dialogue: Dialogue, run: object) -> None:
        dialogue.real = real
        found.append(dialogue.agree(QUESTION))

    async def act(app: Stage, pilot: Press) -> None:
        await until(pilot, lambda: asks(app))
        assert ('type "yes"' in text_of(app)) is real
        await pilot.press(*keys, "enter")

    on_cell(script, act, tmp_path)
    assert found == [agreed]


def test_nothing_typed_before_a_question_of_a_motion_answers_it(tmp_path: Path) -> None:
    """Neither a key that was pressed before it stood there, nor an Enter of a burst."""
    found: list[bool] = []

    async def act(app: Stage, pilot: Press) -> None:
        await until(pilot, lambda: asks(app))
        type_ahead(app, "y", "e", "s", "enter")
        await pilot.pause()
        assert app.screen.query_one("#answer", Input).value == ""
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(HilcellApp, "BURST_S", 60.0)
            await pilot.press(*"yes", "enter")
        assert not found
        assert "burst" in text_of(app)
        await pilot.press("enter")

    on_cell(lambda dialogue, run: found.append(dialogue.agree(QUESTION)), act, tmp_path)
    assert found == [True]


def test_a_question_of_a_motion_that_is_cut_is_not_answered(tmp_path: Path) -> None:
    found: list[bool] = []

    async def act(app: Stage, pilot: Press) -> None:
        await until(pilot, lambda: asks(app))
        await pilot.resize_terminal(60, 6)
        await pilot.press(*"yes", "enter")
        await until(pilot, lambda: "too small" in text_of(app))
        assert not found
        await pilot.resize_terminal(*SIZE)
        await pilot.press("enter")

    on_cell(lambda dialogue, run: found.append(dialogue.agree(QUESTION)), act, tmp_path)
    assert found == [True]


@pytest.mark.parametrize("state", ["running", "paused", "suspended"])
def test_it_fits_each_terminal(state: str) -> None:
    async def act(app: Stage, pilot: Press) -> None:
        app.commissioning = work_of("rail")
        await press(pilot, "C")
        for size in ((160, 40), (60, 15), (20, 5)):
            await pilot.resize_terminal(*size)
            await settle(pilot)
            assert all(len(line) <= size[0] for line in text_of(app).splitlines())

    run_app(act, state, size=SIZE)


def test_a_choice_is_taken_from_a_list(tmp_path: Path) -> None:
    found: list[str] = []
    makes = {"kuka": "a robot of one make", "ur": "one of another, by a wire that is its own"}

    async def act(app: Stage, pilot: Press) -> None:
        await until(pilot, lambda: app.screen.query_one("#choices").has_focus)
        await pilot.press("down")
        await until(pilot, lambda: makes["ur"] in " ".join(text_of(app).replace("│", "").split()))
        await pilot.press("enter")

    on_cell(lambda dialogue, run: found.append(dialogue.choose("which?", makes)), act, tmp_path)
    assert found == ["ur"]


def test_the_question_of_each_step_is_shown_in_full(tmp_path: Path) -> None:
    cell = load_cell("paper")
    procedures = [load_entry("procedures", step.procedure) for step in STEPS if step.procedure]
    questions = [words for each in procedures if (words := motions(cell, each))]

    def script(dialogue: Dialogue, run: object) -> None:
        dialogue.real = False
        for question in questions:
            dialogue.agree(question)

    async def act(app: Stage, pilot: Press) -> None:
        for question in questions:
            await until(pilot, lambda q=question: asks(app) and app.screen._asked.text == q)  # type: ignore[attr-defined, misc]
            await until(pilot, lambda: "Enter or y continues" in text_of(app))
            words = text_of(app).replace("│", " ").replace("•", " ").split()
            assert set(question.split()) <= set(words)
            await pilot.press("enter")

    on_cell(script, act, tmp_path)


def test_escape_ends_it_and_starts_nothing(tmp_path: Path) -> None:
    async def act(app: Stage, pilot: Press) -> None:
        await until(pilot, lambda: asks(app))
        await pilot.press("escape")
        await until(pilot, lambda: not work_in(app).at_work)
        await until(pilot, lambda: "commissioning was stopped" in text_of(app))
        await pilot.press("escape")
        await until(pilot, lambda: isinstance(app.screen, StartScreen))

    def script(dialogue: Dialogue, run: Callable[[str], object]) -> None:
        dialogue.ask("serial number?", str)
        run("commission-rail")

    app = on_cell(script, act, tmp_path)
    assert not app.engines


@pytest.mark.parametrize(
    ("key", "performed"),
    [("u", ["controller"]), ("f", ["controller", "rail"]), ("enter", ["rail"])],
)
def test_one_step_is_repeated_and_others_follow(
    key: str, performed: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[str] = []

    def made(path: Path, dialogue: Dialogue, *_: object) -> object:
        return SimpleNamespace(perform=lambda steps: found.extend(each.name for each in steps))

    async def act(app: Stage, pilot: Press) -> None:
        await press(pilot, "C")
        app.screen.query_one("#cell_file", Input).value = str(file)
        await until(pilot, lambda: "goes on with step rail" in text_of(app))
        app.screen.query_one("#steps").focus()
        await pilot.press("home", "down", "down", key)
        await until(pilot, lambda: app.commissioning and not work_in(app).at_work)

    monkeypatch.setattr(commissioning, "Commissioning", made)
    file = proved(tmp_path / "hall.toml", *[step.name for step in STEPS[:3]])
    run_app(act, size=SIZE)
    assert found[: len(performed)] == performed
    assert len(found) == 1 or key != "u"


def test_a_stop_before_the_engine_starts_is_kept() -> None:
    started: list[Path] = []
    work = Work(Path("hall.toml"), "", RUNS, lambda folder, _: started.append(folder), print)  # type: ignore[arg-type, return-value]
    work.stop()
    with pytest.raises(HilcellError, match="stopped"):
        work._run("commission-rail")
    assert not started


def test_the_key_that_ends_the_work_is_a_stop_also_where_the_work_ends_at_once() -> None:
    """Else the same key would leave the page, too."""
    work = Work(Path("hall.toml"), "", RUNS, lambda *_: str, print)
    ends_at_once = SimpleNamespace(put=lambda _: setattr(work, "at_work", False))
    work._answers = ends_at_once  # type: ignore[assignment]
    assert work.stop()
    assert not work.stop()


@pytest.mark.parametrize(
    ("state", "keys", "asked"),
    [
        ("running", ["space"], [("pause", {})]),
        ("paused", [*"yes", "enter"], [("proceed", {"until": 24})]),
        ("paused", ["enter"], []),
        ("suspended", ["enter"], [("answer", {})]),
    ],
)
def test_a_live_run_of_a_step_is_paused_and_goes_on(
    state: str, keys: list[str], asked: list[object]
) -> None:
    async def act(app: Stage, pilot: Press) -> None:
        app.commissioning = work_of("rail")
        await press(pilot, "C")
        assert isinstance(app.screen, CommissionScreen)
        await pilot.press(*keys)  # of now: keys from before a question are none
        await settle(pilot)
        assert app.recorded.asked == asked
        await press(pilot, "escape")
        assert app.recorded.stops

    run_app(act, state, size=SIZE)


@on_screen("running", size=SIZE)
async def test_another_live_run_comes_first(app: Stage, pilot: Press) -> None:
    await press(pilot, "C")
    assert not isinstance(app.screen, CommissionScreen)
    assert "a run is live" in text_of(app)


def test_the_screen_offers_a_new_file_and_one_that_lacks_steps(tmp_path: Path) -> None:
    names = [step.name for step in STEPS]
    file = tmp_path / "hall.toml"
    assert wants_commissioning(str(file))
    assert wants_commissioning(str(proved(file, *names[:3])))
    assert not wants_commissioning(str(proved(tmp_path / "other.toml", *names)))
    assert not wants_commissioning("paper")
