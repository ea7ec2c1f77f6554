"""The campaign of rests can fail: it rests at hand-overs, and a race comes out by that."""

from __future__ import annotations

import socket
import threading

import pytest

from campaigns.rests import PLACES, rest_at


def test_it_rests_before_and_after_each_hand_over() -> None:
    passed: list[str] = []
    patches = rest_at(PLACES, passed.append)
    try:
        one, other = socket.socketpair()
        with one, other:
            one.sendall(b"x")
            other.recv(1)
        signal = threading.Event()
        thread = threading.Thread(target=signal.set)
        thread.start()
        signal.wait()
        thread.join()
    finally:
        patches.undo()
    for call in ("socket.sendall", "socket.recv", "Thread.start", "Thread.run", "Event.set"):
        assert {f"before {call}", f"after {call}"} <= set(passed)
    assert passed.count("before socket.close") == 2
    passed.clear()
    threading.Event().set()
    assert passed == []  # it is undone


@pytest.mark.parametrize("signal_first", [False, True])
def test_a_signal_that_comes_too_early_is_seen(signal_first: bool) -> None:
    result: list[str] = []
    ready, looked = threading.Event(), threading.Event()

    def work() -> None:
        if signal_first:
            ready.set()  # the race: it rests here, and the other finds nothing
        result.append("done")
        ready.set()

    def rest(place: str) -> None:
        if place == "after Event.set" and ready.is_set():
            looked.wait()

    patches = rest_at([(threading.Event, "set")], rest)
    try:
        thread = threading.Thread(target=work)
        thread.start()
        ready.wait()
        seen = list(result)
    finally:
        patches.undo()
        looked.set()
    thread.join()
    assert seen == ([] if signal_first else ["done"])
