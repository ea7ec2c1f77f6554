"""A run that a screen has ordered: nothing moves before one attends, or is taken for lost."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import hilcell.run.worker as worker_module
from hilcell.run.control import Command, Control, order
from tests.hilcell.run.bed import Bed, Live, Screen, until
from tests.hilcell.run.rig import Points, procedure

MANY = 10**6


@pytest.fixture
def bed(tmp_path: Path) -> Bed:
    return Bed(tmp_path, unattended=False, ordered=True)


@contextmanager
def waiting(bed: Bed, points: int = MANY) -> Iterator[Live]:
    """Run with a control channel, to where it waits for its screen."""
    with listening(bed, points) as live:
        until(lambda: live.status("devices")["robot"]["state"] == "fresh")  # read at rest only
        yield live


@contextmanager
def listening(bed: Bed, points: int = MANY) -> Iterator[Live]:
    """Run with a control channel."""
    live = Live(bed, procedure(Points(points)))
    control = Control(bed.path.parent, live.runner)
    try:
        with live:
            yield live
    finally:
        control.close()


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker_module.Worker, "SCREEN_S", 0.0)


def test_nothing_begins_before_a_screen_attends(bed: Bed) -> None:
    with waiting(bed, 1) as live:
        assert bed.events("connected")
        assert live.status("state") == "checking"
        screen = Screen(bed.path.parent)
        screen.ask("status")  # to look is not to attend
        assert bed.states() == ["checking"]
        screen.ask("attend")
        live.until("state", "finished")
        screen.close()
    assert live.code == 0
    assert bed.states() == ["checking", "running", "finished"]
    assert bed.events("screen lost") == []


@pytest.mark.usefixtures("impatient")
def test_a_screen_that_never_attends_is_a_lost_one(bed: Bed) -> None:
    with listening(bed, 1) as live:
        live.until("state", "paused")
        assert live.status("points") == 0
        assert bed.records("intent") == []
        screen = Screen(bed.path.parent)
        assert screen.ask("attend")["state"] == "paused"
        screen.ask("proceed")
        live.until("state", "finished")
        screen.close()
    assert live.code == 0
    (paused,) = (r.body for r in bed.records("state") if r.body["to"] == "paused")
    assert "screen" in paused["reason"]
    told = [r.body["what"] for r in bed.log().events if "screen" in r.body["what"]]
    assert told == ["screen lost", "screen back"]


def test_a_screen_that_has_left_is_not_waited_for(
    bed: Bed, monkeypatch: pytest.MonkeyPatch
) -> None:
    connect = bed.tracker.connect

    def come_and_go() -> object:
        screen = Screen(bed.path.parent)
        screen.ask("attend")
        screen.ask("leave")
        screen.close()
        return connect()

    monkeypatch.setattr(bed.tracker, "connect", come_and_go)
    with listening(bed, 1) as live:
        live.until("state", "finished")
    assert live.code == 0
    assert "paused" not in bed.states()


@pytest.mark.parametrize("command", ["stop", "abort"])
def test_stop_and_abort_wait_for_no_screen(bed: Bed, command: Command) -> None:
    with waiting(bed) as live:
        order(bed.path.parent, command)
    assert live.code == 4
    way = ["aborting"] if command == "abort" else []
    assert bed.states() == ["checking", *way, "stopping", "aborted"]
    assert (bed.robot.stopped == 1) is (command == "stop")


@pytest.mark.parametrize(("unattended", "ordered"), [(True, True), (False, False)])
def test_others_wait_for_no_screen(tmp_path: Path, unattended: bool, ordered: bool) -> None:
    bed = Bed(tmp_path, unattended=unattended, ordered=ordered)
    with listening(bed, 1) as live:
        live.until("state", "finished")
    assert live.code == 0
