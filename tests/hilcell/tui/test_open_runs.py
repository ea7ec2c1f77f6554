"""What a screen keeps hold of: the run it shows, and live ones that it left to look at another."""

from __future__ import annotations

from pathlib import Path

from hilcell.tui.run_view import EngineState
from hilcell.tui.screens.base import OpenRuns
from hilcell.tui.session import RunUpdate, utc_now
from tests.hilcell.tui.recording_app import RecordingSession


def session(name: str, *, live: bool) -> RecordingSession:
    found = RecordingSession(Path("/runs") / name)
    found.take(RunUpdate([], EngineState.ANSWERING if live else EngineState.NONE), utc_now())
    return found


def end(session: RecordingSession) -> None:
    session.take(RunUpdate([], EngineState.NONE), utc_now())


def test_an_ended_run_that_is_left_is_let_go() -> None:
    open_runs, first, second = OpenRuns(), session("a", live=False), session("b", live=False)
    open_runs.show(first)
    open_runs.show(second)
    assert (first.closed, second.closed) == ([True], [])
    assert open_runs.all == [second]
    assert open_runs.live == []


def test_a_live_run_that_is_left_keeps_its_line_until_it_ends() -> None:
    open_runs, live, past = OpenRuns(), session("a", live=True), session("b", live=False)
    open_runs.show(live)
    open_runs.show(past)
    assert (live.closed, open_runs.live, open_runs.background) == ([], [live], live)
    assert open_runs.close_ended() is None
    end(live)
    assert open_runs.close_ended() is live
    assert (live.closed, open_runs.live, open_runs.background) == ([True], [], None)


def test_going_back_takes_the_same_line() -> None:
    open_runs, live, past = OpenRuns(), session("a", live=True), session("b", live=False)
    open_runs.show(live)
    open_runs.show(past)
    open_runs.show(live)
    assert (open_runs.shown, open_runs.background) == (live, None)
    assert (live.closed, past.closed) == ([], [True])


def test_a_resumed_run_is_not_behind_itself() -> None:
    open_runs, live, again = OpenRuns(), session("a", live=True), session("a", live=True)
    open_runs.show(live)
    open_runs.show(again)
    assert open_runs.background is None
    assert live.closed == [True]


def test_another_live_run_is_visited_only() -> None:
    open_runs, own = OpenRuns(), session("a", live=True)
    first, second = session("b", live=True), session("c", live=True)
    for each in (own, first, second):
        open_runs.show(each)
    assert (open_runs.background, first.closed) == (own, [True])
    open_runs.show(own)
    assert (open_runs.all, second.closed, own.closed) == ([own], [True], [])


def test_a_stop_reaches_every_live_run() -> None:
    open_runs, first, second = OpenRuns(), session("a", live=True), session("b", live=True)
    assert not open_runs.stop()
    open_runs.show(first)
    open_runs.show(second)
    assert open_runs.stop()
    assert (first.stops, second.stops) == (1, 1)
    end(second)
    assert open_runs.stop()  # the one shown has ended, the other has not
    assert first.stops == 2


def test_leaving_lets_go_of_all() -> None:
    open_runs, first, second = OpenRuns(), session("a", live=True), session("b", live=True)
    open_runs.show(first)
    open_runs.show(second)
    open_runs.leave()
    assert (first.closed, second.closed) == ([True], [True])
    assert (open_runs.shown, open_runs.background) == (None, None)
