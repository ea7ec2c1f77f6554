"""What a screen keeps hold of: the run it shows, and live ones that it left to look at another."""

from __future__ import annotations

from pathlib import Path

from hilcell.tui.engine.feed import Fresh
from hilcell.tui.engine.open_runs import OpenRuns
from hilcell.tui.engine.scene import EngineState
from hilcell.tui.engine.session import utc_now
from tests.hilcell.tui.stage import Listener


def session(name: str, *, live: bool) -> Listener:
    found = Listener(Path("/runs") / name)
    found.take(Fresh([], EngineState.HEARD if live else EngineState.NONE), utc_now())
    return found


def end(listener: Listener) -> None:
    listener.take(Fresh([], EngineState.NONE), utc_now())


def test_an_ended_run_that_is_left_is_let_go() -> None:
    attached, first, second = OpenRuns(), session("a", live=False), session("b", live=False)
    attached.show(first)
    attached.show(second)
    assert (first.closed, second.closed) == ([True], [])
    assert attached.all == [second]
    assert attached.live == []


def test_a_live_run_that_is_left_keeps_its_line_until_it_ends() -> None:
    attached, live, past = OpenRuns(), session("a", live=True), session("b", live=False)
    attached.show(live)
    attached.show(past)
    assert (live.closed, attached.live, attached.behind) == ([], [live], live)
    assert attached.drop_ended() is None
    end(live)
    assert attached.drop_ended() is live
    assert (live.closed, attached.live, attached.behind) == ([True], [], None)


def test_going_back_takes_the_same_line() -> None:
    attached, live, past = OpenRuns(), session("a", live=True), session("b", live=False)
    attached.show(live)
    attached.show(past)
    attached.show(live)
    assert (attached.shown, attached.behind) == (live, None)
    assert (live.closed, past.closed) == ([], [True])


def test_a_resumed_run_is_not_behind_itself() -> None:
    attached, live, again = OpenRuns(), session("a", live=True), session("a", live=True)
    attached.show(live)
    attached.show(again)
    assert attached.behind is None
    assert live.closed == [True]


def test_another_live_run_is_visited_only() -> None:
    attached, own = OpenRuns(), session("a", live=True)
    first, second = session("b", live=True), session("c", live=True)
    for each in (own, first, second):
        attached.show(each)
    assert (attached.behind, first.closed) == (own, [True])
    attached.show(own)
    assert (attached.all, second.closed, own.closed) == ([own], [True], [])


def test_a_stop_reaches_every_live_run() -> None:
    attached, first, second = OpenRuns(), session("a", live=True), session("b", live=True)
    assert not attached.stop()
    attached.show(first)
    attached.show(second)
    assert attached.stop()
    assert (first.stops, second.stops) == (1, 1)
    end(second)
    assert attached.stop()  # the one shown has ended, the other has not
    assert first.stops == 2


def test_leaving_lets_go_of_all() -> None:
    attached, first, second = OpenRuns(), session("a", live=True), session("b", live=True)
    attached.show(first)
    attached.show(second)
    attached.leave()
    assert (first.closed, second.closed) == ([True], [True])
    assert (attached.shown, attached.behind) == (None, None)
