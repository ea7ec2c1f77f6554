"""An alarm acknowledged on one screen is acknowledged on all of them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from textual.pilot import Pilot

from hilcell.alarms.acknowledged import Acknowledged
from hilcell.journal.journal import Record
from hilcell.run.control import Control
from hilcell.tui.engine.feed import RunUpdate
from hilcell.tui.engine.run_view import EngineState
from hilcell.tui.engine.session import Session, utc_now
from tests.hilcell.run import bed as beds
from tests.hilcell.run.bed import Bed, Live, broken_beam, until
from tests.hilcell.run.rig import Points, procedure
from tests.hilcell.tui.engine_peer import (
    PERIOD_S,
    Peer,
    none_before,
    nothing_left_open,
    says,
    usual,
)
from tests.hilcell.tui.recording_app import RUNS, RecordingApp, RecordingSession, press, run_app
from tests.hilcell.tui.sample_runs import FAULT, FAULT_TEXT, measuring, sample_runs

__all__ = ["none_before", "nothing_left_open"]


@pytest.fixture
def asking(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Live]:
    """A run that asks, because the beam is broken; screens may attend."""
    monkeypatch.setitem(beds.PLAN, "cell", msgspec.to_builtins(beds.CELL))
    bed = Bed(tmp_path, unattended=False)
    bed.tracker.answer = broken_beam(10**6)
    with Live(bed, procedure(Points(1))) as live:
        control = Control(tmp_path, live.runner)
        live.until("state", "suspended")
        yield live
        live.runner.stop()
        control.close()


def screen(folder: Path) -> Session:
    session = Session(folder, lambda update: session.take(update, utc_now()), PERIOD_S)
    session.feed.start()
    until(lambda: bool(session.latch.standing()) and session.feed.client is not None)
    return session


def waiting(session: Session) -> dict[str, bool]:
    """Return the codes that stand, and whether each waits for its acknowledgement."""
    return {each.alarm.code: not each.acknowledged for each in session.latch.standing()}


def test_another_screen_and_a_later_one_know_it(tmp_path: Path, asking: Live) -> None:
    first, second = screen(tmp_path), screen(tmp_path)
    assert waiting(first) == waiting(second) == {"HC-T10": True}
    first.send(first.acknowledge())
    until(lambda: waiting(second) == {"HC-T10": False})
    later = screen(tmp_path)
    assert waiting(later) == {"HC-T10": False}
    (event,) = asking.bed.events("acknowledged")
    assert event["codes"] == ["HC-T10"]
    for each in (first, second, later):
        each.close(leave=True)


def test_an_older_engine_refuses_and_this_screen_alone_knows_it(tmp_path: Path) -> None:
    def older(words: dict[str, Any]) -> bytes:
        refused = says({"ok": False, "error": "commands: status, pause"})
        return refused if words["command"] == "acknowledge" else usual(words)

    run = measuring().state("suspended", reason=FAULT_TEXT, error=FAULT)
    with Peer(tmp_path, older) as peer:
        first = Session(tmp_path, lambda _: None, PERIOD_S)
        first.feed.start()
        peer.until(lambda: "attend" in peer.commands)
        until(lambda: first.feed.client is not None)
        first.take(RunUpdate(run.records, EngineState.ANSWERING), run.now)
        first.send(first.acknowledge())
        peer.until(lambda: "acknowledge" in peer.commands)
        first.take(RunUpdate([], EngineState.ANSWERING), run.now)
        assert waiting(first) == {"HC-T99": False}
        first.close(leave=True)


def test_without_an_engine_this_screen_alone_knows_it(tmp_path: Path) -> None:
    run = sample_runs()["fault"]
    session = Session(tmp_path, lambda _: None, PERIOD_S)
    session.take(RunUpdate(run.records), run.now)
    assert any(waiting(session).values())
    session.send(session.acknowledge())
    assert not any(waiting(session).values())
    session.close(leave=True)


def test_an_alarm_that_came_after_the_last_record_seen_still_waits() -> None:
    run = measuring().state("suspended", reason=FAULT_TEXT, error=FAULT)
    newest = run.records[-1]
    for until_record, waits in ((newest.seq - 1, True), (newest.seq, False)):
        session = RecordingSession(RUNS / "r")
        made = Acknowledged(("HC-T99",), until_record)
        session.take(RunUpdate(run.records, EngineState.ANSWERING), run.now)
        event = Record(newest.seq + 1, newest.t, "event", "", made.event())
        session.take(RunUpdate([event], EngineState.ANSWERING), run.now)
        assert waiting(session) == {"HC-T99": waits}


def test_the_key_sends_the_codes_and_the_last_record_seen() -> None:
    run = measuring().state("suspended", reason=FAULT_TEXT, error=FAULT)

    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        await press(pilot, "k")
        newest = run.records[-1].seq
        assert app.recorded.asked == [
            ("acknowledge", {"codes": ("HC-T99",), "until": newest}),
        ]

    run_app(act, update=RunUpdate(run.records, EngineState.ANSWERING))
