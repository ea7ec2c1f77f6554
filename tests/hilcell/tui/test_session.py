"""One attachment of a screen to a run: what it asks, and whom its stop reaches."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path
from typing import Any, cast

import pytest

from hilcell.errors import HilcellError
from hilcell.tui import session as sessions
from hilcell.tui.run_view import EngineState
from hilcell.tui.session import RunUpdate, Session, utc_now
from tests.hilcell.tui.engine_peer import Peer
from tests.hilcell.tui.sample_runs import status
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


def test_a_stop_ends_an_engine_that_hears_nobody_yet(tmp_path: Path) -> None:
    process = Process()
    session = session_of(tmp_path, process)
    assert session.stop()
    assert process.ended
    assert session.stop()  # said again, it is still so


def test_an_engine_that_was_heard_once_is_never_killed(tmp_path: Path) -> None:
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
