"""The screen does little while nothing changes but the ages of the readings."""

from __future__ import annotations

import math
import threading
from datetime import timedelta
from types import SimpleNamespace
from typing import Any

import pytest
from textual.screen import Screen

from hilcell.journal.log import Log
from hilcell.tui.app import HilcellApp
from hilcell.tui.run_view import EngineState
from hilcell.tui.screens import pages, run
from hilcell.tui.screens.pages import Pace
from hilcell.tui.screens.run import RunScreen
from hilcell.tui.session import RunUpdate
from hilcell.tui.text import finished, points
from tests.hilcell.tui.all_screens import isolated
from tests.hilcell.tui.recording_app import (
    Press,
    RecordingApp,
    Stage,
    on_screen,
    run_app,
    settle,
    text_of,
)
from tests.hilcell.tui.sample_runs import sample_run

__all__ = ["isolated"]
SIZES = ((80, 24), (140, 45))
SOON = timedelta(seconds=0.3)
COSTLY = (  # each as its caller finds it
    (Screen, "_refresh_layout"),
    (points, "expanded_uncertainty_mm"),
)

pytestmark = pytest.mark.usefixtures("isolated")


@pytest.mark.parametrize("size", SIZES)
def test_ages_alone_lay_nothing_out_and_compute_no_budget(
    size: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = [counted(monkeypatch, owner, name) for owner, name in COSTLY]

    async def let_time_pass(app: Stage, pilot: Press) -> None:
        before = text_of(app)
        for each in calls:
            each.clear()
        app.recorded.tick(sample_run("running").now + SOON)
        app._show()
        await settle(pilot)
        assert text_of(app) != before
        assert calls == [[]] * len(COSTLY)

    run_app(let_time_pass, "running", size=size)


def counted(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str) -> list[str]:
    """Return a list that grows with every call of a function or a method."""
    calls: list[str] = []
    original = getattr(owner, name)

    def count(*args: Any, **facts: Any) -> Any:
        calls.append(name)
        return original(*args, **facts)

    monkeypatch.setattr(owner, name, count)
    return calls


def test_the_tick_leaves_a_screen_that_was_shown_just_now(monkeypatch: pytest.MonkeyPatch) -> None:
    shows = counted(monkeypatch, run.RunScreen, "show")

    async def tick(app: Stage, pilot: Press) -> None:
        shows.clear()
        app._shown_s = math.inf  # just now, however slow the machine is
        super(RecordingApp, app)._tick()
        assert not shows
        app._shown_s = -math.inf  # the engine has been silent for long
        super(RecordingApp, app)._tick()
        assert shows

    run_app(tick, "running", size=SIZES[0])


def test_a_panel_is_drawn_twice_a_second_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    times_s = iter((7.0, 7.4, 7.5, 7.9, 8.1))
    monkeypatch.setattr(pages, "time", SimpleNamespace(monotonic=lambda: next(times_s)))
    pace = Pace()
    assert [pace.is_due() for _ in range(5)] == [True, False, True, False, True]


def test_the_rows_below_fill_their_width_however_soon_they_are_drawn_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Pace, "REDRAW_S", math.inf)

    async def look(app: Stage, pilot: Press) -> None:
        rule = next(line for line in text_of(app).splitlines() if "─ interlocks ─" in line)
        assert rule.partition("│")[0].endswith("─")
        assert len(rule.partition("│")[0]) == app.screen.query_one("#left").size.width + 1

    run_app(look, "running", size=(160, 40))


def test_a_procedure_is_imported_off_the_thread_that_takes_keys(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    threads: list[threading.Thread] = []

    def load(group: str, name: str) -> None:
        threads.append(threading.current_thread())
        raise LookupError(name)

    monkeypatch.setattr(finished, "load_entry", load)
    monkeypatch.setattr(run, "finished_verdict", lambda view: None)

    async def look(app: Stage, pilot: Press) -> None:
        assert threads
        assert threading.main_thread() not in threads

    run_app(look, "done", size=SIZES[0])


def test_updates_that_come_faster_than_they_are_shown_are_shown_as_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """They queued without limit: the screen said RUNNING two minutes after the end."""
    shows = counted(monkeypatch, HilcellApp, "_show")

    async def burst(app: Stage, pilot: Press) -> None:
        shows.clear()
        story = sample_run("running")
        for end in range(2, len(story.records) + 1):
            app.receive(app.recorded, RunUpdate(story.records[end - 1 : end], HEARD))
        app.receive(app.recorded, RunUpdate(ended, EngineState.NONE))
        await settle(pilot)
        assert len(shows) == 1
        assert "ABORTED" in text_of(app)
        assert len(app.recorded.view.log.points) == len(Log(story.records).points)

    HEARD = EngineState.ANSWERING
    running, aborted = sample_run("running"), sample_run("aborted")
    ended = aborted.records[len(running.records) :]
    run_app(burst, update=RunUpdate(running.records[:1], HEARD), size=SIZES[0])


def test_what_was_not_painted_for_long_is_covered_and_then_painted_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    painted = counted(monkeypatch, RunScreen, "refresh")

    async def late(app: Stage, pilot: Press) -> None:
        app._show()
        painted.clear()
        assert not app._is_late()
        app._shown_s = -math.inf
        assert app._is_late()
        app._show()
        assert not app._is_late()
        assert painted
        painted.clear()
        app._show()
        assert not painted

    run_app(late, "running", size=SIZES[0])


@on_screen("done", size=SIZES[0])
async def test_a_run_that_is_over_is_never_late(app: Stage, pilot: Press) -> None:
    app._shown_s = -math.inf
    assert not app._is_late()
