"""The worker: its gate, waits without an operator, and the screen that ordered the run."""

from __future__ import annotations

import random
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import hilcell.run.worker as worker_module
from hilcell.invariants import check_invariants
from hilcell.journal.journal import read_journal
from hilcell.ports import Stopped
from hilcell.run.control import Command, Control, order
from hilcell.run.meter import Meter
from hilcell.run.worker import PauseGate, UnattendedPolling
from tests.clocks import DrivenClock
from tests.hilcell.run.bed import Bed, Live, Screen, broken_beam, until, waiting
from tests.hilcell.run.rig import Points, procedure


def nothing() -> None: ...


def test_an_open_gate_is_passed_at_once() -> None:
    reported: list[str] = []
    gate = PauseGate(lambda: reported.append("rests"))
    gate.pass_through(lambda: reported.append("waits"))
    assert reported == []
    assert not gate.closed
    assert not gate.resting


def test_who_comes_to_a_closed_gate_says_so_and_waits() -> None:
    reported: list[str] = []
    gate = PauseGate(lambda: reported.append("rests"))
    gate.close()
    assert reported == []  # nobody stands there yet
    waits = threading.Semaphore(0)
    worker = threading.Thread(target=gate.pass_through, args=(waits.release,))
    worker.start()
    for _ in range(3):
        waits.acquire()
    assert gate.resting
    gate.open()
    worker.join()
    assert reported == ["rests"]  # once, however long it waits
    assert not gate.resting


def test_a_stop_ends_the_wait() -> None:
    def stopped() -> None:
        raise Stopped("stop")

    gate = PauseGate(nothing)
    gate.close()
    with pytest.raises(Stopped):
        gate.pass_through(stopped)


def test_opened_and_closed_in_haste_the_worker_is_never_in_between() -> None:
    """After every close the worker rests and reports it, once it is there; never while open."""
    rests = threading.Semaphore(0)
    gate = PauseGate(rests.release)
    ended = threading.Event()

    def work() -> None:
        while not ended.is_set():
            gate.pass_through(nothing)

    worker = threading.Thread(target=work)
    worker.start()
    rng = random.Random(1)
    for _ in range(300):
        gate.close()
        rests.acquire()
        assert gate.resting
        for _ in range(rng.randrange(4)):
            gate.open()
            gate.close()
        gate.open()
        while rests.acquire(blocking=False):  # nothing is reported while the gate is open
            pass
    ended.set()
    gate.open()
    worker.join()


# -- An unattended run whose readings fail waits for the cause to go, and not for ever -------------


def looks(wait: UnattendedPolling, clock: DrivenClock) -> list[float]:
    """Return when looks are due until the time is over."""
    found = []
    while not wait.over:
        if wait.poll_due():
            found.append(clock.at_s)
    return found


def test_looks_come_less_and_less_often_and_once_more_at_the_end() -> None:
    clock = DrivenClock()
    assert looks(UnattendedPolling(clock, 900.0), clock) == [10, 30, 70, 150, 310, 610, 900]


def test_all_waits_of_a_session_share_the_time() -> None:
    clock = DrivenClock()
    wait = UnattendedPolling(clock, 100.0)
    while not wait.poll_due():
        pass
    clock.at_s = 50.0  # measuring
    wait.begin()
    assert looks(wait, clock) == [60, 80, 120, 140]
    assert wait.over


def test_a_cause_that_is_back_at_once_is_looked_at_less_and_less_often() -> None:
    clock = DrivenClock()
    wait, found = UnattendedPolling(clock, 900.0), []
    while not wait.over:
        wait.begin()
        while not wait.poll_due():
            pass
        found.append(clock.at_s)
        clock.at_s += 6.0  # another try
    assert found == [10, 36, 82, 168, 334, 640, 936]


def test_without_time_there_is_no_wait() -> None:
    assert UnattendedPolling(DrivenClock(), 0.0).over


FOR_EVER_S = 1e12


def test_it_suspends_and_goes_on_when_the_reading_is_good_again(tmp_path: Path) -> None:
    bed = Bed(tmp_path, cell=waiting(60.0))
    bed.tracker.answer = broken_beam(Meter.TRIES + 2)
    assert bed.run(procedure(Points(2))) == 0
    assert bed.states() == ["checking", "running", "suspended", "running", "finished"]
    went_on = [r.body for r in bed.records("state") if r.body.get("by")]
    assert [body["by"] for body in went_on] == ["look"]
    assert check_invariants(read_journal(bed.path))["I13"].holds


def test_a_cause_that_stays_is_a_fault_with_its_own_code(tmp_path: Path) -> None:
    bed = Bed(tmp_path, cell=waiting(100.0))
    bed.tracker.answer = broken_beam(1000, after=1, code="HC-T11")
    assert bed.run(procedure(Points(2))) == 3
    assert bed.states() == ["checking", "running", "suspended", "faulted"]
    assert bed.log().life[-1].change.error["code"] == "HC-T11"
    assert bed.rail.closed == 1


def test_the_very_first_nest_is_not_waited_for(tmp_path: Path) -> None:
    """No reflector there: nobody has shown yet that the cell file fits the hall."""
    bed = Bed(tmp_path, cell=waiting(FOR_EVER_S))
    bed.tracker.answer = broken_beam(Meter.TRIES, code="HC-T11")
    assert bed.run(procedure(Points(1))) == 3
    assert bed.states() == ["checking", "running", "faulted"]
    end = bed.log().end
    assert end is not None
    assert end.error["code"] == "HC-T11"
    bed.tracker.answer = lambda: None
    assert bed.run(procedure(Points(1))) == 0  # resumed once it is seen


def test_somebody_who_attends_after_all_may_answer(tmp_path: Path) -> None:
    bed = Bed(tmp_path, cell=waiting(FOR_EVER_S))
    bed.tracker.answer = broken_beam(10**9, after=1)
    with Live(bed, procedure(Points(2))) as live:
        live.until("state", "suspended")
        assert live.runner.answer()
        bed.tracker.answer = lambda: None
    assert live.code == 0


def test_a_stop_ends_the_unattended_wait(tmp_path: Path) -> None:
    bed = Bed(tmp_path, cell=waiting(FOR_EVER_S))
    bed.tracker.answer = broken_beam(10**9, after=1)
    with Live(bed, procedure(Points(2))) as live:
        live.until("state", "suspended")
        live.runner.stop()
    assert live.code == 4


# -- A run that a screen has ordered: nothing moves before one attends, or is taken for lost -------


MANY = 10**6


@pytest.fixture
def bed(tmp_path: Path) -> Bed:
    return Bed(tmp_path, unattended=False, ordered=True)


@contextmanager
def awaiting_screen(bed: Bed, points: int = MANY) -> Iterator[Live]:
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
    with awaiting_screen(bed, 1) as live:
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
    (paused,) = bed.entered("paused")
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
    with awaiting_screen(bed) as live:
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
