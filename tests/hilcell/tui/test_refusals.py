"""Why a key does nothing: the words, and that they stand exactly where it does nothing."""

from __future__ import annotations

import dataclasses

import pytest

from hilcell.tui.run_view import RunView
from hilcell.tui.session import Session
from hilcell.tui.text.actions import AT_REST, ONE_AT_A_TIME, pause_command, refusal
from tests.hilcell.tui.recording_app import RUNS
from tests.hilcell.tui.sample_runs import LIVE, fresh, measuring, sample_run, sample_runs


def view_of(name: str) -> RunView:
    session = Session(RUNS / "r", lambda _: None, 1.0)
    session.take(fresh(name), sample_run(name).now)
    return session.view


def test_a_run_that_is_aborting_is_being_stopped() -> None:
    session = Session(RUNS / "r", lambda _: None, 1.0)
    sample = measuring().state("aborting")
    session.take(dataclasses.replace(fresh("running"), records=sample.records), sample.now)
    view = session.view
    assert (view.state, pause_command(view)) == ("stopping", "")
    assert refusal("pause", view, background=False, unacknowledged=False) == AT_REST["stopping"]
    assert refusal("stop", view, background=False, unacknowledged=False) == ""


@pytest.mark.parametrize("name", ["new", "pause", "retake"])
@pytest.mark.parametrize("state", ["aborted", "fault", "gone"])
def test_nothing_is_started_while_a_live_run_goes_on_behind(state: str, name: str) -> None:
    view = view_of(state)
    assert refusal(name, view, background=True, unacknowledged=False) == ONE_AT_A_TIME
    assert refusal(name, view, background=False, unacknowledged=False) == ""


@pytest.mark.parametrize("state", sample_runs())
def test_what_goes_on_behind_can_be_stopped_and_left(state: str) -> None:
    view = view_of(state)
    for name in ("stop", "detach"):
        assert refusal(name, view, background=True, unacknowledged=False) == ""
        refused = refusal(name, view, background=False, unacknowledged=False) != ""
        assert refused == (state not in LIVE)


def test_without_a_run_there_is_nothing_to_act_on() -> None:
    assert pause_command(None) == ""
    for name in ("pause", "retake", "acknowledge", "log", "bad"):
        assert refusal(name, None, background=False, unacknowledged=False)
    for name in ("new", "history", "help", "theme", "quit", "find", "mark"):
        assert refusal(name, None, background=False, unacknowledged=False) == ""


@pytest.mark.parametrize("state", ["checking", "stopping", "silent", "done", "intolerant"])
def test_a_refused_space_bar_gives_the_reason(state: str) -> None:
    assert refusal("pause", view_of(state), background=False, unacknowledged=False)
