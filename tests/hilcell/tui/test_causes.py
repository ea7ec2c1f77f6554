"""Whether an alarm's cause is gone, as a session learns it from the journal."""

from __future__ import annotations

import pytest

from hilcell.tui.run_view import EngineState
from hilcell.tui.session import RunUpdate
from tests.hilcell.tui.recording_app import RUNS, RecordingSession
from tests.hilcell.tui.sample_runs import FAULT, FAULT_TEXT, SampleRun, measuring


def gone(run: SampleRun, engine: EngineState = EngineState.ANSWERING) -> list[bool]:
    """Return which alarms' causes are gone after a run that has asked, and gone on as ``run``."""
    begun = len(asked().records)
    session = RecordingSession(RUNS / "r")
    session.take(RunUpdate(run.records[:begun], EngineState.ANSWERING), run.now)
    assert [each.gone for each in session.latch.standing()] == [""]
    session.take(RunUpdate(run.records[begun:], engine), run.now)
    return [bool(each.gone) for each in session.latch.standing() if each.alarm.code == "HC-T99"]


def asked() -> SampleRun:
    return measuring().state("suspended", reason=FAULT_TEXT, error=FAULT)


def test_a_run_that_goes_on_has_proven_that_the_cause_is_gone() -> None:
    assert gone(asked().state("running")) == [True]


@pytest.mark.parametrize("state", ["aborting", "stopping", "checking"])
def test_a_run_that_does_not_go_on_has_proven_nothing(state: str) -> None:
    assert gone(asked().state(state)) == [False]


def test_an_engine_that_is_gone_has_proven_nothing() -> None:
    assert gone(asked().add("event", what="screen lost"), EngineState.NONE) == [False]
