"""What follows a run: the journal as it grows, the engine as it answers, however it fails."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from queue import SimpleQueue

import pytest

from hilcell.errors import HilcellError
from hilcell.journal.journal import Record, StorageError
from hilcell.journal.runs import CALIBRATION
from hilcell.model.point import PointId
from hilcell.run.control import EngineLost, EngineSilent
from hilcell.tui import session as feeds
from hilcell.tui.run_view import EngineState
from hilcell.tui.session import Feed, Inbox, RunUpdate, utc_now
from tests.hilcell.report.journals import Writer
from tests.hilcell.tui.engine_peer import Peer
from tests.hilcell.tui.sample_runs import status
from tests.hilcell.tui.scripted_engine import ScriptedEngine

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
    monkeypatch.setattr(feeds, "EngineClient", engine)
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
    with Peer(tmp_path) as peer:
        screen = Screen(tmp_path)
        update = screen.until(lambda update: update.status)
        assert update.engine is EngineState.ANSWERING
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
    monkeypatch.setattr(feeds.Feed, "REOPEN_S", math.inf)
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
    monkeypatch.setattr(feeds.Feed, "REOPEN_S", -1.0)  # any silence is long
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

    monkeypatch.setattr(feeds, "read_journal", refuse)
    monkeypatch.setattr(feeds, "is_regular_file", unknown)
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


def test_a_status_is_dated_when_it_comes(tmp_path: Path, engine: ScriptedEngine) -> None:
    before, screen = utc_now(), Screen(tmp_path)
    update = screen.until(lambda update: update.status)
    assert update.answered is not None
    assert before <= update.answered <= utc_now()
    screen.close()
