"""A session: its feed, its alarms on several screens, and the runs that a screen holds open."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from queue import SimpleQueue
from typing import Any, cast

import msgspec
import pytest

from hilcell.errors import HilcellError
from hilcell.journal.journal import Record, StorageError
from hilcell.journal.runs import CALIBRATION
from hilcell.model.events import AlarmsAcknowledged
from hilcell.model.point import PointId
from hilcell.run.control import Control, EngineLost, EngineSilent
from hilcell.tui import session as sessions
from hilcell.tui.run_view import EngineState
from hilcell.tui.screens.base import OpenRuns
from hilcell.tui.session import Feed, Inbox, RunUpdate, Session, utc_now
from tests.hilcell.report.journals import Writer
from tests.hilcell.run import bed as beds
from tests.hilcell.run.bed import Bed, Live, broken_beam
from tests.hilcell.run.rig import Points, procedure
from tests.hilcell.tui.engine_peer import Peer
from tests.hilcell.tui.recording_app import RUNS, Press, RecordingSession, Stage, press, run_app
from tests.hilcell.tui.sample_runs import (
    FAULT,
    FAULT_TEXT,
    SampleRun,
    measuring,
    sample_run,
    status,
)
from tests.hilcell.tui.scripted_engine import ScriptedEngine


class Process:
    """An engine's process, which a stop may end."""

    ended = False

    def poll(self) -> int | None:
        """Return how it ended."""
        return -15 if self.ended else None

    def terminate(self) -> None:
        """End."""
        self.ended = True


def session_of(folder: Path, process: Process | None = None) -> Session:
    return Session(folder, lambda _: None, 1.0, cast("Any", process))


def test_without_an_engine_nothing_is_asked_or_stopped(tmp_path: Path) -> None:
    session = session_of(tmp_path / "r")
    with pytest.raises(HilcellError) as refused:
        session.ask("pause")
    assert refused.value.code == "HC-J08"
    assert not session.stop()
    session.close(leave=True)


def test_a_stop_that_was_heard_is_known_until_the_run_is_seen_to_have_ended(tmp_path: Path) -> None:
    with Peer(tmp_path) as peer:
        session = session_of(tmp_path)
        session.take(RunUpdate([], engine=EngineState.ANSWERING), utc_now())
        assert session.stop()  # over a line of its own
        peer.until(lambda: peer.commands == ["stop"] and peer.open == 0)
    # By now the stop has ended the engine.
    assert (session.stop(), session.stop_received) == (False, True)
    session.take(RunUpdate([], engine=EngineState.NONE), utc_now())
    assert not session.stop_received  # another engine is another matter
    session.close(leave=True)


def test_an_answer_may_take_as_long_as_a_look_of_the_tracker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = ScriptedEngine()
    monkeypatch.setattr(sessions, "EngineClient", engine)
    session = session_of(tmp_path)
    session.ask("answer")
    assert (engine.asked, engine.timeout_s) == (["answer"], [Session.TIMEOUT_S["answer"]])
    assert engine.open == 0  # a line of its own
    session.close(leave=True)


def test_a_stop_ends_an_engine_that_hears_nobody_yet_and_never_one_that_was_heard(
    tmp_path: Path,
) -> None:
    process = Process()
    session = session_of(tmp_path, process)
    assert session.stop()
    assert process.ended
    assert session.stop()  # said again, it is still so
    process = Process()
    session = session_of(tmp_path, process)
    session.take(RunUpdate([], engine=EngineState.ANSWERING), utc_now())
    session.take(RunUpdate([], engine=EngineState.NONE), utc_now())
    assert not session.stop()
    assert not process.ended


def test_a_status_that_waited_for_a_busy_screen_is_as_old_as_its_answer(tmp_path: Path) -> None:
    """It was dated when it was shown: two minutes late the lamps were green."""
    session, now = session_of(tmp_path), utc_now()
    for late_s, stale in ((0.5, False), (120.0, True)):
        answered = now - timedelta(seconds=late_s)
        session.take(
            RunUpdate([], EngineState.ANSWERING, status("running"), answered=answered), now
        )
        assert session.view.status_age_s == pytest.approx(late_s)
        assert session.view.stale is stale
    session.close(leave=True)


NEVER_S = 1e6  # a period in which only `poll_now` looks


class Screen:
    """Takes what a feed delivers; each poll is asked for."""

    def __init__(self, folder: Path) -> None:
        self._came: SimpleQueue[RunUpdate] = SimpleQueue()
        self.feed = Feed(folder, self._came.put, NEVER_S)
        self.feed.start()

    def next(self) -> RunUpdate:
        """Return what the poll in progress brings, and have the feed poll again."""
        update = self._came.get()
        self.feed.poll_now()
        return update

    def until(self, true: Callable[[RunUpdate], object]) -> RunUpdate:
        """Poll until a poll brings something; return it."""
        while not true(update := self.next()):
            continue
        return update

    def close(self, *, leave: bool = True) -> None:
        """End, and wait for the thread."""
        self.feed.close(leave=leave)
        for thread in threading.enumerate():
            if thread.name == "feed":
                thread.join()


@pytest.fixture
def engine(monkeypatch: pytest.MonkeyPatch) -> ScriptedEngine:
    """Return the engine of every run."""
    engine = ScriptedEngine()
    monkeypatch.setattr(sessions, "EngineClient", engine)
    return engine


def test_it_brings_the_journal_and_then_what_is_new(tmp_path: Path) -> None:
    """Of a run whose journal is written after the first poll."""
    screen = Screen(tmp_path / "r")
    assert screen.next().trouble == ""
    writer = Writer(tmp_path / "r").began()
    kinds: list[str] = []
    while "frame" not in kinds:  # the last that began; a poll may come between two records
        update = screen.until(lambda update: update.records)
        assert (update.engine, update.status) == (EngineState.NONE, None)
        kinds += [record.kind for record in update.records]
    assert kinds == ["plan", "state", "event", "state", "frame"]
    writer.point(PointId("grid", target="0"), (1.0, 2.0, 3.0))
    second = screen.until(lambda update: update.records)
    assert [record.key for record in second.records] == ["grid/0"]
    screen.close()
    writer.left()


def test_it_attends_asks_and_leaves(tmp_path: Path) -> None:
    before = utc_now()
    with Peer(tmp_path) as peer:
        screen = Screen(tmp_path)
        update = screen.until(lambda update: update.status)
        assert update.engine is EngineState.ANSWERING
        assert update.answered is not None
        assert before <= update.answered <= utc_now()
        assert update.status is not None
        assert update.status.devices["rail"].text == "1100.20 mm"
        assert peer.commands == ["attend"]
        screen.close(leave=True)
        peer.until(lambda: peer.open == 0)
        assert peer.commands == ["attend", "leave"]


def test_a_screen_that_is_lost_does_not_leave(tmp_path: Path, engine: ScriptedEngine) -> None:
    screen = Screen(tmp_path)
    screen.until(lambda update: update.status)
    screen.close(leave=False)
    assert set(engine.asked) == {"attend", "status"}
    assert engine.open == 0


@pytest.mark.parametrize(
    ("answer", "state", "lines"),
    [
        (EngineSilent("no answer"), EngineState.SILENT, 1),
        (EngineLost("it has hung up"), EngineState.NONE, 2),
        (HilcellError("the answer makes no sense"), EngineState.ANSWERING, 1),
    ],
)
def test_an_engine_with_bad_answers_is_asked_again(
    answer: HilcellError,
    state: EngineState,
    lines: int,
    tmp_path: Path,
    engine: ScriptedEngine,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Feed, "REOPEN_S", math.inf)
    screen = Screen(tmp_path)
    screen.until(lambda update: update.status)
    engine.answer = answer
    assert screen.until(lambda update: update.status is None).engine is state
    engine.answer = None
    assert screen.until(lambda update: update.status).engine is EngineState.ANSWERING
    screen.close()
    assert engine.asked.count("attend") == lines


def test_a_line_that_is_silent_for_long_is_opened_again(
    tmp_path: Path, engine: ScriptedEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Feed, "REOPEN_S", -1.0)  # any silence is long
    screen = Screen(tmp_path)
    screen.until(lambda update: update.status)
    engine.answer = EngineSilent("no answer")
    screen.until(lambda update: update.engine is EngineState.SILENT)
    engine.answer = None
    screen.until(lambda update: update.status)
    screen.close()
    assert engine.asked.count("attend") >= 2
    assert engine.open == 0


def test_closing_while_a_line_is_being_opened_leaves_nothing_open(
    tmp_path: Path, engine: ScriptedEngine
) -> None:
    engine.may_open.clear()
    screen = Screen(tmp_path)
    engine.opening.wait()
    screen.feed.close(leave=True)
    engine.may_open.set()
    screen.close()
    assert (engine.open, engine.asked[-1]) == (0, "leave")


def test_a_folder_without_permission_is_reported_at_each_look(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise StorageError("permission denied")

    def unknown(_: Path) -> bool:
        raise PermissionError

    monkeypatch.setattr(sessions, "read_journal", refuse)
    monkeypatch.setattr(sessions, "is_regular_file", unknown)
    screen = Screen(tmp_path)
    assert [screen.next().trouble for _ in range(2)] == ["permission denied"] * 2
    screen.close()


@pytest.mark.parametrize("written", [True, False])
def test_it_tells_whether_a_calibration_has_its_file(tmp_path: Path, written: bool) -> None:
    Writer(tmp_path).began().left()
    if written:
        (tmp_path / CALIBRATION).write_text("{}")
    screen = Screen(tmp_path)
    assert screen.until(lambda update: update.records).calibrated == written
    screen.close()


def test_a_damaged_journal_is_reported(tmp_path: Path) -> None:
    (tmp_path / "journal.sqlite").write_bytes(b"no journal at all, but long enough to be one")
    screen = Screen(tmp_path)
    assert screen.next().trouble
    screen.close()


def record(seq: int) -> Record:
    return Record(seq, "2026-03-04T08:00:00.000+00:00", "event", "", {"what": "step"})


def test_updates_that_nobody_has_seen_become_one_with_all_records_and_the_newest_state() -> None:
    inbox, heard = Inbox(), status("running")
    at = datetime(2026, 3, 4, 8, 0, tzinfo=UTC)
    first = RunUpdate([record(1)], EngineState.ANSWERING, heard, answered=at)
    assert [inbox.put(first), inbox.put(RunUpdate([record(2)], EngineState.SILENT))] == [
        True,
        False,
    ]
    assert not inbox.put(RunUpdate([record(3), record(4)], EngineState.NONE, trouble="why"))
    update = inbox.take()
    assert update is not None
    assert [each.seq for each in update.records] == [1, 2, 3, 4]
    assert (update.engine, update.trouble) == (EngineState.NONE, "why")
    assert (update.status, update.answered) == (heard, at)  # of when it was heard
    assert inbox.take() is None
    assert inbox.put(first)


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


class SharedScreen:
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


def asked() -> SampleRun:
    return measuring().state("suspended", reason=FAULT_TEXT, error=FAULT)


def test_another_screen_and_a_later_one_know_it(tmp_path: Path, asking: Live) -> None:
    first, second = SharedScreen(tmp_path), SharedScreen(tmp_path)
    assert waiting(first.session) == waiting(second.session) == {"HC-T10": True}
    first.session.send(first.session.acknowledge())
    second.until(lambda: waiting(second.session) == {"HC-T10": False})
    later = SharedScreen(tmp_path)
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
    run = asked()
    newest = run.records[-1]
    for until_record, waits in ((newest.seq - 1, True), (newest.seq, False)):
        session = RecordingSession(RUNS / "r")
        made = AlarmsAcknowledged(codes=["HC-T99"], until=until_record)
        session.take(RunUpdate(run.records, EngineState.ANSWERING), run.now)
        event = Record(newest.seq + 1, newest.t, "event", "", msgspec.to_builtins(made))
        session.take(RunUpdate([event], EngineState.ANSWERING), run.now)
        assert waiting(session) == {"HC-T99": waits}


def test_the_key_sends_the_codes_and_the_last_record_seen() -> None:
    run = asked()

    async def act(app: Stage, pilot: Press) -> None:
        await press(pilot, "k")
        newest = run.records[-1].seq
        assert app.recorded.asked == [("acknowledge", {"codes": ("HC-T99",), "until": newest})]

    run_app(act, update=RunUpdate(run.records, EngineState.ANSWERING))


def gone(run: SampleRun, engine: EngineState = EngineState.ANSWERING) -> list[bool]:
    """Return which alarms' causes are gone after a run that has asked, and gone on as ``run``."""
    begun = len(asked().records)
    session = RecordingSession(RUNS / "r")
    session.take(RunUpdate(run.records[:begun], EngineState.ANSWERING), run.now)
    assert [each.gone for each in session.latch.standing()] == [""]
    session.take(RunUpdate(run.records[begun:], engine), run.now)
    return [bool(each.gone) for each in session.latch.standing() if each.alarm.code == "HC-T99"]


def test_only_a_run_that_goes_on_has_proven_that_the_cause_is_gone() -> None:
    assert gone(asked().state("running")) == [True]
    for state in ("aborting", "stopping", "checking"):
        assert gone(asked().state(state)) == [False]
    assert gone(asked().add("event", what="screen lost"), EngineState.NONE) == [False]


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
