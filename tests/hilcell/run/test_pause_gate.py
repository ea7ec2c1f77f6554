"""The gate of a pause: who waits is reported, who passes is gone, whatever the haste."""

import random
import threading

import pytest

from hilcell.ports import Stopped
from hilcell.run.worker import PauseGate


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
