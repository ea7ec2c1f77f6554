"""The application in a test: a terminal of any size, a session that only records commands."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Awaitable, Callable
from contextlib import suppress
from datetime import datetime
from itertools import count
from pathlib import Path
from typing import Any, Unpack

import pytest
from textual._compositor import Compositor
from textual._context import visible_screen_stack
from textual.app import App
from textual.css.model import RuleSet
from textual.css.stylesheet import Stylesheet
from textual.events import Key
from textual.message_pump import MessagePump
from textual.pilot import Pilot
from textual.screen import Screen
from textual.strip import Strip
from textual.worker import WorkerCancelled

from hilcell.run.control import Command, Subject
from hilcell.tui.app import HilcellApp
from hilcell.tui.keys import ACTIONS, Keymap
from hilcell.tui.screens.base import BaseScreen, Options
from hilcell.tui.screens.help import HelpPage
from hilcell.tui.screens.pages import (
    AlarmPage,
    HistoryPage,
    InterlockPage,
    LogPage,
    PlotPage,
    ReportPage,
)
from hilcell.tui.screens.run import RunScreen
from hilcell.tui.screens.start import StartScreen
from hilcell.tui.session import RunUpdate, Session
from hilcell.tui.terminal import ASCII, UNICODE
from tests.hilcell.tui.sample_runs import BEGAN, RUN, fresh, sample_run

DEFAULT_KEYS = {action.name: action.keys for action in ACTIONS}
SIZE = (80, 24)
ROUNDS = 9  # more than any key needs
BURSTS = count(1)  # each comes at a second of its own
PARSED: dict[tuple[object, ...], list[RuleSet]] = {}  # rules of style sheets, of all applications
LETTERS = {"space": " ", "slash": "/", "question_mark": "?"}


class RecordingSession(Session):
    """A session whose commands are written down; its stop and its end, too."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, lambda _: None, 0.25)
        self.asked: list[tuple[str, Subject]] = []
        self.stops = 0
        self.closed: list[bool] = []  # whether it was left on purpose

    def ask(self, command: Command, **subject: Unpack[Subject]) -> None:
        """Write a command down."""
        self.asked.append((command, subject))

    def stop(self) -> bool:
        """Count a stop, where an engine would hear it."""
        self.stops += self.view.live
        return self.view.live

    def close(self, *, leave: bool) -> None:
        """Write the end down."""
        self.closed.append(leave)
        super().close(leave=leave)


class RecordingApp(HilcellApp):
    """Opens a made-up run in place of looking for one; without a run, the form."""

    def __init__(self, options: Options, name: str = "", update: RunUpdate | None = None) -> None:
        super().__init__(options)
        self.recorded = RecordingSession(options.runs / (options.run or RUN))
        self.story, self.update = name, update
        self.at_rest: list[Strip] = []  # the lines of the terminal as `settle` has painted them
        self.engines: list[tuple[Path, list[str]]] = []  # that would have been started

    def start_engine(self, folder: Path, arguments: list[str]) -> None:
        """Write down with what an engine would have been started."""
        self.engines.append((folder, arguments))

    async def _open(self) -> None:
        while len(self.screen_stack) > 1:
            self.pop_screen()
        if not self.story and self.update is None:
            self.push_screen(StartScreen())
            return
        self.open_runs.show(self.recorded)
        self.recorded.take(self.update or fresh(self.story), self._now())
        self.push_screen(RunScreen())

    def _now(self) -> datetime:
        return sample_run(self.story).now if self.story else BEGAN

    def _tick(self) -> None:
        """Time stands still on this stage."""


def options(
    folder: Path, *, ascii_only: bool = False, theme: str = "calm", keymap: Keymap | None = None
) -> Options:
    """Return how the stage is set."""
    glyphs = ASCII if ascii_only else UNICODE
    return Options(runs=folder, keymap=keymap or DEFAULT_KEYS, glyphs=glyphs, theme=theme)


def paint_at_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Paint only what stands when all is done, by `settle`: no terminal takes what is between."""

    def render_update(self: Compositor, *, screen_stack: list[Screen[Any]] | None = None) -> None:
        self._dirty_regions.clear()

    monkeypatch.setattr(Compositor, "render_update", render_update)


def parse_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parse each style sheet once for all applications: a fifth of the start of each."""
    parse = Stylesheet._parse_rules

    def _parse_rules(self: Stylesheet, css: str, **place: Any) -> list[RuleSet]:
        key = (css, *place.items(), *sorted(self._variables.items()))
        if key not in PARSED:
            PARSED[key] = parse(self, css, **place)
        return PARSED[key]

    monkeypatch.setattr(Stylesheet, "_parse_rules", _parse_rules)


async def settle(pilot: Pilot[int]) -> None:
    """Wait until what was begun in the background is done and painted.

    By messages and not by seconds, so that a slow machine sees what a fast one sees.
    """
    await _done(pilot)
    _paint(pilot.app)


def _paint(app: App[int]) -> None:
    if app.is_running:
        strips = painted(app)  # what cannot be painted breaks the test
        if isinstance(app, RecordingApp):
            app.at_rest = strips


async def _done(pilot: Pilot[int]) -> None:
    for _ in range(ROUNDS):
        await _round(pilot)
        if _is_quiet(pilot.app):
            break
        with suppress(WorkerCancelled):  # a screen that was left takes its work along
            await pilot.app.workers.wait_for_complete()


def _is_quiet(app: App[int]) -> bool:
    """Whether nobody has work, or a message that is not dealt with."""
    if not app.screen_stack or any(not worker.is_finished for worker in app.workers):
        return False
    nodes: list[MessagePump] = [app, *app.screen_stack, *app.screen.walk_children()]
    return not any(node.message_queue_size or node._next_callbacks for node in nodes)


async def _round(pilot: Pilot[int]) -> None:
    await pilot._wait_for_screen()
    await asyncio.sleep(0)
    if pilot.app.screen_stack:
        for screen in (*pilot.app._background_screens, pilot.app.screen):
            running: asyncio.Event = screen._update_timer._active
            if running.is_set():  # else the screen above would paint all again, each time
                screen._on_timer_update()


async def until(pilot: Pilot[int], true: Callable[[], object]) -> None:
    """Wait until something is so; an application that has ended by an error ends the wait."""
    while not true():
        assert pilot.app._exception is None, pilot.app._exception
        assert pilot.app.is_running, "the application has ended"
        await pilot.pause()


async def press(pilot: Pilot[int], *keys: str) -> None:
    """Press keys as a person does, each once what the one before began is done; paint at the end.

    Nobody looks between keys of a row, and other tests paint what each leaves by itself.
    """
    for key in keys:
        type_ahead(pilot.app, key)
        await _done(pilot)
    _paint(pilot.app)


def type_ahead(app: App[int], *keys: str) -> None:
    """Press keys in one burst, long after the last, and wait for nothing."""
    at_s = float(next(BURSTS))
    for key in keys:
        event = Key(key, key if len(key) == 1 else LETTERS.get(key))
        event.time = at_s
        app.post_message(event)


def painted(app: App[int]) -> list[Strip]:
    """Return the lines of the terminal."""
    visible_screen_stack.set(app._background_screens)
    return app.screen._compositor.render_strips()


def text_of(app: HilcellApp) -> str:
    """Return what the terminal shows, without spaces at the ends of lines."""
    return _text(painted(app))


def text_at_rest(app: RecordingApp) -> str:
    """Return the same right after `settle` or `press`, whose painting it is."""
    return _text(app.at_rest)


def _text(strips: list[Strip]) -> str:
    lines = ["".join(segment.text for segment in strip).rstrip() for strip in strips]
    return "\n".join(lines) + "\n"


RUNS = Path("/runs")
ROOMY = (137, 24)  # as wide as it gets without panels beside the table
PAGES: dict[str, type[BaseScreen]] = {
    "e": AlarmPage,
    "i": InterlockPage,
    "l": LogPage,
    "p": PlotPage,
    "question_mark": HelpPage,
    "h": HistoryPage,
    "o": ReportPage,
}

# What a test is given. Names of types stand in one line each: mypy takes no tuple of them.
Stage = RecordingApp
Press = Pilot[int]
Act = Callable[[RecordingApp, Pilot[int]], Awaitable[None]]


def run_app(
    act: Act,
    state: str = "",
    *,
    update: RunUpdate | None = None,
    size: tuple[int, int] = ROOMY,
    **stage: Any,
) -> RecordingApp:
    """Put a state on the stage, do something there, and return what is left of it."""
    app = RecordingApp(options(RUNS, **stage), state, update)

    async def run() -> None:
        async with app.run_test(size=size) as pilot:
            await settle(pilot)
            await act(app, pilot)

    asyncio.run(run())
    return app


def on_screen(state: str = "", **stage: Any) -> Callable[[Callable[..., Any]], Callable[..., None]]:
    """Run a test on the screen of a state; its own ``state``, ``update`` or ``size`` come first."""

    def decorated(test: Callable[..., Any]) -> Callable[..., None]:
        def run(**given: Any) -> None:
            own: dict[str, Any] = {"state": state} | stage
            own |= {name: given[name] for name in ("state", "update", "size") if name in given}
            run_app(lambda app, pilot: test(app, pilot, **given), **own)

        run.__name__, run.__doc__, run.__module__ = test.__name__, test.__doc__, test.__module__
        signature = inspect.signature(test)
        _, _, *parameters = signature.parameters.values()  # app and pilot are no fixtures
        run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        run.pytestmark = getattr(test, "pytestmark", [])  # type: ignore[attr-defined]
        return run

    return decorated


def footer(app: RecordingApp) -> str:
    return text_of(app).splitlines()[-1]
