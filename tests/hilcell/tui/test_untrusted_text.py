"""Hostile words on every screen: nothing crashes, nothing acts, nothing is printed raw."""

from __future__ import annotations

import asyncio
from pathlib import Path
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
from tests.hilcell.tui.recording_app import SIZE, RecordingApp, options, press, settle, text_of
from tests.hilcell.tui.sample_runs import fresh, status
from tests.hilcell.tui.untrusted_text import MARK, NASTY, dangerous, poisoned, runs

__all__ = ["isolated"]

RUNS = Path("/runs")
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
    async def run_app() -> dict[str, str]:
        app = RecordingApp(options(RUNS, ascii_only=ascii_only), state, poisoned(state, text))
        async with app.run_test(size=SIZE) as pilot:
            seen = await screens_of(app, pilot)
            assert app.is_running
        assert (app.recorded.stops, app.engines) == (0, [])
        assert {command for command, _ in app.recorded.asked} <= {"answer"}
        return seen

    for name, shown in asyncio.run(run_app()).items():
        assert not dangerous(shown), f"{name}: {dangerous(shown)!r}\n{shown}"
        assert shown.isascii() or not ascii_only, f"{name}\n{shown}"


@pytest.mark.parametrize("text", [MARKUP, ESCAPES, MARKS, LETTERS])
def test_what_a_prompt_needs_stays_in_sight(text: str) -> None:
    async def run_app() -> str:
        app = RecordingApp(options(RUNS), "suspended", poisoned("suspended", text))
        async with app.run_test(size=SIZE) as pilot:
            await settle(pilot)
            return text_of(app)

    shown = asyncio.run(run_app())
    for words in (
        "off its place, mm",
        "● reflector visible",
        " Enter ",
        "? NEEDS OPERATOR",
        "Esc STOP",
    ):
        assert words in shown, shown
    box = [line for line in shown.splitlines() if line.startswith(("▌┌", "▌│", "▌└"))]
    assert [cell_len(line) for line in box] == [SIZE[0]] * len(box)


@pytest.mark.parametrize("text", [NASTY["closing markup"]])
def test_markup_is_shown_as_it_was_written(text: str) -> None:
    async def run_app() -> dict[str, str]:
        app = RecordingApp(options(RUNS), "done", poisoned("done", text))
        seen = {}
        async with app.run_test(size=(240, 40)) as pilot:
            await settle(pilot)
            for name, keys in (("run", ()), ("log", ("l",)), ("history", ("h",)), ("report", "o")):
                await press(pilot, *keys)
                seen[name] = text_of(app)
                await press(pilot, "q")
        return seen

    for shown in asyncio.run(run_app()).values():
        assert text in shown, shown


def test_hostile_words_may_be_pasted_into_every_filter() -> None:
    async def run_app() -> None:
        app = RecordingApp(options(RUNS), "running")
        async with app.run_test(size=SIZE) as pilot:
            await settle(pilot)
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

    asyncio.run(run_app())


def test_hostile_words_may_be_pasted_into_the_form() -> None:
    async def run_app() -> None:
        app = RecordingApp(options(RUNS))
        async with app.run_test(size=SIZE) as pilot:
            await settle(pilot)
            for text in PASTED:
                for name in ("cell", "operator", "job"):
                    app.screen.query_one(f"#{name}", Input).value = ""
                    app.screen.query_one(f"#{name}", Input).focus()
                    app.post_message(Paste(text))
                    await settle(pilot)
                assert not dangerous(text_of(app)), text_of(app)
                await press(pilot, "enter")
                assert isinstance(app.screen, PlanSummary)
                assert not dangerous(text_of(app)), text_of(app)
                await press(pilot, "q")
                seed = app.screen.query_one("#seed", Input)
                seed.value = ""
                seed.focus()
                app.post_message(Paste(text))
                await press(pilot, "enter")  # no whole number: no plan, and no question
                assert isinstance(app.screen, StartScreen)
                assert not dangerous(text_of(app)), text_of(app)
                seed.value = "1"

    asyncio.run(run_app())


@pytest.mark.parametrize("text", [NASTY["clearing"]])
def test_refusals_are_cleaned(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    async def refuse(*_: object) -> str:
        raise HilcellError(f"refused: {text}")

    monkeypatch.setattr(process, "run_command", refuse)
    monkeypatch.setattr(process, "dry_run", refuse)

    async def run_app() -> None:
        app = RecordingApp(options(RUNS), "done")
        async with app.run_test(size=SIZE) as pilot:
            await settle(pilot)
            for keys in (("o",), ("h", "x", "down", "x", "c")):
                await press(pilot, *keys)
                assert "refused:" in text_of(app)
                assert not dangerous(text_of(app)), text_of(app)
                await press(pilot, "q")
        form = RecordingApp(options(RUNS))
        async with form.run_test(size=SIZE) as pilot:
            await settle(pilot)
            await press(pilot, "enter")
            assert "refused:" in text_of(form)
            assert not dangerous(text_of(form)), text_of(form)

    asyncio.run(run_app())


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

    async def run_app() -> str:
        app = RecordingApp(options(RUNS), update=RunUpdate(records))
        async with app.run_test(size=SIZE) as pilot:
            await settle(pilot)
            await press(pilot, "e", "q", "w", "b", "enter", "question_mark", "q")
            app.show_notice(app.recorded.view.trouble)
            await settle(pilot)
            return text_of(app)

    shown = asyncio.run(run_app())
    assert "version of hilcell" in shown
    assert not dangerous(shown)


@pytest.mark.parametrize("state", ["checking", "suspended"])
def test_an_engine_whose_journal_cannot_be_read_yet_breaks_nothing(state: str) -> None:
    async def run_app() -> str:
        app = RecordingApp(
            options(RUNS), update=RunUpdate([], engine=EngineState.ANSWERING, status=status(state))
        )
        async with app.run_test(size=SIZE) as pilot:
            await settle(pilot)
            for page in ("e", "i", "l", "p", "question_mark"):
                await press(pilot, page)
            await press(pilot, "q", "w", "b", "enter", "r", "space")
            await press(pilot, "escape")
            return text_of(app)

    assert "STOP sent" in asyncio.run(run_app())
