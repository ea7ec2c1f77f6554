"""Every device is stopped once, at once, and none waits for another."""

import threading
import time
from collections.abc import Callable
from functools import partial

import pytest

from hilcell.ports import DeviceError
from hilcell.run.stopping import Acts, SafeStop, close_all, facts_of_problems
from tests.hilcell.run.bed import CELL, until
from tests.hilcell.run.rig import DeskRail, DeskRobot, desk, hang


def test_all_are_done_once_by_whoever_comes_first() -> None:
    done: list[str] = []
    go = threading.Event()
    acts = Acts({name: partial(done.append, name) for name in "abcdef"}, go)
    assert done == []
    go.set()
    helpers = [threading.Thread(target=acts.help) for _ in range(4)]
    for helper in helpers:
        helper.start()
    assert acts.wait(10.0) == {}
    for helper in helpers:
        helper.join(10)
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
    devices = desk(CELL)
    entered, release = threading.Event(), threading.Event()
    stopped: list[str] = []
    for name, device in devices.named().items():
        wait = hang(entered, release) if name == hung else lambda: None
        monkeypatch.setattr(device, "stop", stopping(name, wait, stopped))
    stop = SafeStop(devices)
    asking = threading.Thread(target=stop.trigger)
    asking.start()
    assert entered.wait(10)
    until(lambda: len(stopped) == 2)
    assert hung not in stopped
    release.set()
    assert stop.wait() == {}
    asking.join(10)
    assert sorted(stopped) == ["Rail", "Robot", "Tracker"]


def test_problems_are_told_by_device(monkeypatch: pytest.MonkeyPatch) -> None:
    def gone() -> None:
        raise DeviceError("HC-R01", "Rail", "stop", "link lost")

    devices = desk(CELL)
    monkeypatch.setattr(devices.rail, "stop", gone)
    (problem,) = SafeStop(devices).wait().items()
    assert (problem[0], str(problem[1])) == ("Rail", "Rail: stop: link lost")
    assert isinstance(devices.robot, DeskRobot)
    assert devices.robot.stopped == 1


def test_a_late_one_is_told_and_left() -> None:
    entered, release = threading.Event(), threading.Event()
    acts = Acts({"slow": hang(entered, release)})
    began_s = time.monotonic()
    (problem,) = acts.wait(0.1).items()
    assert (problem[0], str(problem[1])) == ("slow", "no answer within 0.1 s")
    assert time.monotonic() - began_s < 5.0
    release.set()


def test_closing_closes_each_once() -> None:
    devices = desk(CELL)
    assert close_all(devices) == {}
    assert isinstance(devices.rail, DeskRail)
    assert devices.rail.closed == 1


def test_problems_are_journalled_in_words_and_as_facts() -> None:
    lost = DeviceError("HC-R01", "Rail", "stop", "link lost")
    assert facts_of_problems({"Rail": lost}) == {
        "problems": {"Rail": "Rail: stop: link lost"},
        "errors": {"Rail": lost.facts()},
    }
    assert facts_of_problems({}) == {"problems": {}}
