"""The line to an engine: answers, refusals, silence, garbage, ends; and nothing is leaked."""

from __future__ import annotations

import gc
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import msgspec
import pytest

from hilcell.errors import HilcellError
from hilcell.run.control import EngineFile, live_engine, send_command
from hilcell.tui import feed as feeds
from hilcell.tui import link as links
from hilcell.tui.feed import Feed, Fresh
from hilcell.tui.link import Link, LinkLostError, LinkSilentError
from hilcell.tui.scene import Engine
from hilcell.tui.session import Session, utc_now
from tests.hilcell.report.journals import Writer
from tests.hilcell.tui.engine_peer import SILENCE, STATUS, Peer, says, usual

PERIOD_S = 0.02
LIMIT_S = 10.0
MANY_STOPS = 2000  # their answers fill any buffer


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait for silent engines as long as a test may."""
    monkeypatch.setattr(links, "ANSWER_S", 0.2)
    monkeypatch.setattr(feeds, "ANEW_S", 0.5)


@pytest.fixture(autouse=True)
def nothing_left_open() -> Iterator[None]:
    """Let what was leaked be found: what is left open, and what only a collection would close."""
    before = open_sockets()
    yield
    assert open_sockets() <= before
    gc.collect()


def open_sockets() -> set[str]:
    found = set()
    for file in Path("/proc/self/fd").iterdir():
        with suppress(FileNotFoundError):  # the one that lists them
            found.add(str(file.readlink()))
    return {target for target in found if target.startswith("socket:")}


def linked(folder: Path) -> Link:
    link = Link.to(folder)
    assert link is not None
    return link


def test_esc_held_down_is_heard_to_the_end(tmp_path: Path) -> None:
    with Peer(tmp_path) as peer:
        link = linked(tmp_path)
        for heard in range(10, MANY_STOPS + 1, 10):
            assert all(link.stop() for _ in range(10))
            peer.until_stops(heard)
        link.close()


def test_an_answer_may_take_as_long_as_a_look_of_the_tracker(tmp_path: Path) -> None:
    looked = threading.Event()

    def slow(command: dict[str, str]) -> bytes:
        if command["command"] == "answer":
            assert looked.wait(LIMIT_S)
        return usual(command)

    with Peer(tmp_path, slow):
        session = Session(tmp_path, lambda _: None, PERIOD_S)
        later = threading.Timer(3 * links.ANSWER_S, looked.set)
        later.start()
        session.ask("answer")  # raises where it gives up
        later.join()
        session.close(leave=True)


# -- the link --------------------------------------------------------------------------------------


def test_it_asks_and_is_answered(tmp_path: Path) -> None:
    with Peer(tmp_path) as peer:
        link = linked(tmp_path)
        assert link.ask("status") == STATUS
        link.ask("retake", key="grid/0-0-0")
        assert link.stop()
        peer.until(lambda: "stop" in peer.commands)
        link.close()
        peer.until(lambda: peer.open == 0)
        numbers = {command: number for number, command in peer.heard}
    assert numbers["status"] == numbers["retake"] != numbers["stop"]


def test_a_refusal_keeps_its_reason_and_the_line(tmp_path: Path) -> None:
    def refuse(words: dict[str, str]) -> bytes:
        refused = words["command"] == "answer"
        return says({"ok": False, "error": "not seen"}) if refused else usual(words)

    with Peer(tmp_path, refuse):
        link = linked(tmp_path)
        with pytest.raises(HilcellError, match="not seen") as caught:
            link.ask("answer")
        assert not isinstance(caught.value, LinkLostError)
        assert link.ask("status") == STATUS
        link.close()


def test_a_refusal_without_a_reason_is_still_one(tmp_path: Path) -> None:
    with Peer(tmp_path, lambda _: says({})):
        link = linked(tmp_path)
        with pytest.raises(HilcellError, match="refused without a reason"):
            link.ask("pause")
        link.close()


@pytest.mark.parametrize(
    "answer",
    [b"garbage\n", b"\n", b"[1, 2]\n", b'"ok"\n', b"\xff\xfe\n", b"x" * 200_000 + b"\n", None],
    ids=["garbage", "empty", "list", "text", "bytes", "endless", "closed"],
)
def test_what_is_no_answer_loses_the_line(tmp_path: Path, answer: bytes | None) -> None:
    with Peer(tmp_path, lambda _: answer) as peer:
        link = linked(tmp_path)
        with pytest.raises(LinkLostError, match="engine: status: no answer"):
            link.ask("status")
        with pytest.raises(LinkLostError):
            link.ask("status")
        assert not link.stop()
        peer.until(lambda: peer.open == 0)


@pytest.mark.parametrize("beginning", [SILENCE, b'{"ok": tr'], ids=["silence", "torn"])
def test_a_late_answer_is_never_taken_for_the_next_one_s(tmp_path: Path, beginning: bytes) -> None:
    waits = threading.Event()
    answers = iter([beginning, says({"ok": True, "number": 2})])
    rest = says({"ok": True, "number": 1}).removeprefix(beginning)

    def slowly(words: dict[str, str]) -> bytes:
        if words["command"] == "late":
            assert waits.wait(LIMIT_S)
            return rest
        return usual(words) if words["command"] == "stop" else next(answers)

    with Peer(tmp_path, slowly) as peer:
        link = linked(tmp_path)
        with pytest.raises(LinkSilentError, match="engine: status: no answer"):
            link.ask("status")
        with pytest.raises(LinkSilentError):  # nothing else is asked while one is owed
            link.ask("pause")
        link._asking.sendall(b'{"command": "late"}\n')  # stands for the engine's own time
        assert link.stop()
        peer.until_stops(1)
        waits.set()
        assert link.ask("answer")["number"] == 2
        assert "pause" not in peer.commands
        link.close()


def test_a_stop_waits_for_no_answer(tmp_path: Path) -> None:
    asked, lost = threading.Event(), threading.Event()

    def hang(words: dict[str, str]) -> bytes:
        asked.set()
        return SILENCE

    with Peer(tmp_path, hang) as peer:
        link = linked(tmp_path)

        def ask() -> None:
            with pytest.raises(LinkSilentError):
                link.ask("status")
            lost.set()

        asking = threading.Thread(target=ask)
        asking.start()
        assert asked.wait(LIMIT_S)
        assert link.stop()
        peer.until(lambda: "stop" in peer.commands)
        asking.join()
        assert lost.is_set()
        link.close()


@pytest.mark.parametrize(
    "text",
    [
        None,
        b"",
        b"garbage",
        b"{}",
        b'{"pid": 1, "socket": "/nowhere/control"}',
        b'{"pid": 1, "socket": "' + b"x" * 500 + b'"}',
    ],
    ids=["none", "empty", "garbage", "fields", "nobody", "long"],
)
def test_no_engine_no_link(tmp_path: Path, text: bytes | None) -> None:
    if text is not None:
        (tmp_path / "engine.json").write_bytes(text)
    assert Link.to(tmp_path) is None


def test_an_engine_whose_queue_is_full_lives_and_is_silent(tmp_path: Path) -> None:
    path = tmp_path / "control"
    with socket.socket(socket.AF_UNIX) as server, ExitStack() as waiting:
        server.bind(str(path))
        server.listen(0)
        (tmp_path / "engine.json").write_bytes(msgspec.json.encode(EngineFile(1, str(path))))
        with suppress(BlockingIOError):
            while True:
                client = waiting.enter_context(socket.socket(socket.AF_UNIX))
                client.setblocking(False)
                client.connect(str(path))
        assert live_engine(tmp_path) is not None
        with pytest.raises(LinkSilentError, match="connect: no answer"):
            Link.to(tmp_path)
        assert not links.stop_engine(tmp_path)
        with pytest.raises(HilcellError, match="process 1, has not answered"):
            send_command(tmp_path, "stop")


# -- the feed --------------------------------------------------------------------------------------


class Screen:
    """Takes what a feed delivers."""

    def __init__(self, folder: Path) -> None:
        self.brought: list[Fresh] = []
        self._looked = 0
        self._came = threading.Condition()
        self.feed = Feed(folder, self._take, PERIOD_S)

    def _take(self, fresh: Fresh) -> None:
        with self._came:
            self.brought.append(fresh)
            self._came.notify_all()

    def until(self, true: Callable[[Fresh], bool]) -> Fresh:
        """Wait for a look that brings something, after those already returned; return it."""
        with self._came:
            assert self._came.wait_for(
                lambda: any(map(true, self.brought[self._looked :])), LIMIT_S
            )
            while not true(self.brought[self._looked]):
                self._looked += 1
            self._looked += 1
            return self.brought[self._looked - 1]

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
    assert (first.engine, first.status) == (Engine.NONE, None)
    writer.point("grid/0", "grid", (1.0, 2.0, 3.0))
    second = screen.until(lambda fresh: bool(fresh.records))
    assert [record.key for record in second.records] == ["grid/0"]
    screen.close()
    writer.left()


def test_it_attends_asks_and_leaves(tmp_path: Path) -> None:
    with Peer(tmp_path) as peer:
        screen = Screen(tmp_path)
        screen.feed.start()
        fresh = screen.until(lambda fresh: fresh.status is not None)
        assert fresh.engine is Engine.HEARD
        assert fresh.status is not None
        assert fresh.status.devices["rail"].text == "1100.20 mm"
        assert peer.commands == ["attend"]
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
        "import sys, time; from pathlib import Path; from hilcell.tui.feed import Feed; "
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
        assert screen.until(lambda fresh: fresh.status is not None).engine is Engine.HEARD
        screen.close()
        peer.until(lambda: peer.open == 0)


@pytest.mark.parametrize("answer", [SILENCE, b"garbage\n", None], ids=["silence", "garbage", "end"])
def test_an_engine_gone_mad_is_asked_anew_until_it_is_well(
    tmp_path: Path, answer: bytes | None
) -> None:
    mad = threading.Event()

    def sometimes(words: dict[str, str]) -> bytes | None:
        return answer if mad.is_set() else usual(words)

    with Peer(tmp_path, sometimes) as peer:
        screen = Screen(tmp_path)
        screen.feed.start()
        screen.until(lambda fresh: fresh.status is not None)
        mad.set()
        lost = screen.until(lambda fresh: fresh.status is None)
        assert lost.engine is (Engine.SILENT if answer == SILENCE else Engine.NONE)
        mad.clear()
        assert screen.until(lambda fresh: fresh.status is not None).engine is Engine.HEARD
        screen.close()
        peer.until(lambda: peer.open == 0)


@pytest.mark.parametrize(
    "told",
    [
        {"ok": False, "error": "no"},
        {"ok": True},
        STATUS | {"devices": 5},
        STATUS | {"prompt": {"title": 3}},
        STATUS | {"retakes": [None]},
    ],
)
def test_a_status_that_makes_no_sense_leaves_the_last_to_grow_stale(
    tmp_path: Path, told: dict[str, object]
) -> None:
    odd = threading.Event()

    def answer(words: dict[str, str]) -> bytes:
        return says(told) if odd.is_set() else usual(words)

    with Peer(tmp_path, answer):
        screen = Screen(tmp_path)
        screen.feed.start()
        screen.until(lambda fresh: fresh.status is not None)
        odd.set()
        assert screen.until(lambda fresh: fresh.status is None).engine is Engine.HEARD
        odd.clear()
        screen.until(lambda fresh: fresh.status is not None)
        screen.close()


def test_an_engine_that_only_stood_still_is_heard_on_the_same_line(tmp_path: Path) -> None:
    goes = threading.Event()
    goes.set()

    def answer(words: dict[str, str]) -> bytes:
        assert goes.wait(LIMIT_S)
        return usual(words)

    with Peer(tmp_path, answer) as peer:
        screen = Screen(tmp_path)
        screen.feed.start()
        screen.until(lambda fresh: fresh.status is not None)
        goes.clear()
        assert screen.until(lambda fresh: fresh.status is None).engine is Engine.SILENT
        goes.set()
        assert screen.until(lambda fresh: fresh.status is not None).engine is Engine.HEARD
        assert peer.commands == ["attend"]
        screen.close()


def test_what_is_asked_for_is_looked_at_soon(tmp_path: Path) -> None:
    with Peer(tmp_path) as peer:
        screen = Screen(tmp_path)
        screen.feed._period_s = 60.0
        screen.feed.start()
        peer.until(lambda: len(peer.heard) == 2)
        screen.feed.soon()
        peer.until(lambda: len(peer.heard) == 3)
        screen.close()


def test_closing_while_a_line_is_being_opened_leaves_nothing_open(tmp_path: Path) -> None:
    begun, go_on = threading.Event(), threading.Event()

    def slowly(words: dict[str, str]) -> bytes:
        begun.set()
        assert go_on.wait(LIMIT_S)
        return usual(words)

    with Peer(tmp_path, slowly) as peer:
        screen = Screen(tmp_path)
        screen.feed.start()
        assert begun.wait(LIMIT_S)
        go_on.set()
        screen.close()
        peer.until(lambda: peer.open == 0)


def test_a_journal_that_is_damaged_is_told(tmp_path: Path) -> None:
    (tmp_path / "journal.sqlite").write_bytes(b"no journal at all, but long enough to be one")
    screen = Screen(tmp_path)
    screen.feed.start()
    assert "damaged or not a journal" in screen.until(lambda fresh: bool(fresh.trouble)).trouble
    screen.close()


def test_a_run_that_has_no_journal_yet_is_waited_for(tmp_path: Path) -> None:
    screen = Screen(tmp_path / "r")
    screen.feed.start()
    assert screen.until(lambda _: True).trouble == ""
    writer = journal(tmp_path / "r")
    screen.until(lambda fresh: bool(fresh.records))
    screen.close()
    writer.left()


# -- the session -----------------------------------------------------------------------------------


def test_without_an_engine_nothing_is_asked_or_stopped(tmp_path: Path) -> None:
    session = Session(tmp_path / "r", lambda _: None, PERIOD_S)
    with pytest.raises(HilcellError, match="pause: no engine is running for r"):
        session.ask("pause")
    assert not session.stop()
    session.close(leave=True)


def test_a_stop_finds_a_line_of_its_own(tmp_path: Path) -> None:
    with Peer(tmp_path) as peer:
        session = Session(tmp_path, lambda _: None, PERIOD_S)
        assert session.stop()
        peer.until(lambda: peer.commands == ["stop"] and peer.open == 0)
        session.close(leave=True)


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


# -- an engine that is being started ---------------------------------------------------------------


@contextmanager
def child() -> Iterator[subprocess.Popen[bytes]]:
    """Give a process that does nothing, until the block is left."""
    process = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def test_a_stop_ends_an_engine_that_hears_nobody_yet(tmp_path: Path) -> None:
    with child() as process:
        session = Session(tmp_path, lambda _: None, PERIOD_S, process)
        assert session.stop()
        assert process.wait(LIMIT_S) == -signal.SIGTERM
        assert session.stop()  # said again, it is still so


def test_an_engine_that_was_heard_once_is_never_killed(tmp_path: Path) -> None:
    with child() as process:
        session = Session(tmp_path, lambda _: None, PERIOD_S, process)
        session.take(Fresh([], engine=Engine.HEARD), utc_now())
        session.take(Fresh([], engine=Engine.NONE), utc_now())
        assert not session.stop()
        assert process.poll() is None
