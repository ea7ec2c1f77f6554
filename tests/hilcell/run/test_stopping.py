"""Every device is stopped once, at once, and none waits for another."""

import threading
from collections.abc import Callable
from functools import partial

import pytest

from hilcell.ports import DeviceError
from hilcell.run.stopping import ParallelCalls, SafeStop, close_all
from tests.clocks import DrivenClock
from tests.hilcell.run.bed import CELL, until
from tests.hilcell.run.rig import DeskRail, DeskRobot, desk, hang


def test_all_are_done_once_by_whoever_comes_first() -> None:
    done: list[str] = []
    go = threading.Event()
    acts = ParallelCalls({name: partial(done.append, name) for name in "abcdef"}, go)
    assert done == []
    go.set()
    helpers = [threading.Thread(target=acts.run_pending) for _ in range(4)]
    for helper in helpers:
        helper.start()
    for helper in helpers:
        helper.join()
    assert acts.wait(60.0) == {}  # one that another thread has begun may not be over yet
    assert sorted(done) == list("abcdef")


def stopping(name: str, wait: Callable[[], None], stopped: list[str]) -> Callable[[], None]:
    """Return a stop that waits and then notes its device."""

    def stop() -> None:
        wait()
        stopped.append(name)

    return stop


@pytest.mark.parametrize("hung", ["Rail", "Robot", "Tracker"])
def test_a_device_that_hangs_keeps_no_other_waiting(
    hung: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    devices = desk(CELL, DrivenClock())
    entered, release = threading.Event(), threading.Event()
    stopped: list[str] = []
    for name, device in devices.named().items():
        wait = hang(entered, release) if name == hung else lambda: None
        monkeypatch.setattr(device, "stop", stopping(name, wait, stopped))
    stop = SafeStop(devices)
    asking = threading.Thread(target=stop.trigger)
    asking.start()
    entered.wait()
    until(lambda: len(stopped) == 2)
    assert hung not in stopped
    release.set()
    assert stop.stop_and_wait() == {}
    asking.join()
    assert sorted(stopped) == ["Rail", "Robot", "Tracker"]


def test_problems_are_told_by_device(monkeypatch: pytest.MonkeyPatch) -> None:
    def gone() -> None:
        raise DeviceError("HC-R01", "Rail", "stop", "link lost")

    devices = desk(CELL, DrivenClock())
    monkeypatch.setattr(devices.rail, "stop", gone)
    (problem,) = SafeStop(devices).stop_and_wait().items()
    assert problem[0] == "Rail"
    assert isinstance(devices.robot, DeskRobot)
    assert devices.robot.stopped == 1


def test_a_late_one_is_told_and_left() -> None:
    entered, release = threading.Event(), threading.Event()
    acts = ParallelCalls({"slow": hang(entered, release)})
    entered.wait()
    assert [*acts.wait(0.0)] == ["slow"]
    release.set()


def test_closing_closes_each_once() -> None:
    devices = desk(CELL, DrivenClock())
    assert close_all(devices) == {}
    assert isinstance(devices.rail, DeskRail)
    assert devices.rail.closed == 1
