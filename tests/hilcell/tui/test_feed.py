"""What follows a run: the journal as it grows, the engine as it answers, however it fails."""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from hilcell.journal.point_id import PointId
from hilcell.journal.runs import CALIBRATION
from hilcell.tui.engine.feed import Feed, RunUpdate
from hilcell.tui.engine.run_view import EngineState
from tests.hilcell.report.journals import Writer
from tests.hilcell.tui.engine_peer import (
    LIMIT_S,
    PERIOD_S,
    SILENCE,
    STATUS,
    PauseGate,
    Peer,
    none_before,
    nothing_left_open,
    says,
    short,
    usual,
)

__all__ = ["none_before", "nothing_left_open", "short"]


class Screen:
    """Takes what a feed delivers."""

    def __init__(self, folder: Path) -> None:
        self.update: list[RunUpdate] = []
        self._looked = 0
        self._came = threading.Condition()
        self.feed = Feed(folder, self._take, PERIOD_S)

    def _take(self, fresh: RunUpdate) -> None:
        with self._came:
            self.update.append(fresh)
            self._came.notify_all()

    def until(self, true: Callable[[RunUpdate], bool]) -> RunUpdate:
        """Wait for a look that brings something, after those already returned; return it."""
        with self._came:
            assert self._came.wait_for(lambda: any(map(true, self.update[self._looked :])), LIMIT_S)
            while not true(self.update[self._looked]):
                self._looked += 1
            self._looked += 1
            return self.update[self._looked - 1]

    def close(self, *, leave: bool = True) -> None:
        """End, and wait for the thread."""
        self.feed.close(leave=leave)
        self.feed._thread.join(LIMIT_S)
        assert not self.feed._thread.is_alive()


def journal(folder: Path) -> Writer:
    return Writer(folder).began()


def test_it_brings_the_journal_and_then_what_is_new(tmp_path: Path) -> None:
    writer = journal(tmp_path / "r")
    screen = Screen(tmp_path / "r")
    screen.feed.start()
    first = screen.until(lambda fresh: bool(fresh.records))
    assert [record.kind for record in first.records][:2] == ["plan", "state"]
    assert (first.engine, first.status) == (EngineState.NONE, None)
    writer.point(PointId("grid", target="0"), (1.0, 2.0, 3.0))
    second = screen.until(lambda fresh: bool(fresh.records))
    assert [record.key for record in second.records] == ["grid/0"]
    screen.close()
    writer.left()


def test_it_attends_asks_and_leaves(tmp_path: Path) -> None:
    with Peer(tmp_path) as peer:
        screen = Screen(tmp_path)
        screen.feed.start()
        fresh = screen.until(lambda fresh: fresh.status is not None)
        assert fresh.engine is EngineState.ANSWERING
        assert fresh.status is not None
        assert fresh.status.devices["rail"].text == "1100.20 mm"
        assert peer.commands == ["attend"]
        screen.close(leave=True)
        peer.until(lambda: peer.open == 0)
        assert peer.commands == ["attend", "leave"]


def test_leaving_waits_for_the_answer_that_is_owed(tmp_path: Path) -> None:
    gate = PauseGate("status")
    with Peer(tmp_path, gate.answer) as peer:
        screen = Screen(tmp_path)
        screen.feed.start()
        assert gate.asked.wait(LIMIT_S)
        threading.Timer(0.05, gate.open.set).start()
        screen.close(leave=True)
        peer.until(lambda: peer.open == 0)
        assert peer.commands == ["attend", "leave"]


def test_a_screen_that_is_lost_does_not_leave(tmp_path: Path) -> None:
    with Peer(tmp_path) as peer:
        screen = Screen(tmp_path)
        screen.feed.start()
        screen.until(lambda fresh: fresh.status is not None)
        screen.close(leave=False)
        peer.until(lambda: peer.open == 0)
        assert peer.commands == ["attend"]


def test_a_screen_that_is_killed_does_not_leave(tmp_path: Path) -> None:
    code = (
        "import sys, time; from pathlib import Path; from hilcell.tui.engine.feed import Feed; "
        "Feed(Path(sys.argv[1]), lambda _: None, 0.02).start(); time.sleep(60)"
    )
    with Peer(tmp_path) as peer:
        killed = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)])
        peer.until(lambda: "attend" in peer.commands, 30.0)
        killed.send_signal(signal.SIGKILL)
        killed.wait()
        peer.until(lambda: peer.open == 0)
        assert peer.commands == ["attend"]


def test_a_line_that_ends_is_opened_again(tmp_path: Path) -> None:
    with Peer(tmp_path) as peer:
        screen = Screen(tmp_path)
        screen.feed.start()
        screen.until(lambda fresh: fresh.status is not None)
        peer.hang_up()
        screen.until(lambda fresh: fresh.status is None)
        peer.until(lambda: peer.commands.count("attend") == 2)
        assert screen.until(lambda fresh: fresh.status is not None).engine is EngineState.ANSWERING
        screen.close()
        peer.until(lambda: peer.open == 0)


@pytest.mark.parametrize("answer", [SILENCE, b"garbage\n", None], ids=["silence", "garbage", "end"])
def test_an_engine_with_bad_answers_is_asked_again(tmp_path: Path, answer: bytes | None) -> None:
    mad = threading.Event()

    def sometimes(words: dict[str, str]) -> bytes | None:
        return answer if mad.is_set() else usual(words)

    with Peer(tmp_path, sometimes) as peer:
        screen = Screen(tmp_path)
        screen.feed.start()
        screen.until(lambda fresh: fresh.status is not None)
        mad.set()
        lost = screen.until(lambda fresh: fresh.status is None)
        assert lost.engine is (EngineState.SILENT if answer == SILENCE else EngineState.NONE)
        mad.clear()
        assert screen.until(lambda fresh: fresh.status is not None).engine is EngineState.ANSWERING
        screen.close()
        peer.until(lambda: peer.open == 0)


@pytest.mark.parametrize(
    "reported",
    [
        {"ok": False, "error": "no"},
        {"ok": True},
        STATUS | {"devices": 5},
        STATUS | {"prompt": {"title": 3}},
        STATUS | {"retakes": [None]},
    ],
)
def test_a_status_that_makes_no_sense_leaves_the_last_to_grow_stale(
    tmp_path: Path, reported: dict[str, object]
) -> None:
    odd = threading.Event()

    def answer(words: dict[str, str]) -> bytes:
        return says(reported) if odd.is_set() else usual(words)

    with Peer(tmp_path, answer):
        screen = Screen(tmp_path)
        screen.feed.start()
        screen.until(lambda fresh: fresh.status is not None)
        odd.set()
        assert screen.until(lambda fresh: fresh.status is None).engine is EngineState.ANSWERING
        odd.clear()
        screen.until(lambda fresh: fresh.status is not None)
        screen.close()


def test_an_engine_that_only_stood_still_is_heard_on_the_same_line(tmp_path: Path) -> None:
    gate = PauseGate()
    gate.open.set()
    with Peer(tmp_path, gate.answer) as peer:
        screen = Screen(tmp_path)
        screen.feed.start()
        screen.until(lambda fresh: fresh.status is not None)
        gate.open.clear()
        assert screen.until(lambda fresh: fresh.status is None).engine is EngineState.SILENT
        gate.open.set()
        assert screen.until(lambda fresh: fresh.status is not None).engine is EngineState.ANSWERING
        assert peer.commands == ["attend"]
        screen.close()


def test_what_is_asked_for_is_looked_at_soon(tmp_path: Path) -> None:
    with Peer(tmp_path) as peer:
        screen = Screen(tmp_path)
        screen.feed._period_s = 60.0
        screen.feed.start()
        peer.until(lambda: len(peer.heard) == 2)
        screen.feed.look_now()
        peer.until(lambda: len(peer.heard) == 3)
        screen.close()


def test_closing_while_a_line_is_being_opened_leaves_nothing_open(tmp_path: Path) -> None:
    gate = PauseGate()
    with Peer(tmp_path, gate.answer) as peer:
        screen = Screen(tmp_path)
        screen.feed.start()
        assert gate.asked.wait(LIMIT_S)
        gate.open.set()
        screen.close()
        peer.until(lambda: peer.open == 0)


LOCKED = """
import os, queue, sys
from pathlib import Path
from hilcell.tui.engine.feed import Feed
os.getuid() or os.setuid(65534)  # root may look everywhere
looks = queue.Queue()
Feed(Path(sys.argv[1]), looks.put, 0.02).start()
print(looks.get(timeout=10).trouble, looks.get(timeout=10).trouble, sep="\\n")
"""


def test_a_folder_without_permission_is_reported_at_each_look() -> None:
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0)
        done = subprocess.run(
            [sys.executable, "-c", LOCKED, name], capture_output=True, text=True, check=False
        )
        Path(name).chmod(0o755)
    why = f"journal {name}/journal.sqlite: cannot be read: Permission denied"
    assert (done.stdout.splitlines(), done.stderr) == ([why, why], "")


@pytest.mark.parametrize("written", [True, False])
def test_it_tells_whether_a_calibration_has_its_file(tmp_path: Path, written: bool) -> None:
    journal(tmp_path)
    if written:
        (tmp_path / CALIBRATION).write_text("{}")
    screen = Screen(tmp_path)
    screen.feed.start()
    assert screen.until(lambda fresh: bool(fresh.records)).calibrated == written
    screen.close()


def test_a_damaged_journal_is_reported(tmp_path: Path) -> None:
    (tmp_path / "journal.sqlite").write_bytes(b"no journal at all, but long enough to be one")
    screen = Screen(tmp_path)
    screen.feed.start()
    assert (
        "not a journal, or damaged at record 1"
        in screen.until(lambda fresh: bool(fresh.trouble)).trouble
    )
    screen.close()


def test_a_run_that_has_no_journal_yet_is_waited_for(tmp_path: Path) -> None:
    screen = Screen(tmp_path / "r")
    screen.feed.start()
    assert screen.until(lambda _: True).trouble == ""
    writer = journal(tmp_path / "r")
    screen.until(lambda fresh: bool(fresh.records))
    screen.close()
    writer.left()


def test_a_detach_over_a_silent_engine_is_not_long(tmp_path: Path) -> None:
    mad = threading.Event()
    with Peer(tmp_path, lambda words: SILENCE if mad.is_set() else usual(words)):
        screen = Screen(tmp_path)
        screen.feed.start()
        screen.until(lambda fresh: fresh.status is not None)
        mad.set()
        began_s = time.monotonic()
        screen.close(leave=True)
        assert time.monotonic() - began_s < 2.0
