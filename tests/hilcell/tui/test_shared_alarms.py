"""An alarm acknowledged on one screen is acknowledged on all of them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest
from textual.pilot import Pilot

from hilcell.journal.journal import Record
from hilcell.model.events import AlarmsAcknowledged
from hilcell.run.control import Control
from hilcell.tui.run_view import EngineState
from hilcell.tui.session import RunUpdate, Session, utc_now
from tests.hilcell.run import bed as beds
from tests.hilcell.run.bed import Bed, Live, broken_beam
from tests.hilcell.run.rig import Points, procedure
from tests.hilcell.tui.recording_app import RUNS, RecordingApp, RecordingSession, press, run_app
from tests.hilcell.tui.sample_runs import FAULT, FAULT_TEXT, measuring, sample_run

PERIOD_S = 0.02


@pytest.fixture
def asking(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Live]:
    """A run that asks, because the beam is broken; screens may attend."""
    monkeypatch.setitem(beds.PLAN, "cell", msgspec.to_builtins(beds.CELL))
    monkeypatch.setattr("hilcell.run.control.ANSWER_S", 600.0)  # a slow machine is not silent
    bed = Bed(tmp_path, unattended=False)
    bed.tracker.answer = broken_beam(10**6)
    with Live(bed, procedure(Points(1))) as live:
        control = Control(tmp_path, live.runner)
        live.until("state", "suspended")
        yield live
        live.runner.stop()
        control.close()


class Screen:
    """A session that takes what its feed brings."""

    def __init__(self, folder: Path) -> None:
        self._looked = threading.Condition()
        self.session = Session(folder, self._take, PERIOD_S)
        self.session.feed.start()
        self.until(lambda: bool(waiting(self.session)) and self.session.feed.client is not None)

    def _take(self, update: RunUpdate) -> None:
        with self._looked:
            self.session.take(update, utc_now())
            self._looked.notify_all()

    def until(self, true: Callable[[], bool]) -> None:
        """Wait until something is so after a look."""
        with self._looked:
            self._looked.wait_for(true)


def waiting(session: Session) -> dict[str, bool]:
    """Return the codes that stand, and whether each waits for its acknowledgement."""
    return {each.alarm.code: not each.acknowledged for each in session.latch.standing()}


def test_another_screen_and_a_later_one_know_it(tmp_path: Path, asking: Live) -> None:
    first, second = Screen(tmp_path), Screen(tmp_path)
    assert waiting(first.session) == waiting(second.session) == {"HC-T10": True}
    first.session.send(first.session.acknowledge())
    second.until(lambda: waiting(second.session) == {"HC-T10": False})
    later = Screen(tmp_path)
    assert waiting(later.session) == {"HC-T10": False}
    (event,) = asking.bed.events("acknowledged")
    assert event["codes"] == ["HC-T10"]
    for each in (first, second, later):
        each.session.close(leave=True)


def test_without_an_engine_this_screen_alone_knows_it(tmp_path: Path) -> None:
    run = sample_run("fault")
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
        made = AlarmsAcknowledged(codes=["HC-T99"], until=until_record)
        session.take(RunUpdate(run.records, EngineState.ANSWERING), run.now)
        event = Record(newest.seq + 1, newest.t, "event", "", msgspec.to_builtins(made))
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
