"""Hostile words on every screen: nothing crashes, nothing acts, nothing is printed raw."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from rich.cells import cell_len
from textual.events import Paste
from textual.widgets import Input

from hilcell.decoding import typed
from hilcell.errors import HilcellError
from hilcell.run.order import Order
from hilcell.tui import process
from hilcell.tui.run_view import EngineState
from hilcell.tui.screens import start
from hilcell.tui.screens.run import RunScreen
from hilcell.tui.screens.start import PlanSummary, StartScreen
from hilcell.tui.session import RunUpdate
from tests.hilcell.tui.all_screens import COMPARISON, PLAN, SHOWN, isolated, screens_of
from tests.hilcell.tui.recording_app import (
    SIZE,
    Press,
    Stage,
    on_screen,
    press,
    run_app,
    settle,
    text_of,
)
from tests.hilcell.tui.sample_runs import fresh, status
from tests.hilcell.tui.untrusted_text import MARK, NASTY, dangerous, poisoned, runs

__all__ = ["isolated"]

# Together, so that few walks meet them all: each is alone in the tests of rows and boxes.
MARKUP, ESCAPES, MARKS, LETTERS = (
    "".join(NASTY[name] for name in names)
    for names in (
        ("closing markup", "an action", "a style"),
        ("a colour", "a title", "a C1 colour", "a C1 title", "a clipboard", "clearing"),
        ("direction", "nothing to see", "lines", "control"),
        ("wide", "emoji", "length"),
    )
)
PASTED = (ESCAPES + LETTERS, MARKS, MARKUP)


@pytest.fixture(autouse=True)
def poisoned_outside(
    isolated: None, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Let every answer from outside the screen be the hostile text."""
    text = request.node.callspec.params.get("text", "") if hasattr(request.node, "callspec") else ""

    async def run_command(*words: str) -> str:
        if words[0] == "compare":
            return msgspec.json.encode(_poison(COMPARISON, text)).decode()
        if words[0] == "show":
            return msgspec.json.encode(_poison(SHOWN, text)).decode() + f"\n{text}\n"
        return f"line\n{text}\n"

    async def dry_run(order: Order) -> process.DryRun:
        return typed(_poison(msgspec.to_builtins(PLAN), text), process.DryRun)

    monkeypatch.setattr(process, "run_command", run_command)
    monkeypatch.setattr(process, "dry_run", dry_run)
    monkeypatch.setattr("hilcell.journal.index.read_index", lambda _: runs(text))
    monkeypatch.setattr(start, "summaries", lambda names: dict.fromkeys(names, text))


# Words of the program itself, which no journal and no cell file has in it.
OURS = ("mm", "deg", "finished", "calibrate", "validation", "frames")


def _poison(value: Any, text: str) -> Any:
    if isinstance(value, str):
        return value if value in OURS else value + text
    if isinstance(value, list):
        return [_poison(each, text) for each in value]
    if isinstance(value, dict):
        return {key: _poison(each, text) for key, each in value.items()}
    return value


@pytest.mark.parametrize(
    ("state", "text", "ascii_only"),
    [("suspended", MARKUP + ESCAPES, False), ("fault", MARKS + LETTERS, True)],
)
def test_every_screen_shows_hostile_words_and_does_nothing_by_them(
    state: str, text: str, ascii_only: bool
) -> None:
    async def look(app: Stage, pilot: Press) -> None:
        for name, shown in (await screens_of(app, pilot)).items():
            assert not dangerous(shown), f"{name}: {dangerous(shown)!r}\n{shown}"
            assert shown.isascii() or not ascii_only, f"{name}\n{shown}"
        assert app.is_running

    update = poisoned(state, text)
    app = run_app(look, state, update=update, size=SIZE, ascii_only=ascii_only)
    assert (app.recorded.stops, app.engines) == (0, [])
    assert {command for command, _ in app.recorded.asked} <= {"answer"}


@pytest.mark.parametrize("text", [MARKUP, ESCAPES, MARKS, LETTERS])
def test_what_a_prompt_needs_stays_in_sight(text: str) -> None:
    async def look(app: Stage, pilot: Press) -> None:
        shown = text_of(app)
        for words in (
            "off its place, mm", "● reflector visible", " Enter ", "? NEEDS OPERATOR", "Esc STOP",
        ):  # fmt: skip
            assert words in shown, shown
        box = [line for line in shown.splitlines() if line.startswith(("▌┌", "▌│", "▌└"))]
        assert [cell_len(line) for line in box] == [SIZE[0]] * len(box)

    run_app(look, "suspended", update=poisoned("suspended", text), size=SIZE)


@pytest.mark.parametrize("text", [NASTY["closing markup"]])
def test_markup_is_shown_as_it_was_written(text: str) -> None:
    async def look(app: Stage, pilot: Press) -> None:
        for keys in ((), "l", "h", "o"):
            await press(pilot, *keys)
            assert text in text_of(app), text_of(app)
            await press(pilot, "q")

    run_app(look, "done", update=poisoned("done", text), size=(240, 40))


@on_screen("running", size=SIZE)
async def test_hostile_words_may_be_pasted_into_every_filter(app: Stage, pilot: Press) -> None:
    for keys in (("slash",), ("l", "slash"), ("h", "slash"), ("ctrl+p",)):
        await press(pilot, *keys)
        for text in PASTED:
            app.screen.query_one(Input).value = ""
            app.post_message(Paste(text))
            await settle(pilot)
            assert not dangerous(text_of(app)), text_of(app)
        if not isinstance(app.screen, RunScreen):
            app.pop_screen()
    assert (app.recorded.stops, app.recorded.asked) == (0, [])


@on_screen(size=SIZE)
async def test_hostile_words_may_be_pasted_into_the_form(app: Stage, pilot: Press) -> None:
    async def paste(name: str, text: str) -> None:
        box = app.screen.query_one(f"#{name}", Input)
        box.value = ""
        box.focus()
        app.post_message(Paste(text))
        await settle(pilot)

    for text in PASTED:
        for name in ("cell", "operator", "job"):
            await paste(name, text)
        assert not dangerous(text_of(app)), text_of(app)
        await press(pilot, "enter")
        assert isinstance(app.screen, PlanSummary)
        assert not dangerous(text_of(app)), text_of(app)
        await press(pilot, "q")
        await paste("seed", text)
        await press(pilot, "enter")  # no whole number: no plan, and no question
        assert isinstance(app.screen, StartScreen)
        assert not dangerous(text_of(app)), text_of(app)
        app.screen.query_one("#seed", Input).value = "1"


@pytest.mark.parametrize("text", [NASTY["clearing"]])
def test_refusals_are_cleaned(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    async def refuse(*_: object) -> str:
        raise HilcellError(f"refused: {text}")

    async def look(app: Stage, pilot: Press) -> None:
        for keys in (("o",), ("h", "x", "down", "x", "c")) if app.story else (("enter",),):
            await press(pilot, *keys)
            assert "refused:" in text_of(app)
            assert not dangerous(text_of(app)), text_of(app)
            await press(pilot, "q")

    monkeypatch.setattr(process, "run_command", refuse)
    monkeypatch.setattr(process, "dry_run", refuse)
    for state in ("done", ""):
        run_app(look, state, size=SIZE)


@pytest.mark.parametrize("part", ["cell", "point", "no plan"])
def test_a_journal_of_another_version_is_refused_and_nothing_breaks(part: str) -> None:
    found = fresh("done")
    bodies = {record.seq: dict(record.body) for record in found.records}
    plan, point = 1, next(r.seq for r in found.records if r.kind == "point")
    if part == "cell":
        bodies[plan]["cell"] = {"name": f"[/nope]\x1b[31m{MARK}"}
    elif part == "point":
        bodies[point]["xyz_mm"] = "[/nope]"
    else:
        del bodies[plan]
    records = [
        msgspec.structs.replace(r, body=bodies[r.seq]) for r in found.records if r.seq in bodies
    ]

    async def look(app: Stage, pilot: Press) -> None:
        await press(pilot, "e", "q", "w", "b", "enter", "question_mark", "q")
        app.show_notice(app.recorded.view.trouble)
        await settle(pilot)
        assert "version of hilcell" in text_of(app)
        assert not dangerous(text_of(app))

    run_app(look, update=RunUpdate(records), size=SIZE)


@pytest.mark.parametrize("state", ["checking", "suspended"])
def test_an_engine_whose_journal_cannot_be_read_yet_breaks_nothing(state: str) -> None:
    async def look(app: Stage, pilot: Press) -> None:
        for page in ("e", "i", "l", "p", "question_mark"):
            await press(pilot, page)
        await press(pilot, "q", "w", "b", "enter", "r", "space")
        await press(pilot, "escape")
        assert "STOP sent" in text_of(app)

    run_app(look, update=RunUpdate([], EngineState.ANSWERING, status(state)), size=SIZE)
