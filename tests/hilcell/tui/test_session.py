"""One attachment of a screen to a run: what it asks, and whom its stop reaches."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from hilcell.errors import HilcellError
from hilcell.tui.engine.feed import RunUpdate
from hilcell.tui.engine.run_view import EngineState
from hilcell.tui.engine.session import Session, utc_now
from tests.hilcell.tui.engine_peer import (
    ANSWER_S,
    LIMIT_S,
    PERIOD_S,
    Peer,
    none_before,
    nothing_left_open,
    short,
    usual,
)

__all__ = ["none_before", "nothing_left_open", "short"]


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
        assert session.stop_heard
        session.close(leave=True)


def test_a_stop_that_was_heard_is_known_until_the_run_is_seen_to_have_ended(tmp_path: Path) -> None:
    with Peer(tmp_path) as peer:
        session = Session(tmp_path, lambda _: None, PERIOD_S)
        session.take(RunUpdate([], engine=EngineState.ANSWERING), utc_now())
        assert session.stop()
        peer.until(lambda: peer.commands == ["stop"])
    # By now the stop has ended the engine.
    assert (session.stop(), session.stop_heard) == (False, True)
    session.take(RunUpdate([], engine=EngineState.NONE), utc_now())
    assert not session.stop_heard  # another engine is another matter
    session.close(leave=True)


def test_an_answer_may_take_as_long_as_a_look_of_the_tracker(tmp_path: Path) -> None:
    looked = threading.Event()

    def slow(command: dict[str, str]) -> bytes:
        if command["command"] == "answer":
            assert looked.wait(LIMIT_S)
        return usual(command)

    with Peer(tmp_path, slow):
        session = Session(tmp_path, lambda _: None, PERIOD_S)
        later = threading.Timer(3 * ANSWER_S, looked.set)
        later.start()
        session.ask("answer")  # raises where it gives up
        later.join()
        session.close(leave=True)


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
        session.take(RunUpdate([], engine=EngineState.ANSWERING), utc_now())
        session.take(RunUpdate([], engine=EngineState.NONE), utc_now())
        assert not session.stop()
        assert process.poll() is None
